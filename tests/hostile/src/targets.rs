//! The targets, one decoder a file.

pub(crate) mod batch;
pub(crate) mod config;
pub(crate) mod files;
pub(crate) mod form;
pub(crate) mod http;
pub(crate) mod options;
pub(crate) mod pixels;
pub(crate) mod request;
pub(crate) mod zenoh;
