//! A camera that sends frames, and whoever reads its results.

use prost::Message;
use stereo_proto::v1::{Image, ImageStamp, StereoRequest, StereoResult};
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::handlers::{RingChannel, RingChannelHandler};
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::sample::Sample;

use crate::ClientError;
use crate::compression::decompress;

/// Results that wait to be read.
const RESULTS_KEPT: usize = 1;

/// A camera: announced as long as this is kept, and served by one of the servers.
#[derive(Debug)]
pub struct Camera {
    pairs: Publisher<'static>,
    left: Publisher<'static>,
    right: Publisher<'static>,
    _token: LivelinessToken,
}

impl Camera {
    pub(super) async fn declare(session: &Session, name: &str) -> Result<Self, ClientError> {
        let key = format!("stereo/v1/frames/{name}");
        let publisher = async |key: String, message: &str| {
            let encoding = Encoding::APPLICATION_PROTOBUF.with_schema(format!("stereo.v1.{message}"));
            let declared = session.declare_publisher(key).encoding(encoding).express(true);
            declared.await.map_err(failed)
        };
        Ok(Self {
            pairs: publisher(key.clone(), "StereoRequest").await?,
            left: publisher(format!("{key}/left"), "Image").await?,
            right: publisher(format!("{key}/right"), "Image").await?,
            _token: session
                .liveliness()
                .declare_token(format!("stereo/v1/camera/{name}"))
                .await
                .map_err(failed)?,
        })
    }

    /// Whether a server takes this camera's frames now. What is sent before that is lost.
    ///
    /// # Errors
    /// [`ClientError::Network`] if the session is closed.
    pub async fn is_served(&self) -> Result<bool, ClientError> {
        let status = self.pairs.matching_status().await.map_err(failed)?;
        Ok(status.matching())
    }

    /// Sends a pair. With a sequence number, the server can tell what was lost on the way.
    ///
    /// # Errors
    /// [`ClientError::Network`] if the session is closed. A link that is full drops the frame silently.
    pub async fn send(&self, pair: &StereoRequest) -> Result<(), ClientError> {
        self.pairs.put(pair.encode_to_vec()).await.map_err(failed)
    }

    /// Sends the left image alone; the server brings it together with the right one of the same number, or the same time.
    ///
    /// # Errors
    /// As [`send`](Self::send).
    pub async fn send_left(&self, image: &Image, stamp: &ImageStamp) -> Result<(), ClientError> {
        send_image(&self.left, image, stamp).await
    }

    /// Sends the right image alone.
    ///
    /// # Errors
    /// As [`send`](Self::send).
    pub async fn send_right(&self, image: &Image, stamp: &ImageStamp) -> Result<(), ClientError> {
        send_image(&self.right, image, stamp).await
    }
}

async fn send_image(
    publisher: &Publisher<'static>,
    image: &Image,
    stamp: &ImageStamp,
) -> Result<(), ClientError> {
    publisher
        .put(image.encode_to_vec())
        .attachment(stamp.encode_to_vec())
        .await
        .map_err(failed)
}

/// Results of a camera.
#[derive(Debug)]
pub struct Results(Subscriber<RingChannelHandler<Sample>>);

impl Results {
    pub(super) async fn subscribe(session: &Session, camera: &str) -> Result<Self, ClientError> {
        let subscriber = session
            .declare_subscriber(format!("stereo/v1/results/{camera}"))
            .with(RingChannel::new(RESULTS_KEPT))
            .await;
        subscriber.map(Self).map_err(failed)
    }

    /// Waits for the next result.
    ///
    /// # Errors
    /// [`ClientError::Network`] if the session is closed, [`ClientError::Malformed`] if what comes is no result.
    pub async fn next(&self) -> Result<StereoResult, ClientError> {
        let sample = self.0.recv_async().await.map_err(failed)?;
        let mut result = StereoResult::decode(&*sample.payload().to_bytes())
            .map_err(|why| ClientError::Malformed(why.to_string()))?;
        decompress(&mut result)?;
        Ok(result)
    }
}

fn failed(why: impl std::fmt::Display) -> ClientError {
    ClientError::Network(why.to_string())
}
