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

use std::ops::Range;

use crate::census::Census;
use crate::cost::{Best, COST_OF_ALL_BITS};
use crate::disparity::FIXED_PER_PX;
use crate::plane::Plane;
use crate::simd::{Kernel, Lanes, Level};
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
    pub(crate) level: Level,
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
    pub(crate) fn refine(&self, rows: Range<usize>, best: &mut Best<'_>, occupancy: &mut Occupancy) {
        self.level.run(Refine {
            iteration: self,
            rows,
            best,
            occupancy,
        });
    }
}

struct Refine<'a, 'b> {
    iteration: &'a Iteration<'a>,
    rows: Range<usize>,
    best: &'a mut Best<'b>,
    occupancy: &'a mut Occupancy,
}

impl Kernel for Refine<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self {
            iteration,
            rows,
            best,
            occupancy,
        } = self;
        let width = iteration.width;
        let height = iteration.mask.len() / width;
        let best = best
            .disparity
            .chunks_exact_mut(width)
            .zip(best.cost.chunks_exact_mut(width));
        for (y, (best_disparity, best_cost)) in rows.zip(best) {
            let pixels = y * width..(y + 1) * width;
            let (mask, disparity) = (&iteration.mask[pixels.clone()], &iteration.interpolated[pixels]);
            let row = Row::of(iteration, y);
            let is_row_inside = (BORDER_PX..height - BORDER_PX).contains(&y);
            for x in (0..width).filter(|&x| mask[x] > 0) {
                let cost = row.cost(x, disparity[x]);
                if cost < best_cost[x] {
                    (best_disparity[x], best_cost[x]) = (disparity[x], cost);
                }
                if !(is_row_inside && (BORDER_PX..width - BORDER_PX).contains(&x)) {
                    continue;
                }
                let cell =
                    &mut occupancy.cells[y / occupancy.side_px * occupancy.columns + x / occupancy.side_px];
                if cost < iteration.confident_below && cell.confident.is_none_or(|(least, _)| cost < least) {
                    let disparity_px = f32::from(disparity[x]) / f32::from(FIXED_PER_PX);
                    cell.confident = Some((cost, Support { x, y, disparity_px }));
                }
                if cost > iteration.invalid_above && cell.invalid.is_none_or(|(most, _)| cost > most) {
                    cell.invalid = Some((cost, Candidate { x, y }));
                }
            }
        }
    }
}

/// Side of the window that is compared.
const SIDE: usize = 5;
/// Pixels taken of a row of the window at once, of which the first [`SIDE`] count.
const TAKEN: usize = 8;

/// What the costs of a row need.
struct Row<'a> {
    /// The left words, a plane for each of their bytes.
    left: [&'a [u8]; 3],
    /// The right image, from the first row of the window on.
    right: [&'a [u8]; SIDE],
    /// Where column 0 is in them.
    margin: usize,
}

impl<'a> Row<'a> {
    #[inline(always)]
    fn of(iteration: &Iteration<'a>, y: usize) -> Self {
        let planes = iteration.left.planes();
        let from = iteration.left.index(0);
        let image = iteration.right_image;
        Self {
            left: [0, 1, 2].map(|plane| &planes[plane].row(y, 0)[from..]),
            right: [-2, -1, 0, 1, 2].map(|dy| image.row(y, dy)),
            margin: image.margin_left(),
        }
    }

    /// Share of differing bits, of 250, between the left word and the word of the right image sampled at `x - disparity`.
    #[inline(always)]
    fn cost(&self, x: usize, disparity: u16) -> u8 {
        // The right position is `whole + weight / 64`, with the whole column rounded down.
        let whole = disparity.div_ceil(FIXED_PER_PX);
        let weight = whole * FIXED_PER_PX - disparity;
        let from = self.margin + x - usize::from(whole) - SIDE / 2;
        // Samples between two pixels each, a row of them at once.
        let sample = |row: &[u8]| {
            let pixels = row[from..].first_chunk::<{ TAKEN + 1 }>();
            let mut samples = [0; TAKEN];
            if let Some(pixels) = pixels {
                for (k, sample) in samples.iter_mut().enumerate() {
                    let [near, far] = [u16::from(pixels[k]), u16::from(pixels[k + 1])];
                    *sample = near * (FIXED_PER_PX - weight) + far * weight;
                }
            }
            samples
        };
        let mut samples = [[0u16; TAKEN]; SIDE];
        for (samples, row) in samples.iter_mut().zip(self.right) {
            *samples = sample(row);
        }
        let centre = samples[SIDE / 2][SIDE / 2];
        // Every sample has a bit of its own, those of the first three rows in one number and the others in another.
        let (mut first, mut last) = ([0u16; TAKEN], [0u16; TAKEN]);
        for (k, row) in samples.iter().enumerate() {
            let (bits, places) = if k < 3 {
                (&mut first, k)
            } else {
                (&mut last, k - 3)
            };
            for (column, (bits, sample)) in bits.iter_mut().zip(row).enumerate() {
                let place = if column < SIDE {
                    1 << (SIDE * (3 - places) - 1 - column)
                } else {
                    0
                };
                *bits |= u16::from(*sample > centre).wrapping_neg() & place;
            }
        }
        let any = |bits: [u16; TAKEN]| u32::from(bits.iter().fold(0, |all, bits| all | bits));
        // 15 bits with the centre in the middle row's middle, always 0, and 10.
        let (first, last) = (any(first), any(last) >> SIDE);
        let word = (first >> 3) << 12 | (first & 3) << 10 | last;
        let mut left = 0;
        for plane in self.left {
            left = left << 8 | u32::from(plane[x].reverse_bits());
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
