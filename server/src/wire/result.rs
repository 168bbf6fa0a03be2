//! A finished frame as the wire's `StereoResult`.

use std::time::SystemTime;

use bytes::Bytes;
use prost::{EncodeError, Message};
use stereo::{FIXED_PER_PX, Roi};
use stereo_proto::v1;

use super::compress::compress;
use super::pixels::{Field, Pixels};
use super::report;
use crate::decode::{self, ColorImage, Side};
use crate::encode::disparity_png;
use crate::encode::memory::{Encoded, Memory, encoded};
use crate::encode::surface::Surface;
use crate::job::{Calibration, Compression, DisparityEncoding, MatchedFrame, Report};
use crate::status::ServiceError;

/// More than a report takes.
const REPORT_BYTES: usize = 1024;

/// The parts of `frame` that were wanted, as the bytes of a `StereoResult`. `finish` is called for the report when
/// everything else is encoded, so that it can say how long that took.
///
/// # Errors
/// [`ServiceError::Internal`] if the mesh was wanted but not made or the PNG encoder fails; if colours were wanted, what
/// [`decode::color`] refuses.
pub fn result_body(
    frame: &MatchedFrame<'_>,
    memory: Option<&dyn Memory>,
    finish: &dyn Fn() -> Report,
) -> Result<Encoded, ServiceError> {
    let mut parts = FrameParts::new(frame)?;
    parts.compress(frame.request.options.compression)?;
    let pixels = parts.pixels.take();
    let result = parts.into_result(frame);
    let len = result.encoded_len() + pixels.map_or(0, |pixels| pixels.field_len(Field::OfResult));
    encoded(memory, len + REPORT_BYTES, |mut body| {
        result.encode(&mut body)?;
        if let Some(pixels) = pixels {
            pixels.put_field(Field::OfResult, body)?;
        }
        // The report is the last field, and messages that follow each other are one: it can be written when everything else is.
        let rest = v1::StereoResult {
            report: Some(report::to_proto(&finish())),
            ..v1::StereoResult::default()
        };
        rest.encode(&mut body)
    })
    .map_err(unwritten)
}

fn unwritten(why: EncodeError) -> ServiceError {
    ServiceError::Internal(format!("writing a result: {why}"))
}

/// The parts of `frame` that were wanted, but for the report.
///
/// # Errors
/// As [`result_body`].
pub(super) fn without_report(frame: &MatchedFrame<'_>) -> Result<v1::StereoResult, ServiceError> {
    let mut parts = FrameParts::new(frame)?;
    parts.compress(frame.request.options.compression)?;
    parts.join_pixels();
    Ok(parts.into_result(frame))
}

/// The disparity alone, as the bytes of a `Disparity`.
///
/// # Errors
/// [`ServiceError::Internal`] if the PNG encoder or the compression fails.
pub fn disparity_body(
    frame: &MatchedFrame<'_>,
    memory: Option<&dyn Memory>,
) -> Result<Encoded, ServiceError> {
    let mut parts = FrameParts {
        disparity: Some(disparity(frame, &Echo::new(frame), true)?),
        pixels: pixels(frame, true),
        ..FrameParts::default()
    };
    parts.compress(frame.request.options.compression)?;
    let (part, pixels) = (parts.disparity.unwrap_or_default(), parts.pixels);
    let len = part.encoded_len() + pixels.map_or(0, |pixels| pixels.field_len(Field::OfPart));
    encoded(memory, len, |mut body| {
        part.encode(&mut body)?;
        pixels.map_or(Ok(()), |pixels| pixels.put_field(Field::OfPart, body))
    })
    .map_err(unwritten)
}

/// The mesh alone, as the bytes of a `Mesh`.
///
/// # Errors
/// As [`result_body`].
pub fn mesh_body(frame: &MatchedFrame<'_>, memory: Option<&dyn Memory>) -> Result<Encoded, ServiceError> {
    let needs_colors = frame.request.options.outputs.colors;
    let colors = needs_colors
        .then(|| decode::color(Side::Left, &frame.request.left))
        .transpose()?;
    let mut parts = FrameParts {
        mesh: Some(mesh(frame, &Echo::new(frame), colors.as_ref())?),
        ..FrameParts::default()
    };
    parts.compress(frame.request.options.compression)?;
    let part = parts.mesh.unwrap_or_default();
    encoded(memory, part.encoded_len(), |mut body| part.encode(&mut body)).map_err(unwritten)
}

/// The payloads.
#[derive(Default)]
struct FrameParts<'a> {
    disparity: Option<v1::Disparity>,
    /// Data of the disparity that is written behind everything else.
    pixels: Option<Pixels<'a>>,
    depth: Option<v1::Depth>,
    mesh: Option<v1::Mesh>,
    points: Option<v1::PointCloud>,
}

impl<'a> FrameParts<'a> {
    fn new(frame: &MatchedFrame<'a>) -> Result<Self, ServiceError> {
        let outputs = frame.request.options.outputs;
        let needs_colors = outputs.colors && (outputs.mesh || outputs.points);
        let colors = needs_colors
            .then(|| decode::color(Side::Left, &frame.request.left))
            .transpose()?;
        let echo = Echo::new(frame);
        // Refused before matching if there is no calibration.
        let camera = frame.request.calibration.as_ref();
        Ok(Self {
            disparity: (outputs.disparity || outputs.confidence)
                .then(|| disparity(frame, &echo, outputs.disparity))
                .transpose()?,
            pixels: pixels(frame, outputs.disparity),
            depth: camera
                .filter(|_| outputs.depth)
                .map(|camera| depth(frame, &echo, camera)),
            mesh: (outputs.mesh && (frame.mesh.is_some() || !outputs.mesh_is_optional))
                .then(|| mesh(frame, &echo, colors.as_ref()))
                .transpose()?,
            points: camera
                .filter(|_| outputs.points)
                .map(|camera| points(frame, &echo, camera, colors.as_ref())),
        })
    }

    /// Every payload by itself, so that each part can be sent alone.
    fn compress(&mut self, compression: Compression) -> Result<(), ServiceError> {
        let wire = match compression {
            Compression::None => return Ok(()),
            Compression::Zstd => v1::Compression::Zstd,
            Compression::Lz4 => v1::Compression::Lz4,
        };
        let each = |payloads: &mut [&mut Bytes]| {
            payloads
                .iter_mut()
                .try_for_each(|payload| compress(compression, payload))
        };
        self.join_pixels();
        if let Some(part) = &mut self.disparity {
            part.set_compression(wire);
            if part.encoding() != v1::DisparityEncoding::Png16 {
                each(&mut [&mut part.data])?;
            }
            each(&mut [&mut part.confidence])?;
        }
        if let Some(part) = &mut self.depth {
            part.set_compression(wire);
            each(&mut [&mut part.data])?;
        }
        if let Some(part) = &mut self.mesh {
            part.set_compression(wire);
            each(&mut [&mut part.positions, &mut part.indices, &mut part.uvs])?;
            each(&mut [&mut part.disparities, &mut part.colors])?;
        }
        if let Some(part) = &mut self.points {
            part.set_compression(wire);
            each(&mut [&mut part.positions, &mut part.colors])?;
        }
        Ok(())
    }

    /// Puts the data where it belongs.
    fn join_pixels(&mut self) {
        if let (Some(part), Some(pixels)) = (&mut self.disparity, self.pixels.take()) {
            let mut data = Vec::with_capacity(pixels.len());
            pixels.put(&mut data);
            part.data = data.into();
        }
    }

    fn into_result(self, frame: &MatchedFrame<'_>) -> v1::StereoResult {
        let ids = &frame.request.ids;
        v1::StereoResult {
            request_id: ids.request_id.clone(),
            camera_id: ids.camera_id.clone(),
            sequence: ids.sequence,
            capture_time: ids.capture_time.map(Into::into),
            disparity: self.disparity,
            depth: self.depth,
            mesh: self.mesh,
            points: self.points,
            report: None,
        }
    }
}

/// What every part repeats, so that each can be sent alone.
struct Echo {
    timestamp: Option<prost_types::Timestamp>,
    frame_id: String,
    width: u32,
    height: u32,
    calibration: Option<v1::Calibration>,
    valid_window: v1::Region,
}

impl Echo {
    fn new(frame: &MatchedFrame<'_>) -> Self {
        let window = frame
            .request
            .options
            .params
            .roi
            .unwrap_or_else(|| Roi::full(frame.map.shape()));
        Self {
            timestamp: frame.request.ids.capture_time.map(SystemTime::into),
            frame_id: frame.request.left.frame_id.clone(),
            width: u32_from_px(frame.map.shape().width_px()),
            height: u32_from_px(frame.map.shape().height_px()),
            calibration: frame.request.calibration.map(|camera| v1::Calibration {
                focal_px: camera.focal_px,
                cx_px: camera.cx_px,
                cy_px: camera.cy_px,
                baseline_m: camera.baseline_m,
                doffs_px: camera.doffs_px,
            }),
            valid_window: v1::Region {
                x: u32_from_px(window.x),
                y: u32_from_px(window.y),
                width: u32_from_px(window.width),
                height: u32_from_px(window.height),
            },
        }
    }
}

/// The disparities, if they are wanted and in an encoding that is written as it is.
fn pixels<'a>(frame: &MatchedFrame<'a>, has_data: bool) -> Option<Pixels<'a>> {
    let encoding = frame.request.options.disparity_encoding;
    Pixels::new(frame.map.fixed(), encoding).filter(|_| has_data)
}

/// The disparity without what [`pixels`] are.
fn disparity(frame: &MatchedFrame<'_>, echo: &Echo, has_data: bool) -> Result<v1::Disparity, ServiceError> {
    use v1::DisparityEncoding as Wire;
    let request = frame.request;
    let (encoding, step, data) = match request.options.disparity_encoding {
        _ if !has_data => (Wire::Unspecified, 0, Vec::new()),
        DisparityEncoding::F32 => (Wire::F32, 4 * echo.width, Vec::new()),
        DisparityEncoding::U16 => (Wire::U16, 2 * echo.width, Vec::new()),
        DisparityEncoding::Png16 => (Wire::Png16, 0, disparity_png::encode(frame.map)?),
    };
    let range = request.options.params.range;
    Ok(v1::Disparity {
        timestamp: echo.timestamp,
        frame_id: echo.frame_id.clone(),
        width: echo.width,
        height: echo.height,
        encoding: encoding.into(),
        step,
        data: data.into(),
        calibration: echo.calibration,
        min_disparity_px: range.min_px.into(),
        max_disparity_px: u32::from(range.min_px) + u32::from(range.count),
        valid_window: Some(echo.valid_window),
        confidence: match request.options.outputs.confidence {
            true => Bytes::copy_from_slice(frame.map.confidence()),
            false => Bytes::new(),
        },
        compression: v1::Compression::Unspecified.into(),
    })
}

fn depth(frame: &MatchedFrame<'_>, echo: &Echo, camera: &Calibration) -> v1::Depth {
    let depth_m = |fixed: u16| match fixed {
        0 => f32::NAN,
        _ => camera
            .depth_m_from_disparity_px(px_from_fixed(fixed))
            .map_or(f32::NAN, narrow),
    };
    let data: Vec<[u8; 4]> = frame
        .map
        .fixed()
        .iter()
        .map(|&fixed| depth_m(fixed).to_le_bytes())
        .collect();
    v1::Depth {
        timestamp: echo.timestamp,
        frame_id: echo.frame_id.clone(),
        width: echo.width,
        height: echo.height,
        step: 4 * echo.width,
        data: data.into_flattened().into(),
        calibration: echo.calibration,
        valid_window: Some(echo.valid_window),
        compression: v1::Compression::Unspecified.into(),
    }
}

fn mesh(
    frame: &MatchedFrame<'_>,
    echo: &Echo,
    colors: Option<&ColorImage>,
) -> Result<v1::Mesh, ServiceError> {
    let surface = Surface::new(frame)?;
    let pixels = || surface.pixels.iter().zip(&surface.disparities_px);
    let (space, positions) = match frame.request.calibration {
        Some(_) => (v1::MeshSpace::Metres, packed(surface.points.as_flattened())),
        None => {
            let positions: Vec<[f32; 3]> = pixels().map(|(&[u, v], &disparity)| [u, v, disparity]).collect();
            (v1::MeshSpace::Pixels, packed(positions.as_flattened()))
        }
    };
    Ok(v1::Mesh {
        timestamp: echo.timestamp,
        frame_id: echo.frame_id.clone(),
        space: space.into(),
        positions,
        indices: surface
            .triangles
            .as_flattened()
            .iter()
            .flat_map(|index| index.to_le_bytes())
            .collect(),
        uvs: packed(surface.uvs(frame.map.shape()).as_flattened()),
        disparities: packed(&surface.disparities_px),
        colors: colors.map_or_else(Bytes::new, |image| {
            surface
                .pixels
                .iter()
                .flat_map(|&[u, v]| image.nearest(u, v))
                .collect()
        }),
        compression: v1::Compression::Unspecified.into(),
    })
}

fn points(
    frame: &MatchedFrame<'_>,
    echo: &Echo,
    camera: &Calibration,
    colors: Option<&ColorImage>,
) -> v1::PointCloud {
    let width_px = frame.map.shape().width_px();
    let rows = frame.map.fixed().chunks_exact(width_px).enumerate();
    let (mut positions, mut point_colors) = (Vec::<[f32; 3]>::new(), Vec::<[u8; 3]>::new());
    for (y, row) in rows {
        for (x, &fixed) in row.iter().enumerate().filter(|&(_, &fixed)| fixed > 0) {
            let (u, v) = (f32_from_px(x), f32_from_px(y));
            let point = camera
                .point_m_from_pixel(u, v, px_from_fixed(fixed))
                .map(|point| point.map(narrow));
            if let Some(point) = point.filter(|point| point.iter().all(|axis| axis.is_finite())) {
                positions.push(point);
                point_colors.extend(colors.map(|image| image.nearest(u, v)));
            }
        }
    }
    v1::PointCloud {
        timestamp: echo.timestamp,
        frame_id: echo.frame_id.clone(),
        positions: packed(positions.as_flattened()),
        colors: point_colors.into_flattened().into(),
        compression: v1::Compression::Unspecified.into(),
    }
}

/// Floats as the wire has them.
fn packed(numbers: &[f32]) -> Bytes {
    numbers
        .iter()
        .map(|number| number.to_le_bytes())
        .collect::<Vec<_>>()
        .into_flattened()
        .into()
}

pub(super) fn px_from_fixed(fixed: u16) -> f32 {
    f32::from(fixed) / f32::from(FIXED_PER_PX)
}

/// Sides are at most 4096 px.
fn u32_from_px(px: usize) -> u32 {
    u32::try_from(px).unwrap_or(u32::MAX)
}

/// Sides are at most 4096 px.
fn f32_from_px(px: usize) -> f32 {
    f32::from(u16::try_from(px).unwrap_or(u16::MAX))
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "rounding to the nearest f32 is what is wanted"
)]
fn narrow(number: f64) -> f32 {
    number as f32
}

#[cfg(test)]
mod tests;
