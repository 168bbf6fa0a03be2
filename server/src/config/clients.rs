//! Who may ask for what, and whose share of the server is how large.

use std::collections::BTreeSet;
use std::net::IpAddr;
use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use super::{Config, ConfigError, is_name};
use crate::token::TokenHash;

/// Clients at most.
const MOST_CLIENTS: usize = 1024;
/// Patterns of camera names and addresses of one client at most.
const MOST_NAMED: usize = 256;
const WEIGHTS: RangeInclusive<u64> = 1..=1000;
const RATES: RangeInclusive<u64> = 1..=1_000_000;
const BYTES: RangeInclusive<u64> = 1 << 10..=1 << 36;

/// A client, by its name. Once one of them has a token, or [`http.tls.client_ca`](super::TlsConfig::client_ca) is set, a request has to
/// show a token or a certificate with the client's name. Only in the file, since they are as many as there are clients:
/// ```toml
/// [clients.lab]
/// token_sha256 = ".."          # made by `stereod token lab`
/// weight = 4
/// requests_per_second = 60
/// bytes_in_flight = 67108864
/// cameras = ["front", "arm-*"]
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClientConfig {
    /// SHA-256 of its token, 64 hexadecimal digits, as `stereod token` prints it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub token_sha256: Option<TokenHash>,
    /// A client that asks for more than the others leave is given workers in proportion to this among those that are active, 1 to 1000.
    pub weight: u32,
    /// HTTP requests a second, those of a batch one by one, with bursts of up to a second's worth, 1 to 1000000; absent = no bound.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub requests_per_second: Option<u32>,
    /// Bodies of its HTTP requests and replies that are held at one time, in bytes, 1 KiB to 64 GiB; absent = that of all together.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bytes_in_flight: Option<u64>,
    /// Cameras whose frames it may send and whose streams it may see, `*` = any characters; empty = all. Cameras that send over Zenoh
    /// have the weight of the first client whose list names them.
    pub cameras: Vec<String>,
    /// Where nobody has to show who they are: the addresses that its requests come from.
    pub addresses: BTreeSet<IpAddr>,
}

impl Default for ClientConfig {
    fn default() -> Self {
        Self {
            token_sha256: None,
            weight: 1,
            requests_per_second: None,
            bytes_in_flight: None,
            cameras: Vec::new(),
            addresses: BTreeSet::new(),
        }
    }
}

impl Config {
    /// Whether a request has to show a token or a certificate.
    #[must_use]
    pub fn has_doors(&self) -> bool {
        self.http.tls.client_ca.is_some() || self.clients.values().any(|client| client.token_sha256.is_some())
    }

    /// Checks the clients, each and together.
    pub(super) fn validate_clients(&self) -> Result<(), ConfigError> {
        if self.clients.len() > MOST_CLIENTS {
            let reason = format!("there can be {MOST_CLIENTS} at most, got {}", self.clients.len());
            return Err(ConfigError::Client {
                client: "*".to_owned(),
                reason,
            });
        }
        let mut seen: Vec<&TokenHash> = Vec::new();
        for (name, client) in &self.clients {
            let refuse = |reason: String| ConfigError::Client {
                client: name.clone(),
                reason,
            };
            client.validate(name).map_err(refuse)?;
            if self.has_doors() && !client.addresses.is_empty() {
                return Err(refuse(
                    "addresses make nobody known where requests have to show a token or a certificate: leave them out"
                        .to_owned(),
                ));
            }
            if let Some(hash) = &client.token_sha256 {
                if seen.contains(&hash) {
                    return Err(refuse(
                        "another client has the same token: make one for each".to_owned(),
                    ));
                }
                seen.push(hash);
            }
        }
        Ok(())
    }
}

impl ClientConfig {
    /// What is wrong, as a sentence.
    fn validate(&self, name: &str) -> Result<(), String> {
        if !is_name(name) {
            return Err("its name must be 1 to 64 of the characters A-Z a-z 0-9 _ . -".to_owned());
        }
        if self
            .token_sha256
            .as_ref()
            .is_some_and(|hash| !hash.is_well_formed())
        {
            return Err(
                "token_sha256 must be 64 hexadecimal digits, as `stereod token` prints them".to_owned(),
            );
        }
        for (key, value, range) in [
            ("weight", Some(self.weight.into()), WEIGHTS),
            (
                "requests_per_second",
                self.requests_per_second.map(u64::from),
                RATES,
            ),
            ("bytes_in_flight", self.bytes_in_flight, BYTES),
        ] {
            if let Some(got) = value.filter(|value| !range.contains(value)) {
                return Err(format!(
                    "{key} must be {} to {}, got {got}",
                    range.start(),
                    range.end()
                ));
            }
        }
        for (key, count) in [
            ("cameras", self.cameras.len()),
            ("addresses", self.addresses.len()),
        ] {
            if count > MOST_NAMED {
                return Err(format!("{key} can be {MOST_NAMED} at most, got {count}"));
            }
        }
        match self
            .cameras
            .iter()
            .find(|pattern| !is_name(&pattern.replace('*', "_")))
        {
            Some(pattern) => Err(format!(
                "cameras must be of 1 to 64 of the characters A-Z a-z 0-9 _ . - and * for any of them, got {pattern:?}"
            )),
            None => Ok(()),
        }
    }
}
