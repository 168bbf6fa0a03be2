//! What the server is told about Zenoh.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::ConfigError;
use crate::job::CameraSettings;
use crate::wire::camera_settings_from_json;

/// The Zenoh transport. Everything that Zenoh itself knows (TLS, passwords, access control, limits) stands in its own file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ZenohConfig {
    /// Whether there is a Zenoh session at all.
    pub enabled: bool,
    /// Zenoh's own configuration, JSON5; what it says wins over the defaults here, and the keys below win over it.
    pub file: Option<PathBuf>,
    /// Routers or peers to connect to, such as `tcp/router:7447`; empty = what the file says.
    pub connect: Vec<String>,
    /// Where to listen, such as `tcp/0.0.0.0:7447`; empty = what the file says, or `tcp/127.0.0.1:0`.
    pub listen: Vec<String>,
    /// Whether the server isn't ready while the session isn't open or connected to nobody it was told to connect to.
    pub required: bool,
    /// Settings of cameras, by name: the options of a form, `calibration` and `pairing`. These cameras are served even if they don't
    /// announce themselves.
    pub cameras: BTreeMap<String, Value>,
}

impl Default for ZenohConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            file: None,
            connect: Vec::new(),
            listen: Vec::new(),
            required: false,
            cameras: BTreeMap::new(),
        }
    }
}

impl ZenohConfig {
    /// The settings of the cameras that have some.
    ///
    /// # Errors
    /// [`ConfigError::Camera`] naming the first camera whose name or settings are not acceptable.
    pub fn camera_settings(&self) -> Result<BTreeMap<String, CameraSettings>, ConfigError> {
        let checked = self.cameras.iter().map(|(camera, json)| {
            let refuse = |reason: String| ConfigError::Camera {
                camera: camera.clone(),
                reason,
            };
            if !super::is_name(camera) {
                return Err(refuse(
                    "its name must be 1 to 64 of the characters A-Z a-z 0-9 _ . -".to_owned(),
                ));
            }
            let settings = camera_settings_from_json(json).map_err(|why| refuse(why.to_string()))?;
            Ok((camera.clone(), settings))
        });
        checked.collect()
    }
}

/// What Zenoh's own file says, which is written in JSON5.
///
/// # Errors
/// [`ConfigError::Zenoh`] naming `path` and the place.
pub fn zenoh_file(text: &str, path: &str) -> Result<Value, ConfigError> {
    json5::from_str(text).map_err(|why| ConfigError::Zenoh {
        reason: format!("{path}: {why}"),
    })
}

#[cfg(test)]
mod tests {
    use crate::config::Config;

    #[test]
    fn cameras_have_their_settings_in_the_file() {
        let text = "[zenoh.cameras.front]\nlatency_budget_ms = 40\npreset = \"fast\"\npairing = { tolerance_ms = 4 }\n";
        let config = Config::from_toml(text, "test").unwrap();
        config.validate().unwrap();
        let settings = config.zenoh.camera_settings().unwrap();
        assert_eq!(settings["front"].pairing.tolerance.as_millis(), 4);
        for (bad, word) in [
            ("[zenoh.cameras.front]\npreset = \"slow\"\n", "preset"),
            ("[zenoh.cameras.\"a b\"]\n", "name"),
        ] {
            let error = Config::from_toml(bad, "test")
                .unwrap()
                .validate()
                .unwrap_err()
                .to_string();
            assert!(error.contains(word), "{error}");
        }
    }
}
