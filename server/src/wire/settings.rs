//! Settings of a camera: checked when they are set, so that no frame has to fail because of them later.

use std::time::Duration;

use bytes::Bytes;
use prost::Message;
use serde_json::Value;
use stereo::Shape;
use stereo_proto::v1;

use super::{form, options};
use crate::job::{CameraSettings, PairingKey, PairingRules, PriorityClass, ReplyFormat};
use crate::status::ServiceError;

const LARGEST_TOLERANCE: Duration = Duration::from_secs(1);
const LARGEST_PATIENCE: Duration = Duration::from_secs(10);

/// The message of a payload.
///
/// # Errors
/// [`ServiceError::Invalid`] if it is no `stereo.v1.CameraSettings`.
pub fn decode_camera_settings(payload: Bytes) -> Result<v1::CameraSettings, ServiceError> {
    v1::CameraSettings::decode(payload).map_err(|why| {
        invalid(format!(
            "the payload is not a whole stereo.v1.CameraSettings message ({why}): its schema is at GET /v1/schema.binpb"
        ))
    })
}

/// `wire` as settings that can be put to work.
///
/// # Errors
/// [`ServiceError::Invalid`] or [`ServiceError::Unmatchable`] naming what is out of range, contradictory or not built yet.
pub fn camera_settings(wire: v1::CameraSettings) -> Result<CameraSettings, ServiceError> {
    if let Some(calibration) = wire.calibration {
        options::calibration(calibration)?;
    }
    let latency_budget = match &wire.options {
        None => None,
        Some(given) => check_options(given, wire.calibration.is_some())?,
    };
    Ok(CameraSettings {
        options: wire.options,
        latency_budget,
        calibration: wire.calibration,
        pairing: pairing(wire.pairing.unwrap_or_default())?,
    })
}

/// The same from a JSON object: the options and the calibration of a form, and `pairing` with `key` (`sequence` or `time`),
/// `tolerance_ms` and `patience_ms`.
///
/// # Errors
/// As [`camera_settings`].
pub fn camera_settings_from_json(json: &Value) -> Result<CameraSettings, ServiceError> {
    let mut json = json.clone();
    let pairing = json.as_object_mut().and_then(|object| object.remove("pairing"));
    let request = form::options_from_value(&json)?;
    if request
        != (v1::StereoRequest {
            options: request.options.clone(),
            calibration: request.calibration,
            ..v1::StereoRequest::default()
        })
    {
        return Err(invalid(
            "settings of a camera hold no request_id, camera_id, sequence or capture_time: leave them out"
                .to_owned(),
        ));
    }
    camera_settings(v1::CameraSettings {
        options: request.options,
        calibration: request.calibration,
        pairing: pairing.map(|pairing| pairing_from_json(&pairing)).transpose()?,
        revision: 0,
    })
}

/// The settings in force, as the wire has them.
#[must_use]
pub fn camera_settings_to_proto(settings: &CameraSettings, revision: u64) -> v1::CameraSettings {
    let PairingRules {
        key,
        tolerance,
        patience,
    } = settings.pairing;
    v1::CameraSettings {
        options: settings.options.clone(),
        calibration: settings.calibration,
        pairing: Some(v1::Pairing {
            key: match key {
                PairingKey::Either => v1::PairingKey::Unspecified,
                PairingKey::Sequence => v1::PairingKey::Sequence,
                PairingKey::Time => v1::PairingKey::Time,
            }
            .into(),
            tolerance: tolerance.try_into().ok(),
            patience: patience.try_into().ok(),
        }),
        revision,
    }
}

/// The latency budget, if one was given.
fn check_options(given: &v1::Options, is_calibrated: bool) -> Result<Option<Duration>, ServiceError> {
    // Frames of any size are possible: what depends on it is checked with the frame.
    let shape = Shape::new(Shape::MAX_SIDE_PX, Shape::MAX_SIDE_PX)
        .map_err(|why| ServiceError::Internal(why.to_string()))?;
    let checked = options::validate(
        given,
        &options::Circumstances {
            shape,
            is_calibrated,
            formats: &[ReplyFormat::Protobuf],
            latency_budget: None,
            priority: PriorityClass::default(),
        },
    )?;
    if checked.priority == PriorityClass::Background {
        return Err(invalid(
            "priority_class background can't be had for a stream, whose frames are of no use later: use deadline or \
             best_effort"
                .to_owned(),
        ));
    }
    Ok(given.latency_budget.map(|_| checked.latency_budget))
}

fn pairing(wire: v1::Pairing) -> Result<PairingRules, ServiceError> {
    let defaults = PairingRules::default();
    let key = match v1::PairingKey::try_from(wire.key) {
        Ok(v1::PairingKey::Unspecified) => PairingKey::Either,
        Ok(v1::PairingKey::Sequence) => PairingKey::Sequence,
        Ok(v1::PairingKey::Time) => PairingKey::Time,
        Err(_) => {
            return Err(invalid(format!(
                "pairing.key has the unknown value {}: use sequence or time",
                wire.key
            )));
        }
    };
    let duration = |name: &str, given: Option<prost_types::Duration>, most: Duration, default: Duration| {
        let Some(given) = given else { return Ok(default) };
        let duration = Duration::try_from(given).ok();
        duration
            .filter(|&duration| duration > Duration::ZERO && duration <= most)
            .ok_or_else(|| {
                invalid(format!(
                    "pairing.{name} must be above 0 and up to {} ms, got {} s and {} ns",
                    most.as_millis(),
                    given.seconds,
                    given.nanos
                ))
            })
    };
    Ok(PairingRules {
        key,
        tolerance: duration("tolerance", wire.tolerance, LARGEST_TOLERANCE, defaults.tolerance)?,
        patience: duration("patience", wire.patience, LARGEST_PATIENCE, defaults.patience)?,
    })
}

fn pairing_from_json(json: &Value) -> Result<v1::Pairing, ServiceError> {
    let refuse = |what: &str| {
        invalid(format!(
            "pairing {what}: give an object with key (\"sequence\" or \"time\"), tolerance_ms and patience_ms, each of which \
             may be left out"
        ))
    };
    let object = json.as_object().ok_or_else(|| refuse("is no object"))?;
    let mut pairing = v1::Pairing::default();
    for (name, value) in object {
        let duration = || {
            let ms = value
                .as_f64()
                .ok_or_else(|| refuse("has a time that is no number"))?;
            let duration = Duration::try_from_secs_f64(ms / 1e3).ok();
            let wire = duration.and_then(|duration| duration.try_into().ok());
            wire.ok_or_else(|| refuse("has a time that is out of range"))
        };
        match (name.as_str(), value.as_str()) {
            ("key", Some("sequence")) => pairing.set_key(v1::PairingKey::Sequence),
            ("key", Some("time")) => pairing.set_key(v1::PairingKey::Time),
            ("tolerance_ms", _) => pairing.tolerance = Some(duration()?),
            ("patience_ms", _) => pairing.patience = Some(duration()?),
            (other, _) => return Err(refuse(&format!("has no meaning for {other:?} = {value}"))),
        }
    }
    Ok(pairing)
}

fn invalid(message: String) -> ServiceError {
    ServiceError::Invalid(message)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn settings_come_back_as_they_were_given() {
        let settings = camera_settings_from_json(&json!({
            "latency_budget_ms": 50, "preset": "fast", "calibration":
            {"focal_px": 500, "cx_px": 320, "cy_px": 240, "baseline_m": 0.1},
            "pairing": {"key": "time", "tolerance_ms": 5, "patience_ms": 100},
        }))
        .unwrap();
        assert_eq!(settings.latency_budget, Some(Duration::from_millis(50)));
        assert_eq!(settings.pairing.key, PairingKey::Time);
        assert_eq!(settings.pairing.tolerance, Duration::from_millis(5));
        let wire = camera_settings_to_proto(&settings, 3);
        assert_eq!(wire.revision, 3);
        assert_eq!(camera_settings(wire).unwrap(), settings);
        assert_eq!(
            camera_settings(v1::CameraSettings::default()).unwrap(),
            CameraSettings::default()
        );
    }

    #[test]
    fn settings_that_no_frame_could_keep_are_refused_by_name() {
        for (json, word) in [
            (json!({"latency_budget_ms": 0}), "latency_budget_ms"),
            (json!({"preset": "slow"}), "preset"),
            (json!({"priority_class": "background"}), "background"),
            (json!({"outputs": ["depth"]}), "calibration"),
            (json!({"sequence": 1}), "sequence"),
            (json!({"camera_id": "x"}), "camera_id"),
            (json!({"pairing": 1}), "pairing"),
            (json!({"pairing": {"key": "colour"}}), "colour"),
            (json!({"pairing": {"tolerance_ms": 1001}}), "tolerance"),
            (json!({"pairing": {"tolerance_ms": 0}}), "tolerance"),
            (json!({"pairing": {"patience_ms": -1}}), "out of range"),
            (
                json!({"calibration": {"focal_px": 0, "cx_px": 1, "cy_px": 1, "baseline_m": 1}}),
                "focal_px",
            ),
            (json!([]), "object"),
        ] {
            let error = camera_settings_from_json(&json).unwrap_err();
            assert!((400..=422).contains(&error.http_code()), "{error}");
            assert!(error.to_string().contains(word), "{json}: {error}");
        }
    }
}
