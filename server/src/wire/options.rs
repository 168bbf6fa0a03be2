//! Options of a request: every one is honoured, or refused by name.

use std::time::Duration;

use stereo::{Density, DisparityRange, Focus, MeshParams, Params, ParamsError, Preset, Roi, Shape};
use stereo_proto::v1;

use super::budget;
use super::range::{
    FOCUS_WEIGHT, MAX_DISPARITY_STEP_PX, MAX_ITERATIONS, MAX_TRIANGLES, MESH_TOLERANCE_PX, MIN_CONFIDENCE,
    MIN_DISPARITY, MIN_VALID_SHARE, NUM_DISPARITIES,
};
use crate::job::{
    Calibration, Compression, DisparityEncoding, FrameOptions, Outputs, PriorityClass, ReplyFormat,
};
use crate::status::ServiceError;

/// End of the disparities that 16 bits in 1/256 px can say, in px.
const MAX_16_BIT_DISPARITY_PX: u32 = 256;

/// What the rest of the request says about its options.
pub(super) struct Circumstances<'a> {
    /// Size of the images.
    pub(super) shape: Shape,
    /// Whether depth and points can be computed.
    pub(super) is_calibrated: bool,
    /// The bodies the reply will have.
    pub(super) formats: &'a [ReplyFormat],
    /// The smallest budget given outside the message.
    pub(super) latency_budget: Option<Duration>,
    /// The class of a request that names none; background = it can't have another.
    pub(super) priority: PriorityClass,
}

/// The options with all defaults filled in.
pub(super) fn validate(
    options: &v1::Options,
    circumstances: &Circumstances<'_>,
) -> Result<FrameOptions, ServiceError> {
    let defaults = FrameOptions::default();
    let priority = priority(options, circumstances)?;
    let given = options.latency_budget.map(budget::from_proto).transpose()?;
    let latency_budget = given.into_iter().chain(circumstances.latency_budget).min();
    let outputs = outputs(options)?;
    if !circumstances.is_calibrated {
        for (is_wanted, name) in [(outputs.depth, "depth"), (outputs.points, "points")] {
            if is_wanted {
                return Err(invalid(format!(
                    "outputs: {name} needs a calibration (focal_px, cx_px, cy_px, baseline_m): add it or leave {name} \
                     out"
                )));
            }
        }
    }
    let params = params(options, &defaults.params, circumstances.shape)?;
    let disparity_encoding = disparity_encoding(options)?;
    let is_16_bit = |format: &ReplyFormat| match format {
        ReplyFormat::DisparityPng => true,
        ReplyFormat::DisparityPart => disparity_encoding != DisparityEncoding::F32,
        ReplyFormat::Protobuf => outputs.disparity && disparity_encoding != DisparityEncoding::F32,
        _ => false,
    };
    let end_px = u32::from(params.range.min_px) + u32::from(params.range.count);
    if end_px > MAX_16_BIT_DISPARITY_PX && circumstances.formats.iter().any(is_16_bit) {
        return Err(ServiceError::Unmatchable(format!(
            "min_disparity + num_disparities is {end_px}, but 16-bit disparities end at {MAX_16_BIT_DISPARITY_PX} px: \
             search fewer, or ask for a protobuf result with disparity_encoding f32"
        )));
    }
    let default_budget = match priority {
        PriorityClass::Background => FrameOptions::UNBOUNDED,
        PriorityClass::Deadline | PriorityClass::BestEffort => defaults.latency_budget,
    };
    Ok(FrameOptions {
        latency_budget: latency_budget.unwrap_or(default_budget),
        priority,
        max_iterations: options.max_iterations.map(max_iterations).transpose()?,
        params,
        mesh: mesh(options.mesh.unwrap_or_default(), defaults.mesh)?,
        outputs,
        disparity_encoding,
        compression: compression(options)?,
        allow_downscale: options.allow_downscale.unwrap_or(defaults.allow_downscale),
    })
}

fn compression(options: &v1::Options) -> Result<Compression, ServiceError> {
    match v1::Compression::try_from(options.compression) {
        Ok(v1::Compression::Unspecified | v1::Compression::None) => Ok(Compression::None),
        Ok(v1::Compression::Zstd) => Ok(Compression::Zstd),
        Ok(v1::Compression::Lz4) => Ok(Compression::Lz4),
        Err(_) => Err(unknown("compression", options.compression, "none, zstd or lz4")),
    }
}

fn priority(options: &v1::Options, circumstances: &Circumstances<'_>) -> Result<PriorityClass, ServiceError> {
    let given = match v1::PriorityClass::try_from(options.priority_class) {
        Ok(v1::PriorityClass::Unspecified) => None,
        Ok(v1::PriorityClass::Deadline) => Some(PriorityClass::Deadline),
        Ok(v1::PriorityClass::BestEffort) => Some(PriorityClass::BestEffort),
        Ok(v1::PriorityClass::Background) => Some(PriorityClass::Background),
        Err(_) => {
            let expected = "deadline, best_effort or background";
            return Err(unknown("priority_class", options.priority_class, expected));
        }
    };
    let class = given.unwrap_or(circumstances.priority);
    if circumstances.priority == PriorityClass::Background && class != PriorityClass::Background {
        return Err(invalid(format!(
            "priority_class {} can't be had in a batch, whose requests are all of class background: leave it out, or send \
             the request to /v1/stereo",
            class.name()
        )));
    }
    if class == PriorityClass::Background && circumstances.latency_budget.is_some() {
        return Err(invalid(
            "a header gives a deadline, but a request of class background has none: leave the header out, or give \
             latency_budget in the options, which counts from the moment a worker takes the request"
                .to_owned(),
        ));
    }
    Ok(class)
}

fn params(options: &v1::Options, defaults: &Params, shape: Shape) -> Result<Params, ServiceError> {
    let preset = match v1::Preset::try_from(options.preset) {
        Ok(v1::Preset::Unspecified) => defaults.preset,
        Ok(v1::Preset::Default) => Preset::Default,
        Ok(v1::Preset::Paper) => Preset::Paper,
        Ok(v1::Preset::Fast) => Preset::Fast,
        Err(_) => return Err(unknown("preset", options.preset, "default, fast or paper")),
    };
    let density = match v1::Density::try_from(options.density) {
        Ok(v1::Density::Unspecified) => defaults.density,
        Ok(v1::Density::SemiDense) => Density::SemiDense,
        Ok(v1::Density::Dense) => Density::Dense,
        Err(_) => return Err(unknown("density", options.density, "semi_dense or dense")),
    };
    let min_px = options
        .min_disparity
        .map(|got| MIN_DISPARITY.check_u16(got.into()))
        .transpose()?;
    let count = options
        .num_disparities
        .map(|got| NUM_DISPARITIES.check_u16(got.into()))
        .transpose()?;
    let min_confidence = options
        .min_confidence
        .map(|got| MIN_CONFIDENCE.check_f32(got))
        .transpose()?;
    let params = Params {
        preset,
        range: DisparityRange {
            min_px: min_px.unwrap_or(defaults.range.min_px),
            count: count.unwrap_or(defaults.range.count),
        },
        density,
        min_confidence: min_confidence.unwrap_or(defaults.min_confidence),
        roi: options.roi.map(|region| roi("roi", region)).transpose()?,
        focus: focus(&options.focus)?,
    };
    // The ranges have been checked above; what is left depends on the image's size.
    params.validate(shape).map_err(|why| match why {
        ParamsError::RoiOutsideImage { roi: Roi { x, y, width, height }, width_px, height_px } => {
            ServiceError::Unmatchable(format!(
                "roi ({width} x {height} px from column {x}, row {y}) leaves the {width_px} x {height_px} image: make it \
                 lie inside"
            ))
        }
        ParamsError::FocusOutside { region: Roi { x, y, width, height }, within } => {
            ServiceError::Unmatchable(format!(
                "a focus region ({width} x {height} px from column {x}, row {y}) leaves the image or the roi ({} x {} px from \
                 column {}, row {}): make it lie inside",
                within.width, within.height, within.x, within.y
            ))
        }
        ParamsError::FocusTooLarge { most_px, got_px } => ServiceError::Unmatchable(format!(
            "the focus regions have {got_px} pixels together, the image {most_px}: leave some out or make them smaller"
        )),
        other => ServiceError::Unmatchable(other.to_string()),
    })?;
    Ok(params)
}

fn focus(list: &[v1::Focus]) -> Result<Vec<Focus>, ServiceError> {
    if list.len() > Focus::MOST {
        return Err(invalid(format!(
            "focus must have at most {} regions, got {}: leave some out",
            Focus::MOST,
            list.len()
        )));
    }
    list.iter()
        .map(|focus| {
            let region = focus
                .region
                .ok_or_else(|| invalid("a focus has no region: give x, y, width and height".to_owned()))?;
            Ok(Focus {
                region: roi("a focus region", region)?,
                weight: FOCUS_WEIGHT.check_f32(focus.weight.unwrap_or(1.0))?,
            })
        })
        .collect()
}

fn roi(name: &str, region: v1::Region) -> Result<Roi, ServiceError> {
    if region.width == 0 || region.height == 0 {
        return Err(invalid(format!(
            "{name} must be at least 1 x 1 px, got {} x {}: give x, y, width and height",
            region.width, region.height
        )));
    }
    Ok(Roi {
        x: region.x as usize,
        y: region.y as usize,
        width: region.width as usize,
        height: region.height as usize,
    })
}

fn max_iterations(got: u32) -> Result<u8, ServiceError> {
    let rungs = MAX_ITERATIONS.check_u16(got.into())?;
    Ok(u8::try_from(rungs).unwrap_or(u8::MAX))
}

fn mesh(options: v1::MeshOptions, defaults: MeshParams) -> Result<MeshParams, ServiceError> {
    let step = options
        .max_disparity_step_px
        .map(|got| MAX_DISPARITY_STEP_PX.check_f32(got))
        .transpose()?;
    let share = options
        .min_valid_share
        .map(|got| MIN_VALID_SHARE.check_f32(got))
        .transpose()?;
    let tolerance = options
        .tolerance_px
        .map(|got| MESH_TOLERANCE_PX.check_f32(got))
        .transpose()?;
    let triangles = options
        .max_triangles
        .map(|got| MAX_TRIANGLES.check_u32(got.into()))
        .transpose()?;
    Ok(MeshParams {
        tolerance_px: tolerance.unwrap_or(defaults.tolerance_px),
        max_triangles: triangles.unwrap_or(defaults.max_triangles),
        keep_rejected: options.keep_rejected.unwrap_or(defaults.keep_rejected),
        max_disparity_step_px: step.unwrap_or(defaults.max_disparity_step_px),
        min_valid_share: share.unwrap_or(defaults.min_valid_share),
    })
}

fn outputs(options: &v1::Options) -> Result<Outputs, ServiceError> {
    let colors = options.colors.unwrap_or(false);
    let mesh_is_optional = options.mesh_is_optional.unwrap_or(false);
    if options.outputs.is_empty() {
        return Ok(Outputs {
            colors,
            mesh_is_optional,
            ..Outputs::default()
        });
    }
    let mut wanted = Outputs {
        disparity: false,
        confidence: false,
        depth: false,
        mesh: false,
        mesh_is_optional,
        points: false,
        colors,
    };
    for &output in &options.outputs {
        match v1::Output::try_from(output) {
            Ok(v1::Output::Disparity) => wanted.disparity = true,
            Ok(v1::Output::Confidence) => wanted.confidence = true,
            Ok(v1::Output::Depth) => wanted.depth = true,
            Ok(v1::Output::Mesh) => wanted.mesh = true,
            Ok(v1::Output::Points) => wanted.points = true,
            Ok(v1::Output::Unspecified) | Err(_) => {
                return Err(unknown(
                    "outputs",
                    output,
                    "disparity, confidence, depth, mesh or points",
                ));
            }
        }
    }
    Ok(wanted)
}

fn disparity_encoding(options: &v1::Options) -> Result<DisparityEncoding, ServiceError> {
    use v1::DisparityEncoding as Wire;
    match Wire::try_from(options.disparity_encoding) {
        Ok(Wire::Unspecified) => Ok(DisparityEncoding::default()),
        Ok(Wire::F32) => Ok(DisparityEncoding::F32),
        Ok(Wire::U16) => Ok(DisparityEncoding::U16),
        Ok(Wire::Png16) => Ok(DisparityEncoding::Png16),
        Err(_) => Err(unknown(
            "disparity_encoding",
            options.disparity_encoding,
            "f32, u16 or png16",
        )),
    }
}

/// The calibration if every number can be true.
pub(super) fn calibration(wire: v1::Calibration) -> Result<Calibration, ServiceError> {
    let v1::Calibration {
        focal_px,
        cx_px,
        cy_px,
        baseline_m,
        doffs_px,
    } = wire;
    for (name, value) in [("focal_px", focal_px), ("baseline_m", baseline_m)] {
        if !(value.is_finite() && value > 0.0) {
            return Err(invalid(format!(
                "calibration.{name} must be a finite number above 0, got {value}"
            )));
        }
    }
    for (name, value) in [("cx_px", cx_px), ("cy_px", cy_px), ("doffs_px", doffs_px)] {
        if !value.is_finite() {
            return Err(invalid(format!(
                "calibration.{name} must be a finite number, got {value}"
            )));
        }
    }
    Ok(Calibration {
        focal_px,
        cx_px,
        cy_px,
        baseline_m,
        doffs_px,
    })
}

fn invalid(message: String) -> ServiceError {
    ServiceError::Invalid(message)
}

fn unknown(name: &str, got: i32, expected: &str) -> ServiceError {
    invalid(format!("{name} has the unknown value {got}: use {expected}"))
}

#[cfg(test)]
mod tests;
