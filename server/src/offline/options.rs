//! The flags as the JSON options that the HTTP form would have.

use bytes::Bytes;
use serde::{Deserialize, Serialize};

use super::{OfflineError, read};
use crate::args::MatchArgs;

/// The options that have a flag.
#[derive(Serialize)]
struct Options<'a> {
    latency_budget_ms: f64,
    preset: Option<&'a str>,
    num_disparities: Option<u32>,
    min_disparity: Option<i32>,
    density: Option<&'a str>,
    max_iterations: Option<u32>,
    min_confidence: Option<f64>,
    mesh: Mesh,
    calibration: Option<CalibrationFile>,
}

/// The mesh's options that have a flag.
#[derive(Serialize)]
struct Mesh {
    tolerance_px: Option<f64>,
    max_triangles: Option<u32>,
}

/// A calibration as files write it; data sets' descriptions say `cx` and `cy`, and much else that is not ours.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct CalibrationFile {
    focal_px: f64,
    #[serde(alias = "cx")]
    cx_px: f64,
    #[serde(alias = "cy")]
    cy_px: f64,
    baseline_m: f64,
    #[serde(default)]
    doffs_px: f64,
}

/// The options part of the form.
pub(super) fn json(args: &MatchArgs) -> Result<Bytes, OfflineError> {
    let options = Options {
        latency_budget_ms: args.latency_budget_ms,
        preset: args.preset.as_deref(),
        num_disparities: args.num_disparities,
        min_disparity: args.min_disparity,
        density: args.density.as_deref(),
        max_iterations: args.max_iterations,
        min_confidence: args.min_confidence,
        mesh: Mesh {
            tolerance_px: args.mesh_tolerance,
            max_triangles: args.max_triangles,
        },
        calibration: calibration(args)?,
    };
    // Strings and numbers always serialise; should they not, the form's reader says what is wrong with an empty part.
    Ok(serde_json::to_vec(&options).unwrap_or_default().into())
}

fn calibration(args: &MatchArgs) -> Result<Option<CalibrationFile>, OfflineError> {
    if let Some(path) = &args.calibration {
        let text = read(path)?;
        let calibration = serde_json::from_slice(&text);
        return calibration.map(Some).map_err(|why| OfflineError::Calibration {
            path: path.clone(),
            why,
        });
    }
    // clap sees to it that the others are there if --focal is.
    let given = (args.focal, args.cx, args.cy, args.baseline);
    let (Some(focal_px), Some(cx_px), Some(cy_px), Some(baseline_m)) = given else {
        return Ok(None);
    };
    Ok(Some(CalibrationFile {
        focal_px,
        cx_px,
        cy_px,
        baseline_m,
        doffs_px: args.doffs.unwrap_or(0.0),
    }))
}
