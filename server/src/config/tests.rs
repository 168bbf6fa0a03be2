use super::*;

fn refused(change: impl FnOnce(&mut Config)) -> String {
    let mut config = Config::default();
    change(&mut config);
    config.validate().unwrap_err().to_string()
}

#[test]
fn the_defaults_are_valid_and_leave_a_core_to_the_transport() {
    let config = Config::default();
    config.validate().unwrap();
    assert_eq!(config.http.listen.to_string(), "127.0.0.1:8080");
    assert!(config.workers.count >= 1);
}

#[test]
fn an_unknown_key_is_refused_naming_those_that_exist() {
    let error = Config::from_toml("[workers]\ncuont = 3\n", "stereod.toml")
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("stereod.toml") && error.contains("cuont") && error.contains("`count`"),
        "{error}"
    );
}

#[test]
fn the_file_sets_what_it_names_and_leaves_the_rest() {
    let config = Config::from_toml("[http]\nheader_timeout_ms = 1500\n", "x").unwrap();
    assert_eq!(config.http.header_timeout, Duration::from_millis(1500));
    assert_eq!(config.http.body_timeout, HttpConfig::default().body_timeout);
    assert_eq!(config.limits, LimitsConfig::default());
}

#[test]
fn the_effective_configuration_reads_back_as_itself() {
    let config = Config::default();
    let json = serde_json::to_string(&config).unwrap();
    assert_eq!(serde_json::from_str::<Config>(&json).unwrap(), config);
}

#[test]
fn values_out_of_range_are_refused_with_the_range() {
    assert_eq!(
        refused(|c| c.workers.count = 0),
        "workers.count must be 1 to 256, got 0"
    );
    assert!(refused(|c| c.limits.image_pixels = 1 << 40).contains("16777216"));
    assert!(refused(|c| c.instance = "a b".into()).contains("`a b`"));
    assert!(refused(|c| c.limits.bytes_in_flight = 1 << 20).contains("limits.body_bytes"));
}

#[test]
fn a_simd_level_that_does_not_exist_is_refused_naming_what_does() {
    let message = refused(|c| c.workers.simd = "avx99".into());
    assert!(
        message.contains("`avx99`") && message.contains("auto") && message.contains("scalar"),
        "{message}"
    );
    let lowered = WorkersConfig {
        simd: "scalar".into(),
        ..WorkersConfig::default()
    };
    assert_eq!(lowered.level(), Ok(Level::SCALAR));
}

/// The hash of `abc`.
const HASH: &str = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";

#[test]
fn clients_stand_in_the_file_and_their_hashes_nowhere_else() {
    let text = format!(
        "[clients.lab]\ntoken_sha256 = \"{HASH}\"\nweight = 4\nrequests_per_second = 60\ncameras = [\"front\", \"arm-*\"]\n"
    );
    let config = Config::from_toml(&text, "x").unwrap();
    config.validate().unwrap();
    assert!(config.has_doors() && !Config::default().has_doors());
    let lab = &config.clients["lab"];
    assert_eq!((lab.weight, lab.requests_per_second), (4, Some(60)));
    let shown = format!("{config:?} {}", serde_json::to_string(&config).unwrap());
    assert!(shown.contains("arm-*") && !shown.contains(&HASH[..8]), "{shown}");
}

#[test]
fn clients_that_make_no_sense_are_refused_by_name() {
    let twice = format!("[clients.a]\ntoken_sha256 = \"{HASH}\"\n[clients.b]\ntoken_sha256 = \"{HASH}\"\n");
    let both = format!("[clients.a]\ntoken_sha256 = \"{HASH}\"\naddresses = [\"192.0.2.7\"]\n");
    for (text, words) in [
        ("[clients.front]\nweight = 0\n", ["clients.front", "1 to 1000"]),
        (
            "[clients.front]\nrequests_per_second = 0\n",
            ["clients.front", "requests_per_second"],
        ),
        (
            "[clients.front]\nbytes_in_flight = 1\n",
            ["clients.front", "bytes_in_flight"],
        ),
        ("[clients.front]\ncameras = [\"a/b\"]\n", ["clients.front", "a/b"]),
        ("[clients.\"two words\"]\n", ["two words", "characters"]),
        (&twice, ["clients.b", "same token"]),
        (&both, ["clients.a", "addresses"]),
    ] {
        let error = Config::from_toml(text, "x").unwrap().validate().unwrap_err();
        let error = error.to_string();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    }
    assert!(Config::from_toml("[clients.a]\naddresses = [\"nowhere\"]\n", "x").is_err());
    let many = BTreeMap::from_iter((0..1025).map(|n| (format!("c{n}"), ClientConfig::default())));
    assert!(refused(|c| c.clients = many).contains("1024"));
    let cameras = vec!["x".to_owned(); 257];
    let client = ClientConfig {
        cameras,
        ..ClientConfig::default()
    };
    assert!(refused(|c| c.clients = BTreeMap::from([("a".to_owned(), client)])).contains("256"));
}

#[test]
fn a_token_in_the_wrong_place_is_not_shown() {
    for text in [
        "[clients.lab]\ntoken = \"stereod_s3cret\"\n",
        "[clients.lab]\ntoken_sha256 = \"stereod_s3cret\"\n",
        "[clients.lab]\ntoken_sha256 = \"stereod_s3cret\n",
    ] {
        let config = Config::from_toml(text, "x");
        let error = config
            .and_then(|config| config.validate())
            .unwrap_err()
            .to_string();
        assert!(
            !error.contains("s3cret") && error.contains("clients.lab") | error.contains("line 2"),
            "{error}"
        );
    }
}

#[test]
fn tls_needs_a_certificate_and_its_key() {
    let with = |text: &str| Config::from_toml(text, "x").unwrap();
    for (text, missing) in [
        ("http.tls.cert = \"a.pem\"", "http.tls.key"),
        ("http.tls.key = \"a.pem\"", "http.tls.cert"),
        ("http.tls.client_ca = \"a.pem\"", "http.tls.cert"),
    ] {
        let error = with(text).validate().unwrap_err();
        assert!(matches!(error, ConfigError::Tls { .. }), "{text}");
        assert!(error.to_string().contains(missing), "{text}: {error}");
    }
    let whole = with("http.tls = { cert = \"a.pem\", key = \"b.pem\" }");
    assert_eq!(whole.validate(), Ok(()));
    assert!(
        !whole.has_doors(),
        "a certificate of the server's own says nothing about clients"
    );
}

#[test]
fn authorities_of_clients_make_doors() {
    let text = "http.tls = { cert = \"a.pem\", key = \"b.pem\", client_ca = \"c.pem\" }\n[clients.lab]\n";
    assert!(Config::from_toml(text, "x").unwrap().has_doors());
    let known_by_address = format!("{text}addresses = [\"192.0.2.7\"]\n");
    let error = Config::from_toml(&known_by_address, "x").unwrap().validate();
    assert!(error.is_err_and(|error| error.to_string().contains("certificate")));
}
