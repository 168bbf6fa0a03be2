//! The mesh as a PLY file with the left image's colours.

use super::surface::Surface;
use crate::decode::{self, Side};
use crate::job::MatchedFrame;
use crate::status::ServiceError;

/// The frame's mesh as a PLY file.
pub(super) fn encode(frame: &MatchedFrame<'_>) -> Result<Vec<u8>, ServiceError> {
    let surface = Surface::new(frame)?;
    let left = decode::color(Side::Left, &frame.request.left)?;
    let colors: Vec<[u8; 3]> = surface.pixels.iter().map(|&[u, v]| left.nearest(u, v)).collect();
    Ok(surface.as_file(frame).ply(Some(&colors)))
}

#[cfg(test)]
mod tests;
