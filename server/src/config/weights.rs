//! Whose share of the server is how large.

use std::collections::{BTreeMap, HashMap};
use std::net::IpAddr;
use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use super::{ConfigError, is_name};
use crate::job::client_of_camera;

/// Accepted weights.
pub(super) const WEIGHTS: RangeInclusive<u32> = 1..=1000;

/// Weights of clients; who is not named has 1. A client that asks for more than the others leave is given workers in proportion to its
/// weight among the clients that are active. Only in the file, since they are as many as there are clients:
/// ```toml
/// [weights.cameras]
/// front = 4
/// [weights.addresses]
/// "192.0.2.7" = 2
/// ```
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WeightsConfig {
    /// By camera id, for requests that have one; 1 to 1000.
    pub cameras: BTreeMap<String, u32>,
    /// By the address a request without a camera id came from; 1 to 1000.
    pub addresses: BTreeMap<IpAddr, u32>,
}

impl WeightsConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        if let Some(name) = self.cameras.keys().find(|name| !is_name(name)) {
            return Err(ConfigError::BadName {
                name: "a key of weights.cameras",
                got: name.clone(),
            });
        }
        let cameras = self.cameras.iter();
        let cameras = cameras.map(|(name, &weight)| (format!("weights.cameras.{name}"), weight));
        let addresses = self.addresses.iter();
        let addresses =
            addresses.map(|(address, &weight)| (format!("weights.addresses.\"{address}\""), weight));
        match cameras
            .chain(addresses)
            .find(|(_, weight)| !WEIGHTS.contains(weight))
        {
            Some((client, got)) => Err(ConfigError::BadWeight { client, got }),
            None => Ok(()),
        }
    }

    /// The weights by the names that clients have in requests.
    #[must_use]
    pub fn by_client(&self) -> HashMap<String, u32> {
        let cameras = self.cameras.iter();
        let cameras = cameras.map(|(name, &weight)| (client_of_camera(name), weight));
        let addresses = self.addresses.iter();
        let addresses = addresses.map(|(address, &weight)| (address.to_canonical().to_string(), weight));
        cameras.chain(addresses).collect()
    }
}
