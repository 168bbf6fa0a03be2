use super::*;

fn clients(text: &str) -> Clients {
    let config = Config::from_toml(text, "test").unwrap();
    config.validate().unwrap();
    Clients::new(&config)
}

/// A client whose token is `abc`.
const LAB: &str =
    "[clients.lab]\ntoken_sha256 = \"ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad\"\n";

#[test]
fn a_client_is_known_by_its_token_and_nobody_by_another() {
    let clients = clients(&format!("{LAB}[clients.other]\nweight = 2\n"));
    assert!(clients.has_doors());
    assert_eq!(clients.by_token(b"abc").unwrap().name(), "lab");
    for wrong in [b"abd".as_slice(), b"", b"ab", &[0; 100]] {
        assert!(clients.by_token(wrong).is_none());
    }
    assert!(!Clients::default().has_doors());
}

#[test]
fn shares_have_the_weights_of_the_clients_that_they_are_of() {
    let clients = clients(
        "[clients.desk]\nweight = 2\naddresses = [\"::ffff:192.0.2.7\"]\n[clients.robot]\nweight = 4\ncameras = [\"front\", \"arm-*\"]\n",
    );
    let desk = clients.by_address("192.0.2.7".parse().unwrap());
    assert_eq!(desk.share("front"), "client desk");
    let stranger = clients.by_address("192.0.2.8".parse().unwrap());
    assert_eq!(stranger.share(""), "192.0.2.8");
    assert_eq!(stranger.share("front"), "camera front");
    for (share, weight) in [
        ("client desk", 2),
        ("client robot", 4),
        ("camera front", 4),
        ("camera arm-left", 4),
        // The desk may use all cameras, but that makes none its own.
        ("camera back", 1),
        ("192.0.2.8", 1),
        ("", 1),
    ] {
        assert_eq!(clients.weight(share), weight, "{share}");
    }
}

#[test]
fn a_client_may_use_the_cameras_it_is_allowed_and_send_pairs_of_none() {
    let clients = clients("[clients.robot]\ncameras = [\"front\"]\n[clients.lab]\n");
    let caller = |name| Caller::Client(Arc::clone(clients.by_name(name).unwrap()));
    assert_eq!(caller("robot").check_camera("front"), Ok(()));
    assert_eq!(caller("robot").check_camera(""), Ok(()));
    assert_eq!(caller("robot").check_camera("back").unwrap_err().http_code(), 403);
    assert_eq!(caller("lab").check_camera("back"), Ok(()));
    assert_eq!(Caller::Stranger(String::new()).check_camera("back"), Ok(()));
}

#[tokio::test]
async fn a_client_over_its_bytes_is_refused_and_a_batch_waits() {
    let clients = clients("[clients.lab]\nbytes_in_flight = 4096\n");
    let lab = clients.by_name("lab").unwrap();
    let held = lab.reserve(4000).unwrap();
    let error = lab.reserve(97).unwrap_err();
    assert_eq!((error.http_code(), error.retry_after_s()), (429, Some(1)));
    assert!(lab.reserve(96).is_ok());
    drop(held);
    // More than there is at all: everything.
    assert_eq!(lab.reserve_when_free(1 << 20).await.unwrap().num_permits(), 4096);
}

#[test]
fn a_client_over_its_rate_is_told_when_to_come_back() {
    let clients = clients("[clients.lab]\nrequests_per_second = 1\n[clients.free]\n");
    let lab = clients.by_name("lab").unwrap();
    assert_eq!(lab.count_request(), Ok(()));
    let error = lab.count_request().unwrap_err();
    assert_eq!((error.http_code(), error.retry_after_s()), (429, Some(1)));
    let free = clients.by_name("free").unwrap();
    assert!((0..1000).all(|_| free.count_request().is_ok()));
}
