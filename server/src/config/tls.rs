//! TLS of the HTTP transport.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::ConfigError;

/// TLS of the HTTP transport, on once there is a certificate. All of these are PEM files, read again when they change and on SIGHUP.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TlsConfig {
    /// The server's certificate, then those between it and its authority.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cert: Option<PathBuf>,
    /// Its private key.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub key: Option<PathBuf>,
    /// The authorities whose certificates make clients known: by the common name or a DNS name, which is that of a client of the
    /// configuration. Who shows none has to show a token.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub client_ca: Option<PathBuf>,
}

impl TlsConfig {
    /// Whether connections are encrypted.
    #[must_use]
    pub fn is_on(&self) -> bool {
        self.cert.is_some()
    }

    /// Checks that nothing is missing; the files are read later.
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let reason = match (&self.cert, &self.key, &self.client_ca) {
            (Some(_), None, _) => "http.tls.cert needs its private key, http.tls.key (--tls-key)",
            (None, Some(_), _) => "http.tls.key needs its certificate, http.tls.cert (--tls-cert)",
            (None, None, Some(_)) => {
                "http.tls.client_ca needs a certificate of the server, http.tls.cert and http.tls.key (--tls-cert, --tls-key)"
            }
            _ => return Ok(()),
        };
        Err(ConfigError::Tls {
            reason: reason.to_owned(),
        })
    }
}
