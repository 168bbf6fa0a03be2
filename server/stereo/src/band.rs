//! Semi-global matching (Hirschmueller 2005) within a band of disparities around a prior.
//!
//! ```text
//! C(p, d)  = 3x3 sum of hamming(left(q), right(q - d)),                     d = first(p) .. first(p) + 15
//! L_r(p, d) = C(p, d) + min(L_r(p - r, d), L_r(p - r, d +- 1) + P1, min L_r(p - r) + P2) - min L_r(p - r)
//! S(p, d)  = sum of L_r over the four paths r: from the left, right, top, bottom
//! D(p)     = argmin S(p, .)
//! ```
//! Sixteen labels a pixel are one 128-bit lane, so a step of a path is a handful of vector operations for several pixels
//! at once: rows side by side for horizontal paths, columns for vertical ones. Neighbours' bands start at different
//! disparities; their labels are shifted into the pixel's own band, and those that fall outside count as unknown.
//!
//! Costs and paths are kept upside down (255 - L, larger is better), so that a shift's zeros mean "worst".

use std::ops::Range;

use costs::Costs;
use paths::{Across, Along};

use crate::census::Census;
use crate::plane::Plane;
use crate::simd::{LABELS, Level, MOST_PIXELS};

mod costs;
mod paths;

/// Rows whose horizontal paths are followed side by side.
pub(crate) const GROUP: usize = MOST_PIXELS;
/// Pixels whose results are read together: as many as the widest vector has bytes.
const BLOCK_PX: usize = MOST_PIXELS * LABELS;
/// Hamming distance of two unrelated words of 8 bits: what unknown labels cost.
const UNKNOWN: u8 = 4;
/// Nine distances, each less `UNKNOWN`, are at least this much below zero.
const LOWEST_SUM: u8 = 9 * UNKNOWN;
/// Turns a cost upside down.
const INVERT: u8 = 255;

/// Smoothness penalties, in units of the halved 3x3 sum of Hamming distances (0..=36).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Penalties {
    /// P1: for a step of one label.
    pub(crate) small: u8,
    /// P2 where the image is flat; it falls by one for every gray level the image steps.
    pub(crate) large: u8,
    /// P2 at least.
    pub(crate) least: u8,
}

/// The inputs of one pyramid level.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Views<'a> {
    pub(crate) image: &'a Plane,
    pub(crate) left: &'a Census,
    pub(crate) right: &'a Census,
    pub(crate) penalties: Penalties,
}

/// Shape of a pyramid level, and where its bands are.
#[derive(Debug, Default)]
pub(crate) struct Grid {
    width: usize,
    height: usize,
    /// Pixels from one row to the next.
    pitch: usize,
    /// Disparity of each pixel's label 0.
    first: Vec<u8>,
}

/// Costs and path sums of half of a level's rows.
#[derive(Debug, Default)]
pub(crate) struct Half {
    rows: Range<usize>,
    /// C, upside down.
    cost: Vec<u8>,
    /// S, saturated: only what can't win saturates. Saturated sums don't depend on the order of their terms.
    sum: Vec<u8>,
}

/// Vertical paths on their way through one half and then the other.
#[derive(Debug, Default)]
pub(crate) struct Sweep {
    /// Whether they come from the bottom.
    upwards: bool,
    scratch: Scratch,
}

/// Bands, costs and path sums of one pyramid level.
///
/// Paths from the top and from the bottom start in a half each, meet in the middle, and go on in the other's half: so two
/// threads work on one level without a row in common.
#[derive(Debug, Default)]
pub(crate) struct Band {
    pub(crate) grid: Grid,
    /// The upper and the lower one.
    pub(crate) halves: [Half; 2],
    /// Downwards and upwards.
    pub(crate) sweeps: [Sweep; 2],
}

#[derive(Debug, Default)]
struct Scratch {
    /// Distances of one row, a pixel of unknowns before and after.
    row: Vec<u8>,
    /// Horizontal sums of three rows.
    ring: Vec<u8>,
    /// Path costs of the row before, and their best.
    path: Vec<u8>,
    best: Vec<u8>,
    /// Sums of a group of rows side by side, as far as the first of two paths has got.
    sums: Vec<u8>,
    /// Shifts and P2 of the pixels of each row of a group.
    shifts: Vec<u8>,
    penalties: Vec<u8>,
    /// The same of a group of rows side by side.
    group_shifts: Vec<[u8; GROUP]>,
    group_penalties: Vec<[u8; GROUP]>,
}

impl Band {
    /// Room for a level of `width` x `height`, two [`GROUP`]s of rows at least.
    pub(crate) fn reshape(&mut self, width: usize, height: usize) {
        let pitch = width.next_multiple_of(MOST_PIXELS);
        // Whole blocks can be read wherever a row begins.
        let pixels = |rows: usize| pitch * rows + BLOCK_PX;
        self.grid.first.resize(pixels(height), 0);
        (self.grid.width, self.grid.height, self.grid.pitch) = (width, height, pitch);
        let halves = [0..height / 2, height / 2..height];
        for (half, rows) in self.halves.iter_mut().zip(halves) {
            half.cost.resize(pixels(rows.len()) * LABELS, 0);
            half.sum.resize(pixels(rows.len()) * LABELS, 0);
            half.rows = rows;
        }
        for (sweep, upwards) in self.sweeps.iter_mut().zip([false, true]) {
            sweep.upwards = upwards;
            sweep.scratch.reshape(width, pitch);
        }
    }
}

impl Scratch {
    fn reshape(&mut self, width: usize, pitch: usize) {
        // The pixel after a row is never written: of a longer row it would hold distances.
        self.row.clear();
        self.row.resize((pitch + 2) * LABELS, 0);
        self.ring.resize(3 * pitch * LABELS, 0);
        for row in [&mut self.path, &mut self.best] {
            row.resize(pitch * LABELS, 0);
        }
        self.sums.resize(width * MOST_PIXELS * LABELS, 0);
        for row in [&mut self.shifts, &mut self.penalties] {
            row.resize(GROUP * (pitch + 1), 0);
        }
        for group in [&mut self.group_shifts, &mut self.group_penalties] {
            group.resize(width + 1, [0; GROUP]);
        }
    }
}

impl Grid {
    /// Pixels from one row to the next.
    pub(crate) fn pitch(&self) -> usize {
        self.pitch
    }

    /// All rows of the bands' starts, to be set before anything else.
    pub(crate) fn first_mut(&mut self) -> &mut [u8] {
        &mut self.first[..self.pitch * self.height]
    }

    fn first_row(&self, y: usize) -> &[u8] {
        &self.first[y * self.pitch..][..self.pitch]
    }
}

impl Half {
    /// How many rows it has.
    pub(crate) fn len(&self) -> usize {
        self.rows.len()
    }

    /// First row of the half.
    pub(crate) fn top(&self) -> usize {
        self.rows.start
    }

    /// Starts of row `y` and its path sums, as whole blocks: what comes after the row's pixels means nothing.
    pub(crate) fn result_row<'a>(&'a self, grid: &'a Grid, y: usize) -> (&'a [u8], &'a [[u8; LABELS]]) {
        let pixels = |y: usize| y * grid.pitch..y * grid.pitch + grid.width.next_multiple_of(BLOCK_PX);
        (
            &grid.first[pixels(y)],
            &self.sum.as_chunks::<LABELS>().0[pixels(y - self.rows.start)],
        )
    }
}

impl Sweep {
    /// Rows `done` of `half` in the order in which the paths meet them.
    pub(crate) fn rows(&self, half: &Half, done: Range<usize>) -> Range<usize> {
        if self.upwards {
            half.rows.end - done.end..half.rows.end - done.start
        } else {
            half.rows.start + done.start..half.rows.start + done.end
        }
    }

    /// Matching costs of rows `rows`, then paths from the left and from the right, which start the sums, then the vertical
    /// paths. [`GROUP`] rows at least.
    pub(crate) fn begin(
        &mut self,
        level: Level,
        (grid, views): (&Grid, &Views<'_>),
        half: &mut Half,
        rows: Range<usize>,
    ) {
        level.run(Costs {
            grid,
            half,
            scratch: &mut self.scratch,
            views,
            rows: rows.clone(),
        });
        level.run(Across {
            grid,
            half,
            scratch: &mut self.scratch,
            views,
            rows: rows.clone(),
        });
        self.along(level, (grid, views), half, rows);
    }

    /// The vertical paths in rows `rows`, to be called for consecutive rows in their direction.
    pub(crate) fn along(
        &mut self,
        level: Level,
        (grid, views): (&Grid, &Views<'_>),
        half: &mut Half,
        rows: Range<usize>,
    ) {
        level.run(Along {
            grid,
            half,
            sweep: self,
            views,
            rows,
        });
    }
}

/// `to[x] = a[x] - b[x]`, wrapping.
#[inline(always)]
fn subtract(a: &[u8], b: &[u8], to: &mut [u8]) {
    for ((to, a), b) in to.iter_mut().zip(a).zip(b) {
        *to = a.wrapping_sub(*b);
    }
}
