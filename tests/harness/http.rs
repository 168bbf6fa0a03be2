//! HTTP without TLS, for tests that look at the protocol itself.

use std::sync::Arc;

use rustls::{ClientConfig, RootCertStore};

/// What makes a client. By itself, reqwest looks for cryptography that the process has installed, and panics where there is none.
///
/// # Panics
/// Never: the versions of TLS are those of the library.
#[expect(clippy::disallowed_methods, reason = "this is what is to be used instead")]
pub fn builder() -> reqwest::ClientBuilder {
    let ring = Arc::new(rustls::crypto::ring::default_provider());
    let trusts_nobody = ClientConfig::builder_with_provider(ring)
        .with_safe_default_protocol_versions()
        .expect("versions that ring has")
        .with_root_certificates(RootCertStore::empty())
        .with_no_client_auth();
    reqwest::Client::builder().tls_backend_preconfigured(trusts_nobody)
}
