//! TLS and clients' certificates.

use std::time::Duration;

use prost::Message;
use rcgen::date_time_ymd;
use stereo_proto::v1;
use stereo_tests::process::{Stereod, run};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use crate::conversation::message;
use crate::doors::{ConfigFile, GUARDED, Logging, token};
use crate::tls::{Authority, Files, Identity, TlsClient};

/// Long enough for anything that is going to happen.
const NEVER: Duration = Duration::from_secs(60);

fn start(flags: &[String], more: &[&str]) -> Stereod {
    let flags = flags.iter().map(String::as_str);
    let own = ["--workers", "1", "--no-zenoh"];
    let args = Vec::from_iter(own.into_iter().chain(flags).chain(more.iter().copied()));
    Stereod::start(&args).expect("a server that starts")
}

fn address(server: &Stereod) -> &str {
    server.url().trim_start_matches("https://")
}

/// How many connections have ended so, by the metrics at the second address.
async fn ended(server: &Stereod, why: &str) -> f64 {
    let admin = server
        .admin_url()
        .expect("it has one")
        .trim_start_matches("http://");
    let mut stream = TcpStream::connect(admin).await.expect("a listening server");
    let request = b"GET /metrics HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n";
    stream.write_all(request).await.expect("room");
    let mut text = String::new();
    stream.read_to_string(&mut text).await.expect("an answer");
    let series = format!("stereod_connections_ended_total{{why=\"{why}\"}} ");
    let value = text.lines().find_map(|line| line.strip_prefix(&series));
    value.expect("a series").parse().expect("a number")
}

/// Waits until so many connections have ended in any of these ways.
async fn until_ended(server: &Stereod, ways: &[&str], count: f64) {
    let reached = async {
        loop {
            let mut sum = 0.0;
            for why in ways {
                sum += ended(server, why).await;
            }
            if sum >= count {
                return;
            }
        }
    };
    let reached = tokio::time::timeout(NEVER, reached).await;
    assert!(reached.is_ok(), "not {count} connections have ended as {ways:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pairs_are_matched_over_tls_by_http_1_and_http_2() {
    let (authority, files) = (Authority::new(), Files::new("pairs"));
    let server = start(&files.flags(&authority.of_server()), &["--admin", "127.0.0.1:0"]);
    let client = TlsClient::new(server.url(), &authority, None);
    let mut disparities = Vec::new();
    for protocol in ["http/1.1", "h2"] {
        let request = client.request("POST", "/v1/stereo", None, message().encode_to_vec());
        let answer = client.send(protocol, request).await.expect("an answer");
        assert_eq!(answer.status, 200, "{protocol}");
        let result = v1::StereoResult::decode(answer.body).expect("a result");
        disparities.push(result.disparity.expect("asked for"));
        let chosen = client.connect(protocol).await.expect("a connection");
        assert_eq!(chosen.get_ref().1.alpn_protocol(), Some(protocol.as_bytes()));
    }
    assert!(disparities[0] == disparities[1]);
    let stranger = TlsClient::new(server.url(), &Authority::new(), None);
    assert!(
        stranger.get("/livez", None).await.is_err(),
        "the server's certificate is another authority's"
    );
    until_ended(&server, &["handshake"], 1.0).await;
    assert!(server.stop().expect("a signal").success());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_is_known_by_a_certificate_of_the_authority_and_by_nothing_else() {
    let (authority, clients, files) = (Authority::new(), Authority::new(), Files::new("mutual"));
    let (lab, section) = token("lab");
    let config = ConfigFile::new(
        "mutual",
        &format!("{section}[clients.robot-1]\ncameras = [\"front\"]\n"),
    );
    let mut flags = files.flags(&authority.of_server());
    flags.extend([
        "--tls-client-ca".to_owned(),
        files.write("clients.pem", &clients.pem()),
    ]);
    let server = start(&flags, &["--config", config.path()]);
    let as_client = |identity: Option<&Identity>| TlsClient::new(server.url(), &authority, identity);

    let robot = clients.of_client("robot-1");
    let by_dns_name = clients.sign(&["robot-1"], |_| {});
    for identity in [&robot, &by_dns_name] {
        for (camera, status) in [("front", 200), ("back", 403), ("", 200)] {
            let client = as_client(Some(identity));
            let of_camera = v1::StereoRequest {
                camera_id: camera.to_owned(),
                ..message()
            };
            for protocol in ["http/1.1", "h2"] {
                let request = client.request("POST", "/v1/stereo", None, of_camera.encode_to_vec());
                let answer = client.send(protocol, request).await.expect("an answer");
                assert_eq!(answer.status, status, "{camera:?} by {protocol}");
            }
        }
    }

    // Without a certificate there are tokens, and what is for everybody.
    let nobody = as_client(None);
    for (method, path) in GUARDED {
        let request = nobody.request(method, path, None, Vec::new());
        let answer = nobody.send("http/1.1", request).await.expect("an answer");
        assert_eq!(answer.status, 401, "{method} {path}");
    }
    assert_eq!(nobody.get("/livez", None).await.expect("an answer"), 200);
    assert_eq!(nobody.get("/v1/info", Some(&lab)).await.expect("an answer"), 200);
    // Of two names the token's counts: lab may look at any camera, robot-1 at its own alone.
    let both = as_client(Some(&robot));
    assert_eq!(
        both.get("/v1/streams/back", Some(&lab)).await.expect("an answer"),
        404
    );
    assert_eq!(both.get("/v1/streams/back", None).await.expect("an answer"), 403);
    assert_eq!(
        both.get("/v1/info", Some("stereod_wrong"))
            .await
            .expect("an answer"),
        401
    );

    // A name that is no client's, and certificates that are not to be trusted.
    let unknown = as_client(Some(&clients.of_client("robot-2")));
    assert_eq!(unknown.get("/v1/info", None).await.expect("an answer"), 401);
    let forged = Authority::new().of_client("robot-1");
    let expired = clients.sign(&["robot-1"], |params| {
        params.not_before = date_time_ymd(2001, 1, 1);
        params.not_after = date_time_ymd(2002, 1, 1);
    });
    let of_the_servers_authority = authority.of_client("robot-1");
    for identity in [&forged, &expired, &of_the_servers_authority] {
        let refused = as_client(Some(identity)).get("/livez", None).await;
        assert!(refused.is_err(), "{refused:?}");
    }
    assert_eq!(
        as_client(Some(&robot))
            .get("/v1/info", None)
            .await
            .expect("an answer"),
        200
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn handshakes_that_are_never_finished_keep_nobody_out_and_end() {
    let (authority, files) = (Authority::new(), Files::new("handshakes"));
    let server = start(
        &files.flags(&authority.of_server()),
        &[
            "--admin",
            "127.0.0.1:0",
            "--max-connections",
            "20",
            "--header-timeout-ms",
            "2000",
        ],
    );
    // A record of a handshake that says it has 512 bytes, and doesn't.
    let beginning: &[u8] = &[22, 3, 1, 2, 0, 1];
    let client = TlsClient::new(server.url(), &authority, None);
    let mut crowd = Vec::new();
    for count in 0..100 {
        let mut stream = TcpStream::connect(address(&server))
            .await
            .expect("a listening server");
        if count % 2 == 0 {
            // It may have been evicted already.
            drop(stream.write_all(beginning).await);
        }
        crowd.push(stream);
        if count % 20 == 19 {
            assert_eq!(client.get("/livez", None).await.expect("an answer"), 200);
        }
    }
    until_ended(&server, &["evicted"], 1.0).await;
    until_ended(&server, &["evicted", "silent"], 100.0).await;
    drop(crowd);
}

#[tokio::test]
async fn whoever_comes_without_tls_is_told_so() {
    let (authority, files) = (Authority::new(), Files::new("plain"));
    let server = start(&files.flags(&authority.of_server()), &[]);
    for request in [
        "GET /livez HTTP/1.1\r\nHost: x\r\n\r\n",
        "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    ] {
        let mut stream = TcpStream::connect(address(&server))
            .await
            .expect("a listening server");
        stream.write_all(request.as_bytes()).await.expect("room");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).await.expect("an answer");
        assert!(
            answer.starts_with("HTTP/1.1 400 ") && answer.contains("https://"),
            "{answer}"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn certificates_are_read_again_when_they_change_and_on_sighup() {
    let (old, new, files) = (Authority::new(), Authority::new(), Files::new("renewal"));
    let mut server = start(&files.flags(&old.of_server()), &[]);
    let (of_old, of_new) = (
        TlsClient::new(server.url(), &old, None),
        TlsClient::new(server.url(), &new, None),
    );
    assert_eq!(of_old.get("/livez", None).await.expect("an answer"), 200);
    let mut kept = of_old.connect("http/1.1").await.expect("a connection");

    // What can't be used changes nothing: a certificate without its key, for a moment or for ever.
    let renewed = new.of_server();
    files.write("server.pem", &renewed.certificate);
    server.signal("HUP").expect("it runs");
    assert_eq!(of_old.get("/livez", None).await.expect("an answer"), 200);
    files.write("server-key.pem", &renewed.key);
    let changed = async {
        while of_new.get("/livez", None).await.is_err() {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(NEVER, changed)
        .await
        .expect("it is read again by itself");
    assert!(of_old.get("/livez", None).await.is_err());

    // Connections that are open go on.
    kept.write_all(b"GET /livez HTTP/1.1\r\nHost: x\r\n\r\n")
        .await
        .expect("room");
    let mut start = [0; 12];
    kept.read_exact(&mut start).await.expect("an answer");
    assert_eq!(&start, b"HTTP/1.1 200");

    // Back again, at once.
    files.flags(&old.of_server());
    server.signal("HUP").expect("it runs");
    let changed = async {
        while of_old.get("/livez", None).await.is_err() {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(NEVER, changed)
        .await
        .expect("it is read again when asked");
}

#[test]
fn a_server_whose_certificate_is_no_good_does_not_start_and_says_which_file() {
    let (authority, files) = (Authority::new(), Files::new("bad"));
    let (one, other) = (authority.of_server(), authority.of_server());
    let cert = files.write("cert.pem", &one.certificate);
    let key = files.write("key.pem", &one.key);
    let other_key = files.write("other-key.pem", &other.key);
    let empty = files.write("empty.pem", "nothing\n");
    for (args, words) in [
        (vec!["--tls-cert", &cert], "tls-key"),
        (vec!["--tls-key", &key], "tls-cert"),
        (vec!["--tls-client-ca", &cert], "tls-cert"),
        (
            vec!["--tls-cert", "no/such.pem", "--tls-key", &key],
            "no/such.pem",
        ),
        (vec!["--tls-cert", &empty, "--tls-key", &key], "empty.pem"),
        (vec!["--tls-cert", &cert, "--tls-key", &empty], "empty.pem"),
        (vec!["--tls-cert", &cert, "--tls-key", &cert], "cert.pem"),
        (
            vec!["--tls-cert", &cert, "--tls-key", &other_key],
            "other-key.pem",
        ),
        (
            vec!["--tls-cert", &cert, "--tls-key", &key, "--tls-client-ca", &empty],
            "empty.pem",
        ),
    ] {
        let serve = ["serve", "--http", "127.0.0.1:0", "--no-zenoh", "--log", "error"];
        let ended = run(&[&serve, args.as_slice()].concat()).expect("the binary");
        let said = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert_eq!(ended.status.code(), Some(64), "{args:?}: {said}");
        assert!(said.contains(words), "{args:?}: {said}");
        assert!(ended.stdout.is_empty(), "it listened");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn keys_and_tokens_are_in_no_log_of_a_server_with_tls() {
    let (authority, clients, files) = (Authority::new(), Authority::new(), Files::new("log"));
    let (lab, section) = token("lab");
    let config = ConfigFile::new("tls-log", &section);
    let (identity, own) = (authority.of_server(), clients.of_client("lab"));
    let mut flags = files.flags(&identity);
    flags.extend([
        "--tls-client-ca".to_owned(),
        files.write("clients.pem", &clients.pem()),
    ]);
    let more = [
        "--http",
        "127.0.0.1:0",
        "--log",
        "trace",
        "--config",
        config.path(),
    ];
    let args = Vec::from_iter(flags.iter().map(String::as_str).chain(more));
    let mut server = Logging::start("tls-log", &args);
    for identity in [None, Some(&own)] {
        let client = TlsClient::new(&server.url, &authority, identity);
        for protocol in ["http/1.1", "h2"] {
            for (token, is_known) in [
                (Some(lab.as_str()), true),
                (None, identity.is_some()),
                (Some("stereod_0123456789abcdef"), false),
            ] {
                let request = client.request("GET", "/v1/info", token, Vec::new());
                let answer = client.send(protocol, request).await.expect("an answer");
                assert_eq!(answer.status, if is_known { 200 } else { 401 });
            }
        }
    }
    let log = server.log();
    assert!(
        log.contains("rustls") && log.contains("client=\"lab\""),
        "that was not all of the log"
    );
    let pem = |text: &str| {
        Vec::from_iter(
            text.lines()
                .filter(|line| !line.starts_with("--"))
                .map(str::to_owned),
        )
    };
    let key_lines = [pem(&identity.key), pem(&own.key)].concat();
    let secrets = key_lines.iter().map(String::as_str);
    for secret in secrets.chain([lab.trim_start_matches("stereod_"), "0123456789abcdef"]) {
        assert!(!log.contains(secret), "a secret is in the log");
    }
}
