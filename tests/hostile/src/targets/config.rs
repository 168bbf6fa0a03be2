//! The configuration files: the server's TOML and Zenoh's JSON5.

use stereod::config::{Config, zenoh_file};

pub(crate) fn config(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else {
        return false;
    };
    let own = Config::from_toml(text, "stereod.toml").and_then(|config| config.validate().map(|()| config));
    if let Ok(config) = &own {
        // The effective configuration is logged so.
        let logged = serde_json::to_value(config).unwrap_or_default();
        let read: Result<Config, _> = serde_json::from_value(logged);
        assert_eq!(
            read.as_ref().ok(),
            Some(config),
            "a configuration is logged as another"
        );
    }
    let zenoh = zenoh_file(text, "zenoh.json5");
    own.is_ok() || zenoh.is_ok()
}
