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

#[test]
fn clients_have_the_weights_of_the_file() {
    let text = "[weights.cameras]\nfront = 4\n[weights.addresses]\n\"::ffff:192.0.2.7\" = 2\n";
    let config = Config::from_toml(text, "x").unwrap();
    config.validate().unwrap();
    let weights = config.weights.by_client();
    assert_eq!(weights.get("camera front"), Some(&4));
    assert_eq!(weights.get("192.0.2.7"), Some(&2));
    let json = serde_json::to_string(&config).unwrap();
    assert_eq!(serde_json::from_str::<Config>(&json).unwrap(), config);
}

#[test]
fn weights_that_make_no_sense_are_refused_by_name() {
    for (text, word) in [
        ("[weights.cameras]\nfront = 0\n", "weights.cameras.front"),
        ("[weights.addresses]\n\"192.0.2.7\" = 1001\n", "192.0.2.7"),
        ("[weights.cameras]\n\"two words\" = 2\n", "two words"),
    ] {
        let error = Config::from_toml(text, "x").unwrap().validate().unwrap_err();
        assert!(error.to_string().contains(word), "{error}");
    }
    assert!(Config::from_toml("[weights.addresses]\nnowhere = 2\n", "x").is_err());
}
