//! One iteration of the paper to the letter: CostEvaluation and DisparityRefinement (sections III-C and III-D), and the
//! pixels that SupportResampling takes from them.
//!
//! ```text
//! for (u, v) in the mask:
//!     C_it = census 5x5 of left at (u, v) against census 5x5 of right at (u - D_it, v), sub-pixel
//!     if C_it < C_f:                    D_f, C_f = D_it, C_it
//!     if C_it < t_lo and < cell's C_g:  the cell's confident pixel = (u, v, D_it, C_it)
//!     if C_it > t_hi and > cell's C_b:  the cell's invalid pixel   = (u, v, C_it)
//! ```

use crate::census::Census;
use crate::cost::{Best, COST_OF_ALL_BITS};
use crate::disparity::FIXED_PER_PX;
use crate::plane::Plane;
use crate::support::{BORDER_PX, Candidate, Support};

/// One cell of the occupancy grid.
#[derive(Debug, Clone, Copy)]
struct Cell {
    /// C_g: the cheapest confident pixel so far.
    confident: Option<(u8, Support)>,
    /// C_b: the dearest invalid pixel so far.
    invalid: Option<(u8, Candidate)>,
}

/// The occupancy grid of one iteration.
#[derive(Debug, Default)]
pub(crate) struct Occupancy {
    cells: Vec<Cell>,
    columns: usize,
    side_px: usize,
}

impl Occupancy {
    /// An empty grid of cells of `side_px`.
    pub(crate) fn reset(&mut self, side_px: usize, width: usize, height: usize) {
        self.side_px = side_px;
        self.columns = width.div_ceil(side_px);
        self.cells.clear();
        self.cells.resize(
            self.columns * height.div_ceil(side_px),
            Cell {
                confident: None,
                invalid: None,
            },
        );
    }

    /// The confident pixels, with the disparity they were confirmed at.
    pub(crate) fn confident(&self) -> impl Iterator<Item = Support> + '_ {
        self.cells
            .iter()
            .filter_map(|cell| cell.confident.map(|(_, support)| support))
    }

    /// The invalid pixels, to be searched for.
    pub(crate) fn invalid(&self) -> impl Iterator<Item = Candidate> + '_ {
        self.cells
            .iter()
            .filter_map(|cell| cell.invalid.map(|(_, candidate)| candidate))
    }
}

/// What an iteration evaluates.
#[derive(Debug)]
pub(crate) struct Iteration<'a> {
    pub(crate) left: &'a Census,
    pub(crate) right_image: &'a Plane,
    pub(crate) mask: &'a [u8],
    /// D_it, in 1/64 px.
    pub(crate) interpolated: &'a [u16],
    pub(crate) width: usize,
    /// t_lo and t_hi, of 250.
    pub(crate) confident_below: u8,
    pub(crate) invalid_above: u8,
}

impl Iteration<'_> {
    /// Rows `rows`: updates the best so far and the occupancy grid.
    pub(crate) fn refine(
        &self,
        rows: std::ops::Range<usize>,
        best: &mut Best<'_>,
        occupancy: &mut Occupancy,
    ) {
        let height = self.mask.len() / self.width;
        for (y, row) in rows.zip(
            best.disparity
                .chunks_exact_mut(self.width)
                .zip(best.cost.chunks_exact_mut(self.width)),
        ) {
            let (best_disparity, best_cost) = row;
            for x in 0..self.width {
                let at = y * self.width + x;
                if self.mask[at] == 0 {
                    continue;
                }
                let disparity = self.interpolated[at];
                let cost = self.cost(x, y, disparity);
                if cost < best_cost[x] {
                    (best_disparity[x], best_cost[x]) = (disparity, cost);
                }
                let inside = |at: usize, n: usize| (BORDER_PX..n - BORDER_PX).contains(&at);
                if !(inside(x, self.width) && inside(y, height)) {
                    continue;
                }
                let cell =
                    &mut occupancy.cells[y / occupancy.side_px * occupancy.columns + x / occupancy.side_px];
                if cost < self.confident_below && cell.confident.is_none_or(|(least, _)| cost < least) {
                    let disparity_px = f32::from(disparity) / f32::from(FIXED_PER_PX);
                    cell.confident = Some((cost, Support { x, y, disparity_px }));
                }
                if cost > self.invalid_above && cell.invalid.is_none_or(|(most, _)| cost > most) {
                    cell.invalid = Some((cost, Candidate { x, y }));
                }
            }
        }
    }

    /// Share of differing bits, of 250, between the left word and the word of the right image sampled at `x - disparity`.
    fn cost(&self, x: usize, y: usize, disparity: u16) -> u8 {
        // The right position is `whole + weight / 64`, with the whole column rounded down.
        let whole = usize::from(disparity.div_ceil(FIXED_PER_PX));
        let weight = u16::try_from(whole).unwrap_or(u16::MAX) * FIXED_PER_PX - disparity;
        let from = self.right_image.margin_left() + x - whole - 2;
        let mut patch = [[0u16; 5]; 5];
        for (row, dy) in patch.iter_mut().zip(-2..=2) {
            let pixels = &self.right_image.row(y, dy)[from..from + 6];
            for (k, sample) in row.iter_mut().enumerate() {
                *sample = u16::from(pixels[k]) * (FIXED_PER_PX - weight) + u16::from(pixels[k + 1]) * weight;
            }
        }
        let centre = patch[2][2];
        // The order of the pattern: row by row without the centre.
        let others = patch.iter().flatten().enumerate().filter(|&(k, _)| k != 12);
        let word = others.fold(0u32, |word, (_, &sample)| word << 1 | u32::from(sample > centre));
        let mut left = 0u32;
        for plane in self.left.planes() {
            left = left << 8 | u32::from(plane.row(y, 0)[self.left.index(x)].reverse_bits());
        }
        #[expect(
            clippy::cast_possible_truncation,
            reason = "at most 24 of 24 bits, scaled to 250"
        )]
        let cost = ((word ^ left).count_ones() * u32::from(COST_OF_ALL_BITS) / 24) as u8;
        cost
    }
}

#[cfg(test)]
mod tests;
