//! The multipart form: two image files and options as JSON, as the same message that comes as protobuf.
//!
//! Names in JSON are the message's, except that durations are numbers of milliseconds named `*_ms`. What is absent or `null` has
//! its default. Here only types are checked, and numbers that the message could not hold; ranges are checked where the
//! message's are.

mod choice;
mod object;
mod schema;

use bytes::Bytes;
use prost_types::Timestamp;
use serde::Deserialize;
use stereo_proto::v1;
use utoipa::ToSchema;

use self::choice::{COMPRESSION, DENSITY, DISPARITY_ENCODING, OUTPUTS, PRESET, PRIORITY_CLASS, choice};
use self::object::Object;
use super::budget;
use super::range::{self, MAX_ITERATIONS, MAX_TRIANGLES, MIN_DISPARITY, NUM_DISPARITIES, Range};
use crate::decode::{self, Side};
use crate::job::ImageEncoding;
use crate::status::ServiceError;

/// The parts of a form; `None` = not sent.
#[derive(Debug, Clone, Default)]
pub struct FormParts {
    /// Left image: a PNG or JPEG file.
    pub left: Option<Bytes>,
    /// Right image: a PNG or JPEG file.
    pub right: Option<Bytes>,
    /// Options: a JSON object.
    pub options: Option<Bytes>,
}

/// The message that says the same as the form.
///
/// # Errors
/// [`ServiceError::Invalid`] naming the image that is no PNG or JPEG file, or the option that is unknown or of another
/// type; [`ServiceError::TooLarge`] as [`decode::inspect`].
pub fn request_from_form(parts: FormParts) -> Result<v1::StereoRequest, ServiceError> {
    let left = parts.left.map(|file| image(Side::Left, file)).transpose()?;
    let right = parts.right.map(|file| image(Side::Right, file)).transpose()?;
    let mut request = match parts.options {
        None => v1::StereoRequest::default(),
        Some(json) => options_from_json(&json)?,
    };
    request.left = left;
    request.right = right;
    Ok(request)
}

/// Everything of a request but its images, from a JSON object.
pub(super) fn options_from_value(json: &serde_json::Value) -> Result<v1::StereoRequest, ServiceError> {
    options_from_json(json.to_string().as_bytes())
}

fn image(side: Side, file: Bytes) -> Result<v1::Image, ServiceError> {
    let encoding = match decode::inspect(side, &file)?.0 {
        ImageEncoding::Jpeg => v1::ImageEncoding::Jpeg,
        ImageEncoding::Png | ImageEncoding::Raw(_) => v1::ImageEncoding::Png,
    };
    Ok(v1::Image {
        encoding: encoding.into(),
        data: file,
        ..v1::Image::default()
    })
}

/// The two images of a pair and what is wanted of them.
#[derive(ToSchema)]
#[schema(as = Pair)]
#[expect(dead_code, reason = "described here, read part by part")]
pub(crate) struct FormDescription {
    /// Rectified left image: a PNG or JPEG file.
    #[schema(value_type = String, format = Binary)]
    left: Bytes,
    /// Rectified right image of the same size: a PNG or JPEG file.
    #[schema(value_type = String, format = Binary)]
    right: Bytes,
    /// What is wanted; absent: the defaults.
    options: Option<FormOptions>,
}

/// Everything of a request but its images. What is absent or null has its default.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Options)]
pub(crate) struct FormOptions {
    /// Time from the first byte of the request at the server to the answer, in milliseconds. Absent: 100, and no bound for
    /// background requests.
    #[schema(exclusive_minimum = 0, maximum = 60000)]
    latency_budget_ms: Option<f64>,
    #[schema(schema_with = schema::max_iterations)]
    max_iterations: Option<f64>,
    #[schema(schema_with = schema::preset)]
    preset: Option<String>,
    #[schema(schema_with = schema::min_confidence)]
    min_confidence: Option<f64>,
    #[schema(schema_with = schema::num_disparities)]
    num_disparities: Option<f64>,
    #[schema(schema_with = schema::min_disparity)]
    min_disparity: Option<f64>,
    #[schema(schema_with = schema::density)]
    density: Option<String>,
    /// The part of the left image that is matched. Absent: the whole image.
    #[schema(value_type = Option<FormRegion>)]
    roi: Option<Object<FormRegion>>,
    /// Regions that matter more than the rest and are finished first.
    #[schema(value_type = Option<Vec<FormFocus>>, max_items = 16)]
    focus: Option<Vec<Object<FormFocus>>>,
    #[schema(schema_with = schema::priority_class)]
    priority_class: Option<String>,
    #[schema(schema_with = schema::outputs)]
    outputs: Option<Vec<String>>,
    #[schema(schema_with = schema::disparity_encoding)]
    disparity_encoding: Option<String>,
    #[schema(schema_with = schema::compression)]
    compression: Option<String>,
    /// Whether the server may match at half resolution when the budget is short or it is overloaded. Absent: false.
    allow_downscale: Option<bool>,
    /// How fine the mesh is, and which triangles it keeps.
    #[schema(value_type = Option<FormMesh>)]
    mesh: Option<Object<FormMesh>>,
    /// Whether mesh and points get the left image's colours. Absent: false.
    colors: Option<bool>,
    /// Whether the mesh may be left out when the budget is short or the server overloaded. Absent: false.
    mesh_is_optional: Option<bool>,
    /// Geometry of the rectified pair: makes metres of pixels.
    #[schema(value_type = Option<FormCalibration>)]
    calibration: Option<Object<FormCalibration>>,
    /// The client's name for the request.
    #[schema(max_length = 128)]
    request_id: Option<String>,
    /// The camera that took the pair.
    #[schema(max_length = 64)]
    camera_id: Option<String>,
    /// Number of the frame: a newer one of the same camera takes the place of one that still waits.
    sequence: Option<u64>,
    /// When the pair was taken (RFC 3339).
    #[schema(value_type = Option<String>, format = DateTime)]
    capture_time: Option<String>,
}

/// A part of the left image, in whole pixels.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Region)]
pub(crate) struct FormRegion {
    /// First column.
    #[schema(minimum = 0)]
    x: f64,
    /// First row.
    #[schema(minimum = 0)]
    y: f64,
    /// Columns.
    #[schema(minimum = 0)]
    width: f64,
    /// Rows.
    #[schema(minimum = 0)]
    height: f64,
}

/// A region that matters more than the rest, in whole pixels.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Focus)]
pub(crate) struct FormFocus {
    /// First column.
    #[schema(minimum = 0)]
    x: f64,
    /// First row.
    #[schema(minimum = 0)]
    y: f64,
    /// Columns.
    #[schema(minimum = 0)]
    width: f64,
    /// Rows.
    #[schema(minimum = 0)]
    height: f64,
    #[schema(schema_with = schema::focus_weight)]
    weight: Option<f64>,
}

/// How fine a mesh is, and which triangles it keeps.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = MeshOptions)]
pub(crate) struct FormMesh {
    /// Keeps triangles that span a depth discontinuity or failed validation as well. Absent: false.
    keep_rejected: Option<bool>,
    #[schema(schema_with = schema::max_disparity_step_px)]
    max_disparity_step_px: Option<f64>,
    #[schema(schema_with = schema::min_valid_share)]
    min_valid_share: Option<f64>,
    #[schema(schema_with = schema::tolerance_px)]
    tolerance_px: Option<f64>,
    #[schema(schema_with = schema::max_triangles)]
    max_triangles: Option<f64>,
}

/// Geometry of a rectified pair: depth = focal_px * baseline_m / (disparity + doffs_px).
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Calibration)]
pub(crate) struct FormCalibration {
    /// Focal length in pixels.
    #[schema(exclusive_minimum = 0)]
    focal_px: f64,
    /// Column of the left camera's principal point, in pixels.
    cx_px: f64,
    /// Row of the principal point, in pixels.
    cy_px: f64,
    /// Distance of the two cameras in metres.
    #[schema(exclusive_minimum = 0)]
    baseline_m: f64,
    /// Column of the right camera's principal point less that of the left, in pixels. Absent: 0.
    #[serde(default)]
    doffs_px: f64,
}

fn options_from_json(json: &[u8]) -> Result<v1::StereoRequest, ServiceError> {
    if json.trim_ascii().is_empty() {
        return Err(ServiceError::Invalid(
            "the options part is empty: leave it out, or send a JSON object such as {\"latency_budget_ms\": 80}".into(),
        ));
    }
    let mut reader = serde_json::Deserializer::from_slice(json);
    let parsed: Result<Object<FormOptions>, _> = serde_path_to_error::deserialize(&mut reader);
    let Object(form) = parsed.map_err(|why| match why.path().to_string().as_str() {
        "." => ServiceError::Invalid(format!("the options are not valid JSON options: {}", why.inner())),
        path => ServiceError::Invalid(format!(
            "{path} is not valid in the JSON options: {}",
            why.inner()
        )),
    })?;
    reader
        .end()
        .map_err(|why| ServiceError::Invalid(format!("the options must be one JSON object: {why}")))?;
    form.into_request()
}

impl FormOptions {
    fn into_request(self) -> Result<v1::StereoRequest, ServiceError> {
        let latency_budget = self
            .latency_budget_ms
            .map(|ms| budget::from_ms("latency_budget_ms", ms))
            .transpose()?;
        let options = v1::Options {
            latency_budget: latency_budget.and_then(|budget| budget.try_into().ok()),
            max_iterations: self
                .max_iterations
                .map(|got| whole(&MAX_ITERATIONS, got))
                .transpose()?,
            preset: choice(&PRESET, self.preset, v1::Preset::from_str_name)?,
            min_confidence: self.min_confidence.map(narrow),
            num_disparities: self
                .num_disparities
                .map(|got| whole(&NUM_DISPARITIES, got))
                .transpose()?,
            min_disparity: self
                .min_disparity
                .map(|got| whole(&MIN_DISPARITY, got))
                .transpose()?,
            density: choice(&DENSITY, self.density, v1::Density::from_str_name)?,
            roi: self.roi.map(|Object(roi)| roi.into_proto("roi")).transpose()?,
            focus: self
                .focus
                .into_iter()
                .flatten()
                .map(|Object(focus)| focus.into_proto())
                .collect::<Result<_, _>>()?,
            priority_class: choice(
                &PRIORITY_CLASS,
                self.priority_class,
                v1::PriorityClass::from_str_name,
            )?,
            outputs: self
                .outputs
                .into_iter()
                .flatten()
                .map(|name| choice(&OUTPUTS, Some(name), v1::Output::from_str_name))
                .collect::<Result<_, _>>()?,
            disparity_encoding: choice(
                &DISPARITY_ENCODING,
                self.disparity_encoding,
                v1::DisparityEncoding::from_str_name,
            )?,
            compression: choice(&COMPRESSION, self.compression, v1::Compression::from_str_name)?,
            allow_downscale: self.allow_downscale,
            mesh: self.mesh.map(|Object(mesh)| mesh.into_proto()).transpose()?,
            colors: self.colors,
            mesh_is_optional: self.mesh_is_optional,
        };
        Ok(v1::StereoRequest {
            request_id: self.request_id.unwrap_or_default(),
            camera_id: self.camera_id.unwrap_or_default(),
            sequence: self.sequence,
            capture_time: self.capture_time.map(|text| capture_time(&text)).transpose()?,
            left: None,
            right: None,
            calibration: self
                .calibration
                .map(|Object(calibration)| calibration.into_proto()),
            options: Some(options),
        })
    }
}

impl FormRegion {
    fn into_proto(self, option: &str) -> Result<v1::Region, ServiceError> {
        let px = |name: &str, got: f64| {
            let refuse = || {
                ServiceError::Invalid(format!(
                    "{option}.{name} must be a whole number of pixels, 0 or more, got {got}"
                ))
            };
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "used only if it is in range"
            )]
            (got % 1.0 == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&got))
                .then_some(got as u32)
                .ok_or_else(refuse)
        };
        Ok(v1::Region {
            x: px("x", self.x)?,
            y: px("y", self.y)?,
            width: px("width", self.width)?,
            height: px("height", self.height)?,
        })
    }
}

impl FormFocus {
    fn into_proto(self) -> Result<v1::Focus, ServiceError> {
        let Self {
            x,
            y,
            width,
            height,
            weight,
        } = self;
        let region = FormRegion { x, y, width, height };
        Ok(v1::Focus {
            region: Some(region.into_proto("focus")?),
            weight: weight.map(narrow),
        })
    }
}

impl FormMesh {
    fn into_proto(self) -> Result<v1::MeshOptions, ServiceError> {
        Ok(v1::MeshOptions {
            keep_rejected: self.keep_rejected,
            max_disparity_step_px: self.max_disparity_step_px.map(narrow),
            min_valid_share: self.min_valid_share.map(narrow),
            tolerance_px: self.tolerance_px.map(narrow),
            max_triangles: self
                .max_triangles
                .map(|got| MAX_TRIANGLES.check_u32(got))
                .transpose()?,
        })
    }
}

impl FormCalibration {
    fn into_proto(self) -> v1::Calibration {
        let Self {
            focal_px,
            cx_px,
            cy_px,
            baseline_m,
            doffs_px,
        } = self;
        v1::Calibration {
            focal_px,
            cx_px,
            cy_px,
            baseline_m,
            doffs_px,
        }
    }
}

/// A number of the range as the message's integer.
fn whole<T: From<u16>>(range: &Range, got: f64) -> Result<T, ServiceError> {
    range.check_u16(got).map(T::from)
}

/// The message's floats; a number too large becomes infinite and is refused by its range.
#[expect(
    clippy::cast_possible_truncation,
    reason = "rounding to the nearest f32 is what is wanted"
)]
fn narrow(got: f64) -> f32 {
    got as f32
}

fn capture_time(text: &str) -> Result<Timestamp, ServiceError> {
    text.parse().map_err(|_| {
        let start: String = text.chars().take(40).collect();
        ServiceError::Invalid(format!(
            "capture_time must be a time in RFC 3339 such as 2026-01-31T12:00:00.25Z, got {start:?}"
        ))
    })
}

#[cfg(test)]
mod tests;
