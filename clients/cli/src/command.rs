//! The commands.

pub(crate) mod batch;
pub(crate) mod bench;
pub(crate) mod doctor;
pub(crate) mod info;
pub(crate) mod matching;
pub(crate) mod stream;
pub(crate) mod watch;
