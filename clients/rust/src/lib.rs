//! Client of stereod: a stereo pair and a latency budget in, disparity and mesh out. [`Client`] talks to one server over HTTP, [`Fleet`]
//! to all servers that a Zenoh session reaches.
//!
//! ```no_run
//! use stereo_client::v1::{Image, ImageEncoding, StereoRequest};
//! use stereo_client::{Client, disparity_px};
//!
//! # async fn example(left: bytes::Bytes, right: bytes::Bytes) -> Result<(), stereo_client::ClientError> {
//! let client = Client::new("http://127.0.0.1:8080")?;
//! let png = |data| Some(Image { encoding: ImageEncoding::Png.into(), data, ..Image::default() });
//! let request = StereoRequest { left: png(left), right: png(right), ..StereoRequest::default() };
//! let result = client.match_pair(&request).await?;
//! if let Some(disparity) = &result.disparity {
//!     let px: Vec<f32> = disparity_px(disparity)?;
//! }
//! # Ok(())
//! # }
//! ```
//!
//! The same over Zenoh, at whichever server has room, and a camera with its results:
//!
//! ```no_run
//! # use stereo_client::v1::StereoRequest;
//! # async fn example(pair: StereoRequest) -> Result<(), stereo_client::ClientError> {
//! let fleet = stereo_client::Fleet::connect(&["tcp/127.0.0.1:7447"]).await?;
//! let result = fleet.match_pair(&pair).await?;
//!
//! let camera = fleet.camera("front").await?;
//! let results = fleet.results("front").await?;
//! camera.send(&StereoRequest { sequence: Some(1), ..pair }).await?;
//! let newest = results.next().await?;
//! # Ok(())
//! # }
//! ```
#![forbid(unsafe_code)]

mod access;
mod batch;
mod client;
mod compression;
mod error;
#[cfg(feature = "zenoh")]
mod fleet;
mod info;
mod payload;
mod reply;
mod streams;

pub use access::Access;
pub use batch::BatchReplies;
pub use client::{Client, PairFiles};
pub use error::ClientError;
#[cfg(feature = "zenoh")]
pub use fleet::{Camera, CameraPresence, Fleet, Results};
pub use info::{Info, Limits, PresetInfo};
pub use payload::{depth_m, disparity_px};
pub use reply::{Accept, Reply, StageTimes};
/// The messages of the wire.
pub use stereo_proto::v1;
pub use streams::{
    CameraStream, Frames, Images, LastResult, Network, Rates, Readiness, StreamReport, Streams, Unpaired,
};
