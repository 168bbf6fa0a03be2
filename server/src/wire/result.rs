//! A finished frame as the wire's `StereoResult`.

use std::time::SystemTime;

use bytes::Bytes;
use prost::Message;
use stereo::{FIXED_PER_PX, Roi};
use stereo_proto::v1;

use super::compress::compress;
use super::report;
use crate::decode::{self, ColorImage, Side};
use crate::encode::disparity_png::{self, kitti_from_fixed};
use crate::encode::surface::Surface;
use crate::job::{Calibration, Compression, DisparityEncoding, MatchedFrame, Report};
use crate::status::ServiceError;

/// The parts of `frame` that were wanted, as the bytes of a `StereoResult`. `finish` is called for the report when
/// everything else is encoded, so that it can say how long that took.
///
/// # Errors
/// [`ServiceError::Internal`] if the mesh was wanted but not made or the PNG encoder fails; if colours were wanted, what
/// [`decode::color`] refuses.
pub fn result_body(frame: &MatchedFrame<'_>, finish: &dyn Fn() -> Report) -> Result<Vec<u8>, ServiceError> {
    let result = without_report(frame)?;
    // Room for everything at once: the report is small beside the maps.
    let mut body = Vec::with_capacity(result.encoded_len() + 512);
    let written = |why| ServiceError::Internal(format!("writing a result: {why}"));
    result.encode(&mut body).map_err(written)?;
    // The report is the last field, and messages that follow each other are one: it can be written when everything else is.
    let rest = v1::StereoResult {
        report: Some(report::to_proto(&finish())),
        ..v1::StereoResult::default()
    };
    rest.encode(&mut body).map_err(written)?;
    Ok(body)
}

/// The parts of `frame` that were wanted, but for the report.
///
/// # Errors
/// As [`result_body`].
pub(super) fn without_report(frame: &MatchedFrame<'_>) -> Result<v1::StereoResult, ServiceError> {
    let mut parts = FrameParts::new(frame)?;
    parts.compress(frame.request.options.compression)?;
    let FrameParts {
        disparity,
        depth,
        mesh,
        points,
    } = parts;
    let ids = &frame.request.ids;
    Ok(v1::StereoResult {
        request_id: ids.request_id.clone(),
        camera_id: ids.camera_id.clone(),
        sequence: ids.sequence,
        capture_time: ids.capture_time.map(Into::into),
        disparity,
        depth,
        mesh,
        points,
        report: None,
    })
}

/// The disparity alone, as the bytes of a `Disparity`.
///
/// # Errors
/// [`ServiceError::Internal`] if the PNG encoder or the compression fails.
pub fn disparity_body(frame: &MatchedFrame<'_>) -> Result<Vec<u8>, ServiceError> {
    let mut parts = FrameParts {
        disparity: Some(disparity(frame, &Echo::new(frame), true)?),
        ..FrameParts::default()
    };
    parts.compress(frame.request.options.compression)?;
    Ok(parts.disparity.unwrap_or_default().encode_to_vec())
}

/// The mesh alone, as the bytes of a `Mesh`.
///
/// # Errors
/// As [`result_body`].
pub fn mesh_body(frame: &MatchedFrame<'_>) -> Result<Vec<u8>, ServiceError> {
    let needs_colors = frame.request.options.outputs.colors;
    let colors = needs_colors
        .then(|| decode::color(Side::Left, &frame.request.left))
        .transpose()?;
    let mut parts = FrameParts {
        mesh: Some(mesh(frame, &Echo::new(frame), colors.as_ref())?),
        ..FrameParts::default()
    };
    parts.compress(frame.request.options.compression)?;
    Ok(parts.mesh.unwrap_or_default().encode_to_vec())
}

/// The payloads.
#[derive(Default)]
struct FrameParts {
    disparity: Option<v1::Disparity>,
    depth: Option<v1::Depth>,
    mesh: Option<v1::Mesh>,
    points: Option<v1::PointCloud>,
}

impl FrameParts {
    fn new(frame: &MatchedFrame<'_>) -> Result<Self, ServiceError> {
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
}

impl FrameParts {
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

fn disparity(frame: &MatchedFrame<'_>, echo: &Echo, has_data: bool) -> Result<v1::Disparity, ServiceError> {
    use v1::DisparityEncoding as Wire;
    let request = frame.request;
    let fixed = frame.map.fixed();
    let (encoding, step, data) = match request.options.disparity_encoding {
        _ if !has_data => (Wire::Unspecified, 0, Vec::new()),
        DisparityEncoding::F32 => {
            let px = frame.map.iter_px().map(f32::to_le_bytes);
            (Wire::F32, 4 * echo.width, px.collect::<Vec<_>>().into_flattened())
        }
        DisparityEncoding::U16 => {
            let values = fixed.iter().map(|&fixed| kitti_from_fixed(fixed).to_le_bytes());
            (
                Wire::U16,
                2 * echo.width,
                values.collect::<Vec<_>>().into_flattened(),
            )
        }
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

fn px_from_fixed(fixed: u16) -> f32 {
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
