//! Options of a request: from JSON, as over HTTP, and from flags, which win.

use std::path::Path;
use std::time::Duration;

use serde::Deserialize;
use stereo_client::v1;

use crate::args::MatchingArgs;
use crate::calibration;
use crate::failure::Failure;

/// What all requests of a command have in common.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Wanted {
    pub(crate) options: v1::Options,
    pub(crate) calibration: Option<v1::Calibration>,
}

impl Wanted {
    /// What the command line asks for, of pairs such as that of `left_image`.
    pub(crate) fn from_args(args: &MatchingArgs, left_image: &Path) -> Result<Self, Failure> {
        let mut wanted = match &args.options {
            Some(given) => parse(&text_of(given)?)?,
            None => Self::default(),
        };
        wanted.calibration = calibration::read(&args.calibration, left_image)?.or(wanted.calibration);
        let options = &mut wanted.options;
        if let Some(budget) = args.budget {
            options.latency_budget = budget.try_into().ok();
        }
        if let Some(preset) = &args.preset {
            options.preset = choice("preset", preset, v1::Preset::from_str_name)?;
        }
        if args.dense {
            options.density = v1::Density::Dense.into();
        }
        options.max_iterations = args.max_iterations.or(options.max_iterations);
        options.num_disparities = args.num_disparities.or(options.num_disparities);
        options.min_disparity = args.min_disparity.or(options.min_disparity);
        options.min_confidence = args.min_confidence.or(options.min_confidence);
        if args.allow_downscale {
            options.allow_downscale = Some(true);
        }
        Ok(wanted)
    }

    /// A request for a pair.
    pub(crate) fn request(&self, (left, right): (v1::Image, v1::Image)) -> v1::StereoRequest {
        v1::StereoRequest {
            left: Some(left),
            right: Some(right),
            options: Some(self.options.clone()),
            calibration: self.calibration,
            ..v1::StereoRequest::default()
        }
    }

    /// Asks for these parts, unless the user has chosen.
    pub(crate) fn want_outputs(&mut self, outputs: &[v1::Output]) {
        if self.options.outputs.is_empty() {
            self.options.outputs = outputs.iter().map(|&output| output.into()).collect();
        }
    }
}

/// The latency budget of requests with these options.
pub(crate) fn budget(options: &v1::Options) -> Duration {
    let given = options.latency_budget.and_then(|budget| budget.try_into().ok());
    given.unwrap_or(Duration::from_millis(100))
}

/// JSON itself, or `@` and the file it is in.
fn text_of(given: &str) -> Result<String, Failure> {
    match given.strip_prefix('@') {
        None => Ok(given.to_owned()),
        Some(file) => std::fs::read_to_string(file).map_err(|why| {
            Failure::usage(format!(
                "--options {given} can't be read ({why}): name a file, or give the JSON itself"
            ))
        }),
    }
}

fn parse(json: &str) -> Result<Wanted, Failure> {
    let form: Form = serde_json::from_str(json).map_err(|why| {
        Failure::usage(format!(
            "--options is not understood ({why}): give a JSON object such as '{{\"density\": \"dense\", \"num_disparities\": 64}}'"
        ))
    })?;
    form.into_wanted()
}

/// The names that options have in JSON over HTTP.
#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct Form {
    latency_budget_ms: Option<f64>,
    max_iterations: Option<u32>,
    preset: Option<String>,
    min_confidence: Option<f32>,
    num_disparities: Option<u32>,
    min_disparity: Option<i32>,
    density: Option<String>,
    roi: Option<Region>,
    focus: Vec<Focus>,
    priority_class: Option<String>,
    outputs: Vec<String>,
    disparity_encoding: Option<String>,
    compression: Option<String>,
    allow_downscale: Option<bool>,
    mesh: Option<Mesh>,
    colors: Option<bool>,
    mesh_is_optional: Option<bool>,
    calibration: Option<Calibration>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Region {
    x: u32,
    y: u32,
    width: u32,
    height: u32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Focus {
    x: u32,
    y: u32,
    width: u32,
    height: u32,
    weight: Option<f32>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct Mesh {
    keep_rejected: Option<bool>,
    max_disparity_step_px: Option<f32>,
    min_valid_share: Option<f32>,
    tolerance_px: Option<f32>,
    max_triangles: Option<u32>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Calibration {
    focal_px: f64,
    cx_px: f64,
    cy_px: f64,
    baseline_m: f64,
    #[serde(default)]
    doffs_px: f64,
}

impl Form {
    fn into_wanted(self) -> Result<Wanted, Failure> {
        let latency_budget = self.latency_budget_ms.map(|ms| {
            Duration::try_from_secs_f64(ms / 1e3).map_err(|why| {
                Failure::usage(format!(
                    "latency_budget_ms is {ms} ({why}): give milliseconds above 0"
                ))
            })
        });
        let named = |field: &'static str, given: &Option<String>, from: fn(&str) -> Option<i32>| {
            given.as_ref().map_or(Ok(0), |name| choice(field, name, from))
        };
        let output = |name: &String| choice("output", name, v1::Output::from_str_name);
        let options = v1::Options {
            latency_budget: latency_budget
                .transpose()?
                .and_then(|budget| budget.try_into().ok()),
            max_iterations: self.max_iterations,
            preset: named("preset", &self.preset, |n| {
                v1::Preset::from_str_name(n).map(Into::into)
            })?,
            min_confidence: self.min_confidence,
            num_disparities: self.num_disparities,
            min_disparity: self.min_disparity,
            density: named("density", &self.density, |n| {
                v1::Density::from_str_name(n).map(Into::into)
            })?,
            roi: self
                .roi
                .map(|Region { x, y, width, height }| v1::Region { x, y, width, height }),
            focus: self.focus.into_iter().map(Focus::into_proto).collect(),
            priority_class: named("priority_class", &self.priority_class, |n| {
                v1::PriorityClass::from_str_name(n).map(Into::into)
            })?,
            outputs: self.outputs.iter().map(output).collect::<Result<_, _>>()?,
            disparity_encoding: named("disparity_encoding", &self.disparity_encoding, |n| {
                v1::DisparityEncoding::from_str_name(n).map(Into::into)
            })?,
            compression: named("compression", &self.compression, |n| {
                v1::Compression::from_str_name(n).map(Into::into)
            })?,
            allow_downscale: self.allow_downscale,
            mesh: self.mesh.map(|mesh| v1::MeshOptions {
                keep_rejected: mesh.keep_rejected,
                max_disparity_step_px: mesh.max_disparity_step_px,
                min_valid_share: mesh.min_valid_share,
                tolerance_px: mesh.tolerance_px,
                max_triangles: mesh.max_triangles,
            }),
            colors: self.colors,
            mesh_is_optional: self.mesh_is_optional,
        };
        let calibration = self.calibration.map(|camera| v1::Calibration {
            focal_px: camera.focal_px,
            cx_px: camera.cx_px,
            cy_px: camera.cy_px,
            baseline_m: camera.baseline_m,
            doffs_px: camera.doffs_px,
        });
        Ok(Wanted { options, calibration })
    }
}

impl Focus {
    fn into_proto(self) -> v1::Focus {
        let Self {
            x,
            y,
            width,
            height,
            weight,
        } = self;
        v1::Focus {
            region: Some(v1::Region { x, y, width, height }),
            weight,
        }
    }
}

/// The wire's number of a value: its name in lower case and without the field's name before it.
fn choice<E: Into<i32>>(field: &str, given: &str, from: impl Fn(&str) -> Option<E>) -> Result<i32, Failure> {
    let name = format!("{}_{}", field, given).to_ascii_uppercase();
    let value = from(&name).map(Into::into).filter(|&value| value != 0);
    value.ok_or_else(|| {
        Failure::usage(format!(
            "there is no {field} called {given:?}: the README's table of options has those there are"
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_have_the_names_that_they_have_over_http() {
        let json = r#"{"latency_budget_ms": 12.5, "preset": "paper", "density": "dense", "outputs": ["mesh", "depth"],
            "roi": {"x": 1, "y": 2, "width": 3, "height": 4}, "calibration": {"focal_px": 5, "cx_px": 1, "cy_px": 2, "baseline_m": 0.1},
            "disparity_encoding": "f32", "compression": "zstd", "priority_class": "best_effort"}"#;
        let wanted = parse(json).unwrap();
        let options = wanted.options;
        assert_eq!(budget(&options), Duration::from_micros(12_500));
        assert_eq!(
            (options.preset(), options.density()),
            (v1::Preset::Paper, v1::Density::Dense)
        );
        assert_eq!(options.outputs, [4, 3]);
        assert_eq!(options.disparity_encoding(), v1::DisparityEncoding::F32);
        assert_eq!(options.compression(), v1::Compression::Zstd);
        assert_eq!(options.priority_class(), v1::PriorityClass::BestEffort);
        assert_eq!(options.roi.map(|roi| roi.height), Some(4));
        assert_eq!(wanted.calibration.map(|camera| camera.doffs_px), Some(0.0));
    }

    #[test]
    fn what_is_no_option_is_named() {
        for (json, word) in [
            (r#"{"colour": 1}"#, "colour"),
            (r#"{"preset": "best"}"#, "best"),
            (r#"{"preset": "unspecified"}"#, "unspecified"),
            (r#"{"latency_budget_ms": -1}"#, "latency_budget_ms"),
            ("80", "JSON object"),
        ] {
            let failure = parse(json).unwrap_err();
            assert!(failure.message.contains(word), "{failure}");
        }
    }
}
