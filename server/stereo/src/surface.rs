//! The mesh of a dense map: vertices where planes stop fitting (after Garland and Heckbert 1995).
//!
//! ```text
//! mesh = Delaunay over the frame's supports, each at the map's disparity
//! for cells of 16 and then 8 px:
//!     in every cell, insert the pixel that is furthest from the mesh, if that is more than the tolerance
//! ```

use crate::disparity::FIXED_PER_PX;
use crate::interpolate;
use crate::simd::Level;
use crate::support::Support;
use crate::triangulation::Triangulation;

/// Sides of the cells, px.
const CELLS_PX: [usize; 2] = [16, 8];
/// Distance in 1/64 px up to which a plane fits: a pixel of disparity.
const TOLERANCE: u16 = FIXED_PER_PX;

/// A mesh and what it looks like rasterised.
#[derive(Debug, Default)]
pub(crate) struct Surface {
    pub(crate) triangulation: Triangulation,
    /// The mesh's planes in 1/64 px.
    pub(crate) interpolated: Vec<u16>,
}

impl Surface {
    /// Fits the mesh to `map` (rows of `width`), starting from the positions of `seeds`.
    pub(crate) fn fit(&mut self, level: Level, map: &[u16], width: usize, seeds: &[Support], max_fixed: u16) {
        let height = map.len() / width;
        let on_map = |x: usize, y: usize| {
            let disparity_px = f32::from(map[y * width + x]) / f32::from(FIXED_PER_PX);
            Support { x, y, disparity_px }
        };
        let mut supports: Vec<Support> = seeds.iter().map(|seed| on_map(seed.x, seed.y)).collect();
        self.triangulation.rebuild(&supports, width, height);
        // The corners are there already, at a guess: now at the map's own.
        let corners = [(0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)];
        self.triangulation.insert(&corners.map(|(x, y)| on_map(x, y)));
        self.interpolated.resize(map.len(), 0);
        let mut first_new = 0;
        for cell_px in CELLS_PX {
            self.rasterise(level, width, first_new, max_fixed);
            first_new = self.triangulation.vertices();
            supports.clear();
            for top in (0..height).step_by(cell_px) {
                for left in (0..width).step_by(cell_px) {
                    let right = (left + cell_px).min(width);
                    let (mut worst, mut at) = (TOLERANCE, None);
                    for y in top..(top + cell_px).min(height) {
                        let row = y * width;
                        let columns = map[row + left..row + right]
                            .iter()
                            .zip(&self.interpolated[row + left..row + right]);
                        for (x, (there, here)) in (left..).zip(columns) {
                            let distance = there.abs_diff(*here);
                            if distance > worst {
                                (worst, at) = (distance, Some((x, y)));
                            }
                        }
                    }
                    supports.extend(at.map(|(x, y)| on_map(x, y)));
                }
            }
            self.triangulation.insert(&supports);
        }
        self.rasterise(level, width, first_new, max_fixed);
    }

    /// Brings `interpolated` up to date with the triangles that have a vertex from `first_new` on.
    fn rasterise(&mut self, level: Level, width: usize, first_new: usize, max_fixed: u16) {
        let changed = self.triangulation.triangles_from(first_new);
        let changed = changed.map(|triangle| triangle.vertices);
        interpolate::fill(level, &mut self.interpolated, width, changed, max_fixed);
    }
}
