//! In the place of the Zenoh transport, in a build without the feature `zenoh`: says so to those who ask for it.

use std::sync::Arc;

use crate::config::{Config, ConfigError};
use crate::service::Service;
use crate::streams::Streams;

/// What there is none of.
pub enum Prepared {}

/// What there is none of.
pub enum Zenoh {}

impl Prepared {
    /// Nothing, if the configuration asks for nothing.
    ///
    /// # Errors
    /// [`ConfigError::Zenoh`] if it asks for Zenoh.
    pub fn new(config: &Config) -> Result<Option<Self>, ConfigError> {
        match config.zenoh.enabled {
            false => Ok(None),
            true => Err(ConfigError::Zenoh {
                reason: "this program was built without it: turn it off (--no-zenoh), or build with the feature zenoh".to_owned(),
            }),
        }
    }

    /// Never called.
    #[must_use]
    pub fn start(self, _: Arc<Service>, _: Arc<Streams>) -> Zenoh {
        match self {}
    }
}

impl Zenoh {
    /// Never called.
    pub async fn withdraw(&mut self) {
        std::future::ready(()).await;
        match *self {}
    }

    /// Never called.
    pub async fn close(self) {
        std::future::ready(()).await;
        match self {}
    }
}
