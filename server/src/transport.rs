//! The ways frames come in. Each turns bytes into a `FrameRequest`, submits it, and turns what comes back into bytes.

pub mod http;
pub mod zenoh;
