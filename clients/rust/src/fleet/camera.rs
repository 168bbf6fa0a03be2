//! A camera that sends frames, and whoever reads its results.

use std::time::{Duration, Instant};

use prost::Message;
use stereo_proto::v1::{Image, ImageStamp, StereoRequest, StereoResult};
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::handlers::{RingChannel, RingChannelHandler};
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::sample::Sample;

use super::presence::cameras;
use crate::ClientError;
use crate::compression::decompress;

/// Results that wait to be read.
const RESULTS_KEPT: usize = 1;
/// Time between two looks whether a server serves a camera.
const LOOK_AGAIN: Duration = Duration::from_millis(20);

/// A camera: announced as long as this is kept, and served by one of the servers.
#[derive(Debug)]
pub struct Camera {
    name: String,
    session: Session,
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
            name: name.to_owned(),
            session: session.clone(),
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

    /// Waits until a server takes this camera's frames.
    ///
    /// # Errors
    /// [`ClientError::NotServed`] if none does within `limit`, [`ClientError::Network`] if the session is closed.
    pub async fn until_served(&self, limit: Duration) -> Result<(), ClientError> {
        let until = Instant::now() + limit;
        loop {
            let there = cameras(&self.session).await?;
            let is_owned = there
                .iter()
                .any(|camera| camera.name == self.name && camera.served_by.is_some());
            if is_owned && self.is_served().await? {
                return Ok(());
            }
            if Instant::now() >= until {
                return Err(ClientError::NotServed {
                    camera: self.name.clone(),
                    waited: limit,
                });
            }
            tokio::time::sleep(LOOK_AGAIN).await;
        }
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
pub struct Results {
    camera: String,
    session: Session,
    samples: Subscriber<RingChannelHandler<Sample>>,
}

impl Results {
    pub(super) async fn subscribe(session: &Session, camera: &str) -> Result<Self, ClientError> {
        let subscriber = session
            .declare_subscriber(format!("stereo/v1/results/{camera}"))
            .with(RingChannel::new(RESULTS_KEPT))
            .await;
        Ok(Self {
            camera: camera.to_owned(),
            session: session.clone(),
            samples: subscriber.map_err(failed)?,
        })
    }

    /// Waits for the next result, for ever if there is none: [`next_within`](Self::next_within) does not.
    ///
    /// # Errors
    /// [`ClientError::Network`] if the session is closed, [`ClientError::Malformed`] if what comes is no result.
    pub async fn next(&self) -> Result<StereoResult, ClientError> {
        let sample = self.samples.recv_async().await.map_err(failed)?;
        // Copied: shared memory that a client holds when it is killed never comes back to the server.
        let mut result = StereoResult::decode(&*sample.payload().to_bytes())
            .map_err(|why| ClientError::Malformed(why.to_string()))?;
        decompress(&mut result)?;
        Ok(result)
    }

    /// Waits for the next result for so long.
    ///
    /// # Errors
    /// As [`next`](Self::next), and [`ClientError::NoResults`] if none comes, with what is missing.
    pub async fn next_within(&self, limit: Duration) -> Result<StereoResult, ClientError> {
        if let Ok(result) = tokio::time::timeout(limit, self.next()).await {
            return result;
        }
        let there = cameras(&self.session).await?;
        let camera = there.iter().find(|camera| camera.name == self.camera);
        let why = match camera.map(|camera| (camera.is_announced, &camera.served_by)) {
            None | Some((false, _)) => "it is not there: start it, or correct its name".to_owned(),
            Some((true, None)) => "no server serves it: start one on this network".to_owned(),
            Some((true, Some(server))) => {
                format!(
                    "{server} serves it but has answered no frame: `stereo doctor --camera {}` says why",
                    self.camera
                )
            }
        };
        Err(ClientError::NoResults {
            camera: self.camera.clone(),
            waited: limit,
            why,
        })
    }
}

fn failed(why: impl std::fmt::Display) -> ClientError {
    ClientError::Network(why.to_string())
}
