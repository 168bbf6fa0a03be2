//! Authorities, certificates, and a client over TLS, of HTTP/1.1 and HTTP/2.

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;

use bytes::Bytes;
use http_body_util::{BodyExt, Full};
use hyper::{Request, Response};
use hyper_util::rt::{TokioExecutor, TokioIo};
use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, DnType, IsCa, KeyPair};
use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::{ClientConfig, RootCertStore};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;

/// Who signs certificates.
pub(crate) struct Authority(CertifiedIssuer<'static, KeyPair>);

/// A certificate and its key, as PEM.
pub(crate) struct Identity {
    pub(crate) certificate: String,
    pub(crate) key: String,
}

impl Authority {
    pub(crate) fn new() -> Self {
        let mut params = CertificateParams::new([]).expect("no names");
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        Self(CertifiedIssuer::self_signed(params, new_key()).expect("a certificate"))
    }

    pub(crate) fn pem(&self) -> String {
        self.0.pem()
    }

    /// A certificate for 127.0.0.1.
    pub(crate) fn of_server(&self) -> Identity {
        self.sign(&["127.0.0.1"], |_| {})
    }

    /// A certificate whose common name this is.
    pub(crate) fn of_client(&self, name: &str) -> Identity {
        self.sign(&[], |params| {
            params.distinguished_name.push(DnType::CommonName, name)
        })
    }

    /// A certificate for `subjects`, changed by `change`.
    pub(crate) fn sign(&self, subjects: &[&str], change: impl FnOnce(&mut CertificateParams)) -> Identity {
        let subjects = Vec::from_iter(subjects.iter().map(|&subject| subject.to_owned()));
        let mut params = CertificateParams::new(subjects).expect("proper names");
        params.distinguished_name = rcgen::DistinguishedName::new();
        change(&mut params);
        let key = new_key();
        let certificate = params.signed_by(&key, &self.0).expect("a certificate");
        Identity {
            certificate: certificate.pem(),
            key: key.serialize_pem(),
        }
    }
}

fn new_key() -> KeyPair {
    KeyPair::generate().expect("a key")
}

/// A folder of PEM files that is gone when this is dropped.
pub(crate) struct Files(PathBuf);

impl Files {
    pub(crate) fn new(test: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("stereod-tls-{test}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a writable folder");
        Self(folder)
    }

    /// Writes a file as those do who replace certificates, in one step; its path.
    pub(crate) fn write(&self, name: &str, text: &str) -> String {
        let (next, path) = (self.0.join("next"), self.0.join(name));
        std::fs::write(&next, text).expect("a writable folder");
        std::fs::rename(&next, &path).expect("a writable folder");
        path.to_str().expect("a plain path").to_owned()
    }

    /// Flags of a server with this certificate.
    pub(crate) fn flags(&self, identity: &Identity) -> Vec<String> {
        let cert = self.write("server.pem", &identity.certificate);
        let key = self.write("server-key.pem", &identity.key);
        ["--tls-cert", &cert, "--tls-key", &key]
            .map(str::to_owned)
            .to_vec()
    }
}

impl Drop for Files {
    fn drop(&mut self) {
        drop(std::fs::remove_dir_all(&self.0));
    }
}

/// A client that trusts one authority and may show a certificate of its own.
pub(crate) struct TlsClient {
    server: SocketAddr,
    config: ClientConfig,
}

/// An answer.
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) body: Bytes,
}

impl TlsClient {
    /// For the server at `url`, `https://ADDRESS`.
    pub(crate) fn new(url: &str, authority: &Authority, identity: Option<&Identity>) -> Self {
        let server = url.strip_prefix("https://").expect("a server with TLS");
        let mut roots = RootCertStore::empty();
        let root = CertificateDer::from_pem_slice(authority.pem().as_bytes()).expect("PEM");
        roots.add(root).expect("an authority");
        let builder = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .expect("ring has them")
            .with_root_certificates(roots);
        let config = match identity {
            None => builder.with_no_client_auth(),
            Some(Identity { certificate, key }) => {
                let chain = vec![CertificateDer::from_pem_slice(certificate.as_bytes()).expect("PEM")];
                let key = PrivateKeyDer::from_pem_slice(key.as_bytes()).expect("PEM");
                builder.with_client_auth_cert(chain, key).expect("a pair")
            }
        };
        Self {
            server: server.parse().expect("an address"),
            config,
        }
    }

    /// A connection after its handshake, on which the client offers one protocol.
    ///
    /// # Errors
    /// What they didn't come to terms about, as far as this side knows.
    pub(crate) async fn connect(&self, protocol: &str) -> io::Result<TlsStream<TcpStream>> {
        let stream = TcpStream::connect(self.server).await?;
        let mut config = self.config.clone();
        config.alpn_protocols = vec![protocol.as_bytes().to_vec()];
        let name = self.server.ip().into();
        TlsConnector::from(Arc::new(config)).connect(name, stream).await
    }

    /// Sends one request on a connection of its own. In TLS 1.3 a server that refuses a client's certificate says so only now.
    ///
    /// # Errors
    /// What ended the connection before there was an answer.
    pub(crate) async fn send(&self, protocol: &str, mut request: Request<Full<Bytes>>) -> io::Result<Answer> {
        let stream = TokioIo::new(self.connect(protocol).await?);
        let answer = if protocol == "h2" {
            let (mut sender, connection) =
                hyper::client::conn::http2::handshake(TokioExecutor::new(), stream)
                    .await
                    .map_err(io::Error::other)?;
            tokio::spawn(connection);
            sender.send_request(request).await
        } else {
            *request.uri_mut() = request.uri().path().parse().expect("a path");
            let (mut sender, connection) = hyper::client::conn::http1::handshake(stream)
                .await
                .map_err(io::Error::other)?;
            tokio::spawn(connection);
            sender.send_request(request).await
        };
        let (head, body) = answer.map_err(io::Error::other).map(Response::into_parts)?;
        Ok(Answer {
            status: head.status.as_u16(),
            body: body.collect().await.map_err(io::Error::other)?.to_bytes(),
        })
    }

    /// The status of a GET by HTTP/1.1, with a token if there is one.
    pub(crate) async fn get(&self, path: &str, token: Option<&str>) -> io::Result<u16> {
        let answer = self.send("http/1.1", self.request("GET", path, token, Bytes::new()));
        Ok(answer.await?.status)
    }

    /// A request as this client would send it.
    pub(crate) fn request(
        &self,
        method: &str,
        path: &str,
        token: Option<&str>,
        body: impl Into<Bytes>,
    ) -> Request<Full<Bytes>> {
        let mut request = Request::builder()
            .method(method)
            .uri(format!("https://{}{path}", self.server))
            .header("host", self.server.to_string())
            .header("content-type", crate::conversation::PROTOBUF);
        if let Some(token) = token {
            request = request.header("authorization", format!("Bearer {token}"));
        }
        request.body(Full::new(body.into())).expect("a request")
    }
}
