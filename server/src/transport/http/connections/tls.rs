//! TLS: the server's certificate, whose certificates it takes, and both anew when their files change.

use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime};

use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::server::WebPkiClientVerifier;
use rustls::{RootCertStore, ServerConfig, ServerConnection};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::task::spawn_blocking;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;
use x509_parser::extensions::GeneralName;
use x509_parser::parse_x509_certificate;

use crate::config::{ConfigError, TlsConfig, is_name};

/// How often the files are looked at.
const LOOK: Duration = Duration::from_secs(2);
/// What TLS begins with: the type of a record of its handshake.
const HANDSHAKE: u8 = 22;
/// Versions of HTTP, the better one first.
const PROTOCOLS: [&[u8]; 2] = [b"h2", b"http/1.1"];

/// What a connection is encrypted with, as it is now.
pub struct Tls {
    files: TlsConfig,
    current: Mutex<Arc<ServerConfig>>,
}

/// The names in a client's certificate that may be one of a client of the configuration: common names, then DNS names. Empty if there is
/// none. An extension of each request.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(in crate::transport::http) struct CertifiedNames(pub(in crate::transport::http) Arc<[String]>);

impl Tls {
    /// What `files` say; `None` if they are not to be used.
    ///
    /// # Errors
    /// Which of them is no good, and why.
    pub fn load(files: &TlsConfig) -> Result<Option<Arc<Self>>, ConfigError> {
        if !files.is_on() {
            return Ok(None);
        }
        let current = read(files).map_err(|reason| ConfigError::Tls { reason })?;
        Ok(Some(Arc::new(Self {
            files: files.clone(),
            current: Mutex::new(current),
        })))
    }

    /// Encrypts a connection.
    ///
    /// # Errors
    /// What the client and TLS could not come to terms about.
    pub(super) async fn accept<S: AsyncRead + AsyncWrite + Unpin>(
        &self,
        stream: S,
    ) -> io::Result<TlsStream<S>> {
        let current = Arc::clone(&self.current.lock().unwrap_or_else(PoisonError::into_inner));
        TlsAcceptor::from(current).accept(stream).await
    }

    /// Reads the files again whenever they have changed, and when SIGHUP comes. New connections get what they say then; if they are no good,
    /// what they said before.
    pub(super) async fn keep_current(self: Arc<Self>) {
        let mut hang_ups = signal(SignalKind::hangup())
            .inspect_err(|error| tracing::warn!(%error, "SIGHUP can't be received: TLS goes by its files' times alone"))
            .ok();
        let mut seen = self.times();
        loop {
            let is_asked_for = tokio::select! {
                () = hang_up(&mut hang_ups) => true,
                () = tokio::time::sleep(LOOK) => false,
            };
            let this = Arc::clone(&self);
            let before = seen.clone();
            let looked = spawn_blocking(move || {
                let times = this.times();
                if is_asked_for || times != before {
                    this.reload();
                }
                times
            });
            // It doesn't panic, and whether the runtime ends is all the same.
            seen = looked.await.unwrap_or(seen);
        }
    }

    fn reload(&self) {
        match read(&self.files) {
            Ok(read) => {
                *self.current.lock().unwrap_or_else(PoisonError::into_inner) = read;
                tracing::info!("TLS: new connections get what the files say now");
            }
            Err(reason) => tracing::error!(reason, "TLS stays as it was: its files can't be used"),
        }
    }

    /// When each file was changed last.
    fn times(&self) -> Vec<Option<SystemTime>> {
        let TlsConfig { cert, key, client_ca } = &self.files;
        let files = [cert, key, client_ca].into_iter().flatten();
        files
            .map(|file| file.metadata().and_then(|file| file.modified()).ok())
            .collect()
    }
}

/// Waits for SIGHUP, if it can be received.
async fn hang_up(signal: &mut Option<Signal>) {
    match signal {
        Some(signal) => drop(signal.recv().await),
        None => std::future::pending().await,
    }
}

/// Whether a connection begins as TLS does. Waits for its first byte and leaves it unread.
pub(super) async fn begins(stream: &TcpStream) -> io::Result<bool> {
    let mut first = [0];
    Ok(stream.peek(&mut first).await? == 0 || first[0] == HANDSHAKE)
}

/// Who the client is by the certificate it has shown, which has been verified.
pub(super) fn certified_names(connection: &ServerConnection) -> CertifiedNames {
    let certificate = connection.peer_certificates().and_then(<[_]>::first);
    CertifiedNames(certificate.map_or_else(Default::default, |certificate| names(certificate).into()))
}

fn names(certificate: &CertificateDer<'_>) -> Vec<String> {
    let Ok((_, certificate)) = parse_x509_certificate(certificate) else {
        return Vec::new();
    };
    let common = certificate.subject().iter_common_name();
    let common = common.filter_map(|name| name.as_str().ok());
    let others = certificate.subject_alternative_name().ok().flatten();
    let others = others.iter().flat_map(|names| &names.value.general_names);
    let dns = others.filter_map(|name| match name {
        GeneralName::DNSName(name) => Some(*name),
        _ => None,
    });
    common
        .chain(dns)
        .filter(|name| is_name(name))
        .map(str::to_owned)
        .collect()
}

/// What the files say.
///
/// # Errors
/// Which of them is no good, and why; never what is in it.
fn read(files: &TlsConfig) -> Result<Arc<ServerConfig>, String> {
    let (Some(cert), Some(key)) = (&files.cert, &files.key) else {
        return Err("a certificate and its private key are needed".to_owned());
    };
    let chain = certificates(cert)?;
    let private = PrivateKeyDer::from_pem_file(key)
        .map_err(|why| format!("{} has no private key: {why}", key.display()))?;
    let provider = Arc::new(ring::default_provider());
    let builder = ServerConfig::builder_with_provider(Arc::clone(&provider))
        .with_safe_default_protocol_versions()
        .map_err(|why| why.to_string())?;
    let builder = match &files.client_ca {
        None => builder.with_no_client_auth(),
        Some(file) => {
            let mut authorities = RootCertStore::empty();
            for authority in certificates(file)? {
                let added = authorities.add(authority);
                added.map_err(|why| format!("{} has no authority: {why}", file.display()))?;
            }
            // Whoever shows none may show a token, and needs neither to see whether the server is alive: that is for the door to decide.
            let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(authorities), provider)
                .allow_unauthenticated()
                .build()
                .map_err(|why| format!("{}: {why}", file.display()))?;
            builder.with_client_cert_verifier(verifier)
        }
    };
    let mut config = builder.with_single_cert(chain, private).map_err(|why| {
        format!(
            "{} and {} don't go together: {why}",
            cert.display(),
            key.display()
        )
    })?;
    config.alpn_protocols = PROTOCOLS.map(<[u8]>::to_vec).to_vec();
    Ok(Arc::new(config))
}

fn certificates(file: &Path) -> Result<Vec<CertificateDer<'static>>, String> {
    let read = CertificateDer::pem_file_iter(file).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    match read {
        Ok(found) if found.is_empty() => Err(format!("{} has no certificate", file.display())),
        Ok(found) => Ok(found),
        Err(why) => Err(format!("{} can't be read: {why}", file.display())),
    }
}
