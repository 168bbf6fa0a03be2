//! The mesh as a binary little-endian PLY file with the left image's colours; where points are is `surface`'s matter
//! and stands in the file's comments.

use super::surface::Surface;
use crate::decode::{self, Side};
use crate::job::MatchedFrame;
use crate::status::ServiceError;

const VERTEX_BYTES: usize = 3 * 4 + 3;
const FACE_BYTES: usize = 1 + 3 * 4;

/// The frame's mesh as a PLY file.
pub(super) fn encode(frame: &MatchedFrame<'_>) -> Result<Vec<u8>, ServiceError> {
    let surface = Surface::new(frame)?;
    let colours = decode::color(Side::Left, &frame.request.left)?;
    let (vertices, faces) = (surface.points.len(), surface.triangles.len());
    let space = if frame.request.calibration.is_some() {
        "metres in the left camera's frame: x right, y down, z forward"
    } else {
        "not calibrated: x = column and y = row in px, z = -disparity in px"
    };
    let header = format!(
        "ply\nformat binary_little_endian 1.0\ncomment stereod {version}\ncomment {space}\n\
         element vertex {vertices}\n\
         property float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\n\
         element face {faces}\nproperty list uchar int vertex_indices\nend_header\n",
        version = env!("CARGO_PKG_VERSION"),
    );
    let mut file = Vec::with_capacity(header.len() + vertices * VERTEX_BYTES + faces * FACE_BYTES);
    file.extend_from_slice(header.as_bytes());
    for (point, &[u, v]) in surface.points.iter().zip(&surface.pixels) {
        file.extend_from_slice(point.map(f32::to_le_bytes).as_flattened());
        file.extend_from_slice(&colours.nearest(u, v));
    }
    for triangle in &surface.triangles {
        file.push(3);
        file.extend_from_slice(triangle.map(u32::to_le_bytes).as_flattened());
    }
    Ok(file)
}

#[cfg(test)]
mod tests;
