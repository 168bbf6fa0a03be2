//! The ways frames come in. Each turns bytes into a `FrameRequest`, submits it, and turns what comes back into bytes.

pub mod http;
#[cfg(feature = "zenoh")]
pub mod zenoh;
#[cfg(not(feature = "zenoh"))]
#[path = "transport/no_zenoh.rs"]
pub mod zenoh;
