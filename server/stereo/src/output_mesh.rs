//! The mesh that is sent: the triangles that hold, with the vertices they use.

use crate::frame::Window;
use crate::interpolate::{Plane, scan_lines};
use crate::mesh::{Mesh, MeshParams, Vertex};
use crate::triangulation::{Triangle, Triangulation};

/// Disparity change per pixel from which a surface is seen so nearly edge-on that it is a jump between two surfaces.
const MAX_GRADIENT: f32 = 1.0;
/// Mask pixels from which a triangle's validation says something.
const ENOUGH_PIXELS: usize = 4;
/// Marks a vertex that is not in the output yet.
const UNUSED: u32 = u32::MAX;

/// What is known of the window's pixels.
#[derive(Debug)]
pub(crate) struct Validated<'a> {
    pub(crate) window: Window,
    pub(crate) mask: &'a [u8],
    pub(crate) interpolated: &'a [u16],
    pub(crate) disparity: &'a [u16],
    pub(crate) cost: &'a [u8],
    pub(crate) valid_up_to: u8,
}

/// Writes the triangles that `params` keeps.
pub(crate) fn write(
    triangulation: &Triangulation,
    pixels: &Validated<'_>,
    params: &MeshParams,
    out: &mut Mesh,
) {
    let mut numbers = vec![UNUSED; triangulation.vertices()];
    #[expect(
        clippy::cast_precision_loss,
        reason = "image positions and disparities are exact in f32"
    )]
    let [left, top, nearest] = [
        pixels.window.roi.x,
        pixels.window.roi.y,
        pixels.window.min_disparity_px,
    ]
    .map(|at| at as f32);
    for triangle in triangulation.triangles_from(0) {
        if !(params.keep_rejected || holds(&triangle, pixels, params)) {
            continue;
        }
        let mut corner = |k: usize| {
            let number = &mut numbers[triangle.indices[k]];
            if *number == UNUSED {
                *number = u32::try_from(out.vertices.len()).unwrap_or(UNUSED);
                let Vertex { u, v, disparity } = triangle.vertices[k];
                out.vertices.push(Vertex {
                    u: u + left,
                    v: v + top,
                    disparity: disparity + nearest,
                });
            }
            *number
        };
        // spade's faces turn counter-clockwise in its own frame; with v down that is the other way round for the viewer.
        out.triangles.push([corner(0), corner(2), corner(1)]);
    }
}

/// Whether the triangle is a surface: not steeper than one can see, and confirmed by its own pixels where it has texture.
fn holds(triangle: &Triangle, pixels: &Validated<'_>, params: &MeshParams) -> bool {
    let Some(plane) = Plane::through(&triangle.vertices) else {
        return false;
    };
    if plane.gradient() > MAX_GRADIENT {
        return false;
    }
    let (mut textured, mut confirmed) = (0usize, 0usize);
    scan_lines(&triangle.vertices, |y, from, to| {
        let row = y * pixels.window.roi.width;
        for at in row + from..=row + to {
            let on_plane = pixels.disparity[at].abs_diff(pixels.interpolated[at]) <= crate::FIXED_PER_PX;
            let valid = pixels.cost[at] <= pixels.valid_up_to && on_plane;
            textured += usize::from(pixels.mask[at]);
            confirmed += usize::from(pixels.mask[at] != 0 && valid);
        }
    });
    if textured >= ENOUGH_PIXELS {
        return confirmed as f32 >= params.min_valid_share * textured as f32;
    }
    let disparities = triangle.vertices.map(|vertex| vertex.disparity);
    let step = disparities.iter().copied().fold(f32::MIN, f32::max)
        - disparities.iter().copied().fold(f32::MAX, f32::min);
    !triangle.has_corner() && step <= params.max_disparity_step_px
}

#[cfg(test)]
mod tests;
