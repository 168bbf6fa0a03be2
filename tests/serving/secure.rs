//! Tokens and TLS, as the Rust client and the command line have them. TLS ends at a reverse proxy here, with the configuration of any
//! server on rustls.

use std::net::SocketAddr;
use std::process::Command;
use std::sync::{Arc, mpsc};

use bytes::Bytes;
use futures_util::{StreamExt, stream};
use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, IsCa, KeyPair, date_time_ymd};
use rustls::pki_types::{PrivateKeyDer, PrivatePkcs8KeyDer};
use rustls::server::WebPkiClientVerifier;
use rustls::{RootCertStore, ServerConfig};
use stereo_client::{Access, Client, ClientError};
use stereo_tests::process::client_binary;
use tokio::io::copy_bidirectional;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::oneshot;
use tokio_rustls::TlsAcceptor;

use crate::command_line::{Folder, Said, stereo};
use crate::conversation::{PAIR, Server, message};
use crate::doors::{ConfigFile, token};

/// Whoever signs certificates.
struct Authority(CertifiedIssuer<'static, KeyPair>);

/// A certificate with its key.
struct Issued {
    certificate: rcgen::Certificate,
    key: KeyPair,
}

impl Authority {
    fn new() -> Self {
        let mut authority = CertificateParams::default();
        authority.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        Self(
            CertifiedIssuer::self_signed(authority, KeyPair::generate().expect("a key"))
                .expect("a certificate"),
        )
    }

    fn issue(&self, name: &str, until_year: i32) -> Issued {
        let key = KeyPair::generate().expect("a key");
        let mut params = CertificateParams::new([name.to_owned()]).expect("a name");
        params.not_before = date_time_ymd(2000, 1, 1);
        params.not_after = date_time_ymd(until_year, 1, 1);
        let certificate = params.signed_by(&key, &self.0).expect("a certificate");
        Issued { certificate, key }
    }

    fn pem(&self) -> Bytes {
        self.0.pem().into()
    }

    /// What a server with a certificate for `name` speaks TLS with; with `asks`, it wants its clients to be known to the authority.
    fn config(&self, name: &str, until_year: i32, asks: bool) -> ServerConfig {
        let Issued { certificate, key } = self.issue(name, until_year);
        let ring = Arc::new(rustls::crypto::ring::default_provider());
        let versions = ServerConfig::builder_with_provider(Arc::clone(&ring))
            .with_safe_default_protocol_versions()
            .expect("versions that ring has");
        let mut roots = RootCertStore::empty();
        roots.add(self.0.der().clone()).expect("an authority");
        let clients = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), ring)
            .build()
            .expect("an authority");
        let who = match asks {
            true => versions.with_client_cert_verifier(clients),
            false => versions.with_no_client_auth(),
        };
        let key = PrivateKeyDer::from(PrivatePkcs8KeyDer::from(key.serialize_der()));
        who.with_single_cert(vec![certificate.der().clone()], key)
            .expect("a key of its certificate")
    }
}

impl Issued {
    fn pem(&self) -> Bytes {
        format!("{}{}", self.certificate.pem(), self.key.serialize_pem()).into()
    }
}

/// A proxy with threads of its own: the command line is waited for without letting others go on.
struct Terminator {
    port: u16,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Terminator {
    /// Passes on to `server` what comes by TLS.
    fn start(server: &Server, config: ServerConfig) -> Self {
        let url = server.process.url().trim_start_matches("http://").to_owned();
        let server: SocketAddr = url.parse().expect("an address");
        let (stop, stopped) = oneshot::channel();
        let (tell, told) = mpsc::sync_channel(1);
        let work = async move {
            let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
            let port = listener.local_addr().expect("an address").port();
            tell.send(port).expect("somebody waits");
            let acceptor = TlsAcceptor::from(Arc::new(config));
            tokio::select! {
                () = accept(&listener, &acceptor, server) => {}
                _ = stopped => {}
            }
        };
        let run = || {
            let runtime = tokio::runtime::Runtime::new().expect("threads");
            runtime.block_on(work);
        };
        let thread = std::thread::Builder::new()
            .name("terminator".into())
            .spawn(run)
            .expect("a thread");
        Self {
            port: told.recv().expect("a port"),
            stop: Some(stop),
            thread: Some(thread),
        }
    }

    fn url(&self, host: &str) -> String {
        format!("https://{host}:{}", self.port)
    }
}

impl Drop for Terminator {
    fn drop(&mut self) {
        drop(self.stop.take());
        drop(self.thread.take().map(std::thread::JoinHandle::join));
    }
}

async fn accept(listener: &TcpListener, acceptor: &TlsAcceptor, server: SocketAddr) {
    loop {
        let (visitor, _) = listener.accept().await.expect("a listener that stays");
        let acceptor = acceptor.clone();
        tokio::spawn(async move {
            // Who is not trusted, or does not trust, is what the tests are about.
            let Ok(mut secure) = acceptor.accept(visitor).await else {
                return;
            };
            if let Ok(mut plain) = TcpStream::connect(server).await {
                drop(copy_bidirectional(&mut secure, &mut plain).await);
            }
        });
    }
}

fn trusting(ca_pem: Bytes) -> Access {
    Access {
        ca_pem: Some(ca_pem),
        ..Access::default()
    }
}

async fn failure(url: &str, access: &Access) -> ClientError {
    let client = Client::with_access(url, access).expect("an address");
    client.info().await.expect_err("nobody who is trusted")
}

#[tokio::test]
async fn pairs_and_batches_go_by_tls() {
    let server = Server::start(&[]);
    server.until_ready().await;
    let authority = Authority::new();
    let tls = Terminator::start(&server, authority.config("localhost", 2099, false));
    let client = Client::with_access(&tls.url("localhost"), &trusting(authority.pem())).expect("an address");
    let result = client.match_pair(&message()).await.expect("a result");
    let plain = Client::new(server.process.url()).expect("an address");
    let expected = plain.match_pair(&message()).await.expect("a result");
    assert!(result.disparity == expected.disparity);
    let requests = stream::iter((0..10).map(|_| message()));
    let replies = client.match_batch(requests).await.expect("a batch");
    assert_eq!(
        replies
            .filter(|reply| std::future::ready(reply.is_ok()))
            .count()
            .await,
        10
    );
}

#[tokio::test]
async fn whoever_is_not_vouched_for_is_not_talked_to() {
    let server = Server::start(&[]);
    let authority = Authority::new();
    let ours = trusting(authority.pem());
    let good = Terminator::start(&server, authority.config("localhost", 2099, false));
    let old = Terminator::start(&server, authority.config("localhost", 2001, false));
    let other = trusting(Authority::new().pem());
    for (url, access, words) in [
        (
            good.url("localhost"),
            &Access::default(),
            "signed by nobody who is trusted here",
        ),
        (
            good.url("localhost"),
            &other,
            "signed by nobody who is trusted here",
        ),
        (good.url("127.0.0.1"), &ours, "for another name"),
        (old.url("localhost"), &ours, "has expired"),
        (
            server.process.url().replace("http://", "https://"),
            &ours,
            "speaks no TLS: use http://",
        ),
    ] {
        let error = failure(&url, access).await;
        assert!(matches!(error, ClientError::Insecure { .. }), "{error:?}");
        assert!(error.to_string().contains(words), "{error}");
    }
    let error = failure(&good.url("localhost").replace("https://", "http://"), &ours).await;
    assert!(error.to_string().contains("use https://"), "{error}");
}

#[tokio::test]
async fn a_server_that_asks_its_clients_for_certificates_gets_them() {
    let server = Server::start(&[]);
    let authority = Authority::new();
    let tls = Terminator::start(&server, authority.config("localhost", 2099, true));
    let known = Access {
        identity_pem: Some(authority.issue("robot", 2099).pem()),
        ..trusting(authority.pem())
    };
    let client = Client::with_access(&tls.url("localhost"), &known).expect("an address");
    assert_eq!(client.info().await.expect("an answer").workers, 1);
    // Its alert is lost if it closes on what has been sent meanwhile; what to do is said in either case.
    let error = failure(&tls.url("localhost"), &trusting(authority.pem())).await;
    assert!(
        error
            .to_string()
            .contains("asks for a certificate of its clients"),
        "{error}"
    );
}

/// `info` with all of the flags but one.
fn info_without<'a>(flags: &[&'a str], left_out: &str) -> Vec<&'a str> {
    let mut args = vec!["info"];
    for flag in flags.chunks(2).filter(|flag| flag[0] != left_out) {
        args.extend(flag);
    }
    args
}

#[tokio::test]
async fn the_command_line_has_the_same_as_flags_and_variables() {
    let (lab, section) = token("lab");
    let config = ConfigFile::new("command-line-tokens", &section);
    let server = Server::start(&["--config", config.path()]);
    server.until_ready().await;
    let authority = Authority::new();
    let tls = Terminator::start(&server, authority.config("localhost", 2099, true));
    let url = tls.url("localhost");
    let folder = Folder::new("secure");
    let ca = folder.write("ca.pem", &authority.pem());
    let cert = folder.write("robot.pem", &authority.issue("robot", 2099).pem());
    let token_file = folder.write("token", format!("{lab}\n").as_bytes());
    let [left, right] =
        [("left.png", &PAIR.left), ("right.png", &PAIR.right)].map(|(name, file)| folder.write(name, file));

    let pair = ["match", &left, &right, "--budget", "60s"];
    let at_file = format!("@{token_file}");
    let flags = ["--ca", &ca, "--cert", &cert, "--token", &at_file];
    stereo(&url, &[&pair[..], &flags].concat()).assert(0, &["3 of 3 iterations"]);
    let output = Command::new(client_binary().expect("a binary that builds"))
        .args(["info", "--json"])
        .envs([("STEREO_SERVER", url.as_str()), ("STEREO_TOKEN", lab.as_str())])
        .envs([("STEREO_CA", &ca), ("STEREO_CERT", &cert)])
        .output()
        .expect("a program that cargo has built");
    assert_eq!(Said::new(output).json()[0]["info"]["workers"], 1);

    stereo(&url, &info_without(&flags, "--token"))
        .assert(4, &["refused with UNAUTHENTICATED (HTTP 401)", "--token"]);
    stereo(&url, &info_without(&flags, "--ca")).assert(
        3,
        &[
            "no secure connection",
            "give the certificate of its authority",
            "--ca",
        ],
    );
    stereo(&url, &info_without(&flags, "--cert")).assert(3, &["asks for a certificate of its clients"]);
    stereo(&url, &["info", "--ca", "no-such.pem"]).assert(2, &["--ca no-such.pem can't be read"]);
    stereo(&url, &["info", "--ca", &token_file]).assert(2, &["authority's certificate can't be used"]);
    stereo(&url, &["info", "--key", &cert]).assert(2, &["--cert"]);
    stereo(&url, &["info", "--token", "two words"]).assert(2, &["token can't be used"]);
    let help = stereo(&url, &["--help", "--token", &lab]).stdout();
    assert!(help.contains("STEREO_TOKEN") && !help.contains(&lab), "{help}");
}
