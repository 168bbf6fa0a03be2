//! Who a client is to a server, and whom it trusts: tokens and TLS.

use std::fmt;
use std::sync::Arc;

use bytes::Bytes;
use reqwest::header::HeaderValue;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::{AlertDescription, CertificateError, ClientConfig, InvalidMessage, RootCertStore};
use rustls_platform_verifier::Verifier;

use crate::ClientError;

/// What a server asks of its clients, and what they ask of it.
#[derive(Clone, Default)]
pub struct Access {
    /// The client's token, as `stereod token` prints it; goes with every request.
    pub token: Option<String>,
    /// Certificates in PEM of the authorities one of which has to have signed the server's; absent: those that this system trusts.
    pub ca_pem: Option<Bytes>,
    /// The client's own certificate, with what links it to its authority, and its private key, all in PEM; for servers that ask for one.
    pub identity_pem: Option<Bytes>,
}

/// Without secrets.
impl fmt::Debug for Access {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Access")
            .field("token", &self.token.is_some())
            .field("ca_pem", &self.ca_pem.is_some())
            .field("identity_pem", &self.identity_pem.is_some())
            .finish()
    }
}

impl Access {
    /// The header that shows the token.
    pub(crate) fn authorization(&self) -> Result<Option<HeaderValue>, ClientError> {
        let Some(token) = &self.token else {
            return Ok(None);
        };
        let mut value = HeaderValue::from_str(&format!("Bearer {token}"))
            .ok()
            .filter(|_| !token.is_empty() && token.bytes().all(|byte| byte.is_ascii_graphic()))
            .ok_or_else(|| {
                unusable(
                    "token",
                    "it has other characters than tokens have: give one as `stereod token` prints it",
                )
            })?;
        value.set_sensitive(true);
        Ok(Some(value))
    }

    /// How TLS is spoken. Only `ring` is asked for cryptography, whatever else the program has; where no TLS is spoken, nobody is trusted.
    pub(crate) fn tls(&self, is_spoken: bool) -> Result<ClientConfig, ClientError> {
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let versions = ClientConfig::builder_with_provider(Arc::clone(&provider))
            .with_safe_default_protocol_versions()
            .map_err(|why| unusable("TLS", &why.to_string()))?;
        let roots = match &self.ca_pem {
            Some(pem) => versions.with_root_certificates(authorities(pem)?),
            None if is_spoken => {
                let system = Verifier::new(provider).map_err(|why| {
                    unusable(
                        "system's trust",
                        &format!("{why}: give the authority of the server"),
                    )
                })?;
                versions
                    .dangerous()
                    .with_custom_certificate_verifier(Arc::new(system))
            }
            None => versions.with_root_certificates(RootCertStore::empty()),
        };
        match &self.identity_pem {
            None => Ok(roots.with_no_client_auth()),
            Some(pem) => {
                let (chain, key) = identity(pem)?;
                roots.with_client_auth_cert(chain, key).map_err(|why| {
                    unusable(
                        "client's certificate",
                        &format!("{why}: give a certificate and its own key"),
                    )
                })
            }
        }
    }
}

fn unusable(what: &'static str, why: &str) -> ClientError {
    ClientError::BadAccess {
        what,
        why: why.to_owned(),
    }
}

fn authorities(pem: &[u8]) -> Result<RootCertStore, ClientError> {
    let what = "authority's certificate";
    let mut roots = RootCertStore::empty();
    for certificate in CertificateDer::pem_slice_iter(pem) {
        certificate
            .ok()
            .and_then(|certificate| roots.add(certificate).ok())
            .ok_or_else(|| unusable(what, "it is damaged: copy it anew"))?;
    }
    match roots.is_empty() {
        true => Err(unusable(what, "there is none in it: give a PEM file")),
        false => Ok(roots),
    }
}

fn identity(pem: &[u8]) -> Result<(Vec<CertificateDer<'static>>, PrivateKeyDer<'static>), ClientError> {
    let what = "client's certificate";
    let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(pem).collect();
    let chain = chain.map_err(|why| unusable(what, &format!("{why}: copy it anew")))?;
    if chain.is_empty() {
        return Err(unusable(what, "there is none in it: give a PEM file"));
    }
    let key = PrivateKeyDer::from_pem_slice(pem).map_err(|_| {
        unusable(
            what,
            "its private key is not with it: give both in PEM, the key without a password",
        )
    })?;
    Ok((chain, key))
}

/// What TLS has against a connection and what to do about it, if it is TLS that failed.
pub(crate) fn tls_trouble(error: &(dyn std::error::Error + 'static)) -> Option<String> {
    let mut cause = Some(error);
    while let Some(error) = cause {
        if let Some(error) = error.downcast_ref::<rustls::Error>() {
            return Some(in_words(error));
        }
        // What an `io::Error` holds is not what it names as its cause.
        cause = match error
            .downcast_ref::<std::io::Error>()
            .and_then(std::io::Error::get_ref)
        {
            Some(held) => Some(held),
            None => error.source(),
        };
    }
    None
}

fn in_words(error: &rustls::Error) -> String {
    use rustls::Error::{AlertReceived, InvalidCertificate};
    match error {
        // Another authority of the same name has signed it, or none that is known.
        InvalidCertificate(CertificateError::BadSignature | CertificateError::UnknownIssuer) => {
            "its certificate is signed by nobody who is trusted here: give the certificate of its authority"
                .to_owned()
        }
        InvalidCertificate(
            CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. },
        ) => "its certificate is for another name: use the name that it is for".to_owned(),
        InvalidCertificate(CertificateError::Expired | CertificateError::ExpiredContext { .. }) => {
            "its certificate has expired: renew it, or set this machine's clock".to_owned()
        }
        InvalidCertificate(why) => {
            format!("its certificate is not accepted ({why}): give the server another one")
        }
        rustls::Error::InvalidMessage(InvalidMessage::InvalidContentType) => {
            "what answers there speaks no TLS: use http://, or correct the port".to_owned()
        }
        AlertReceived(AlertDescription::CertificateRequired) => {
            "it asks for a certificate of its clients: give one that its authority has signed, with the key"
                .to_owned()
        }
        AlertReceived(alert) => {
            format!(
                "it has ended the handshake ({alert:?}): give a client's certificate that it accepts, or look into its log"
            )
        }
        why => format!("TLS failed ({why}): look into the server's log"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_can_not_be_shown_is_refused_without_being_told() {
        for token in ["", "two words", "line\nbreak", "ü"] {
            let access = Access {
                token: Some(token.to_owned()),
                ..Access::default()
            };
            let error = access.authorization().unwrap_err().to_string();
            assert!(error.contains("`stereod token`"), "{error}");
            assert!(token.is_empty() || !error.contains(token), "{error}");
        }
        let access = Access {
            token: Some("secret".to_owned()),
            identity_pem: Some("secret".into()),
            ..Access::default()
        };
        let header = access.authorization().unwrap().unwrap();
        assert_eq!(header, "Bearer secret");
        assert!(!format!("{access:?} {header:?}").contains("secret"));
    }

    #[test]
    fn certificates_that_are_none_are_refused_by_name() {
        let pem = |text: &str| Some(Bytes::copy_from_slice(text.as_bytes()));
        let damaged = "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n";
        for (ca_pem, identity_pem, word) in [
            (pem("no pem"), None, "authority's certificate"),
            (pem(damaged), None, "damaged"),
            (None, pem("no pem"), "client's certificate"),
            (None, pem(damaged), "private key"),
        ] {
            let access = Access {
                ca_pem,
                identity_pem,
                ..Access::default()
            };
            let error = access.tls(false).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
    }
}
