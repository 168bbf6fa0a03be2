//! Cost evaluation: how well the interpolated disparity explains the images (paper, section III-C).
//!
//! ```text
//! for every pixel, for d in { d_it - 1, d_it, d_it + 1 }:
//!     C(d) = sum over a small window of hamming(left(q), right(q - d_it(q) + d_it - d))
//! keep the best; if it beats C_f, it becomes D_f and its cost C_f
//! ```
//! Each pixel of the window is compared at *its own* interpolated disparity: the window follows the plane, so slanted
//! surfaces cost nothing, and the neighbours' words can be summed by running sums over rows and columns. Every pixel is
//! evaluated, not the mask's alone: that is cheaper than picking, and the dense output needs it.

use crate::census::Census;
use crate::disparity::FIXED_PER_PX;
use crate::simd::{Kernel, Lanes, Level};

/// Costs are scaled such that all bits differing is about this, whatever the window.
pub(crate) const COST_OF_ALL_BITS: u8 = 250;

/// Half the window's side: 5x5 or 7x7 pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Window {
    Side5,
    Side7,
}

impl Window {
    fn radius(self) -> usize {
        match self {
            Self::Side5 => 2,
            Self::Side7 => 3,
        }
    }

    /// `sum * factor >> shift` takes a window's sum of 16-bit distances to the common scale of 0..=250.
    fn scale(self) -> (u16, u32) {
        match self {
            Self::Side5 => (5, 3),
            Self::Side7 => (41, 7),
        }
    }
}

/// Candidates a pixel: one less, as interpolated, one more.
const TESTED: usize = 3;
/// Census planes of the pattern this kernel is for.
const PLANES: usize = 2;

/// Rows of scratch for one band.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    /// Raw costs of the window's rows, a ring of rows; each holds the three candidates one after another.
    ring: Vec<u8>,
    /// Sums of the ring's rows.
    columns: Vec<u8>,
}

/// What is evaluated: one set of candidate disparities for the whole window.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Evaluation<'a> {
    pub(crate) level: Level,
    pub(crate) left: &'a Census,
    pub(crate) right: &'a Census,
    /// Candidate of every pixel, 1/64 px above the smallest disparity.
    pub(crate) candidates: &'a [u16],
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) window: Window,
}

/// Rows of the result so far (the paper's D_f and C_f).
#[derive(Debug)]
pub(crate) struct Best<'a> {
    pub(crate) disparity: &'a mut [u16],
    pub(crate) cost: &'a mut [u8],
}

impl Evaluation<'_> {
    /// Evaluates rows `first_row..` as far as `best` reaches, and keeps what is better than `best`.
    pub(crate) fn update(&self, first_row: usize, best: &mut Best<'_>, scratch: &mut Scratch) {
        self.level.run(Rows {
            evaluation: self,
            first_row,
            best,
            scratch,
            finish: keep_better,
        });
    }

    /// Evaluates the same rows, and replaces `best` by the candidates corrected by up to a pixel, below a pixel: the
    /// better a candidate is in itself, the more the images must speak for another disparity.
    pub(crate) fn correct(&self, first_row: usize, best: &mut Best<'_>, scratch: &mut Scratch) {
        self.level.run(Rows {
            evaluation: self,
            first_row,
            best,
            scratch,
            finish: correct,
        });
    }
}

/// Sums of the three candidates for a block of pixels.
type Sums = [[u16; BLOCK]; TESTED];

struct Rows<'a, 'b, F> {
    evaluation: &'a Evaluation<'a>,
    first_row: usize,
    best: &'a mut Best<'b>,
    scratch: &'a mut Scratch,
    /// (sums, scale, candidates, disparities, costs)
    finish: F,
}

impl<F> Kernel for Rows<'_, '_, F>
where
    F: Fn(&Sums, (u16, u32), &[u16; BLOCK], &mut [u16; BLOCK], &mut [u8; BLOCK]),
{
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self {
            evaluation,
            first_row,
            best,
            scratch,
            finish,
        } = self;
        let (width, radius) = (evaluation.width, evaluation.window.radius());
        let side = 2 * radius + 1;
        // A margin of `radius` on both sides repeats the border's costs.
        let padded = width + 2 * radius;
        scratch.ring.clear();
        scratch.ring.resize(side * TESTED * padded, 0);
        scratch.columns.clear();
        scratch.columns.resize(TESTED * padded, 0);
        let rows = best.disparity.len() / width;
        let clamp = |row: usize| row.saturating_sub(radius).min(evaluation.height - 1);
        for k in 0..side - 1 {
            evaluation.enter_row(lanes, clamp(first_row + k), k, padded, scratch);
        }
        for row in 0..rows {
            evaluation.enter_row(
                lanes,
                clamp(first_row + row + side - 1),
                (row + side - 1) % side,
                padded,
                scratch,
            );
            let span = row * width..(row + 1) * width;
            let candidates = &evaluation.candidates[(first_row + row) * width..][..width];
            let (disparity, cost) = (&mut best.disparity[span.clone()], &mut best.cost[span]);
            // The last block overlaps the one before where the width is no multiple; finishing twice changes nothing.
            let starts = (0..width / BLOCK).map(|block| block * BLOCK);
            for x in starts.chain((!width.is_multiple_of(BLOCK)).then(|| width - BLOCK)) {
                let sums = match evaluation.window {
                    Window::Side5 => sums::<5>(&scratch.columns, padded, x),
                    Window::Side7 => sums::<7>(&scratch.columns, padded, x),
                };
                let (mut disparities, mut costs) = (block(disparity, x), block(cost, x));
                finish(
                    &sums,
                    evaluation.window.scale(),
                    &block(candidates, x),
                    &mut disparities,
                    &mut costs,
                );
                disparity[x..x + BLOCK].copy_from_slice(&disparities);
                cost[x..x + BLOCK].copy_from_slice(&costs);
            }
        }
    }
}

impl Evaluation<'_> {
    /// Replaces slot `slot` of the ring by the raw costs of row `y`, and brings the column sums up to date.
    #[inline(always)]
    fn enter_row<L: Lanes>(&self, lanes: L, y: usize, slot: usize, padded: usize, scratch: &mut Scratch) {
        let (width, radius) = (self.width, self.window.radius());
        let row = &mut scratch.ring[slot * TESTED * padded..][..TESTED * padded];
        for (sum, cost) in scratch.columns.iter_mut().zip(&*row) {
            *sum -= cost;
        }
        let (left, right) = (self.left.planes(), self.right.planes());
        let words = Words {
            left: [0, 1].map(|p| &left[p].row(y, 0)[self.left.index(0)..][..width]),
            right: [0, 1].map(|p| right[p].row(y, 0)),
            at: self.right.index(0),
            candidates: &self.candidates[y * width..][..width],
        };
        words.raw_costs(lanes, row, padded, radius);
        for costs in row.chunks_exact_mut(padded) {
            let (first, last) = (costs[radius], costs[radius + width - 1]);
            costs[..radius].fill(first);
            costs[radius + width..].fill(last);
        }
        for (sum, cost) in scratch.columns.iter_mut().zip(&*row) {
            *sum += cost;
        }
    }
}

/// A row of census words and candidates.
struct Words<'a> {
    left: [&'a [u8]; PLANES],
    right: [&'a [u8]; PLANES],
    /// Where the mirrored right row holds disparity 0 of column 0.
    at: usize,
    candidates: &'a [u16],
}

/// The widest vector.
const MOST_BYTES: usize = 64;

impl Words<'_> {
    /// Hamming distances (0..=16) at d - 1, d and d + 1, d = candidate rounded, to `costs`: a row of `padded` for each,
    /// starting at `margin`.
    ///
    /// Neighbours' right words lie close together: where a block's candidates differ little, all of them come from one
    /// table of consecutive words.
    #[inline(always)]
    fn raw_costs<L: Lanes>(&self, lanes: L, costs: &mut [u8], padded: usize, margin: usize) {
        let width = self.candidates.len();
        if width < L::BYTES {
            self.raw_costs_one_by_one(0..width, costs, padded, margin);
            return;
        }
        let starts = (0..width / L::BYTES).map(|block| block * L::BYTES);
        for x in starts.chain((!width.is_multiple_of(L::BYTES)).then(|| width - L::BYTES)) {
            let mut nearest = [0; MOST_BYTES];
            let (mut least, mut most) = (u8::MAX, 0);
            for (nearest, candidate) in nearest[..L::BYTES]
                .iter_mut()
                .zip(&self.candidates[x..x + L::BYTES])
            {
                *nearest = rounded(*candidate);
                least = least.min(*nearest);
                most = most.max(*nearest);
            }
            if usize::from(most - least) > L::TABLE - L::BYTES - TESTED + 1 {
                self.raw_costs_one_by_one(x..x + L::BYTES, costs, padded, margin);
                continue;
            }
            // In the mirrored row a block runs from its last pixel to its first.
            let mut which = [0; MOST_BYTES];
            for (k, which) in which[..L::BYTES].iter_mut().enumerate() {
                #[expect(clippy::cast_possible_truncation, reason = "below 64")]
                let back = (L::BYTES - 1 - k) as u8;
                *which = back + (nearest[k] - least);
            }
            let first = self.at - (x + L::BYTES - 1) + usize::from(least) - 1;
            let mut which = lanes.load(&which);
            for step in 0..TESTED {
                let mut sum = lanes.splat(0);
                for p in 0..PLANES {
                    let words = lanes.lookup(&self.right[p][first..], which);
                    sum = lanes.add(
                        sum,
                        lanes.count_ones(lanes.xor(words, lanes.load(&self.left[p][x..]))),
                    );
                }
                lanes.store(sum, &mut costs[step * padded + margin + x..]);
                which = lanes.add(which, lanes.splat(1));
            }
        }
    }

    #[inline(always)]
    fn raw_costs_one_by_one(
        &self,
        columns: std::ops::Range<usize>,
        costs: &mut [u8],
        padded: usize,
        margin: usize,
    ) {
        for x in columns {
            let first = self.at - x + usize::from(rounded(self.candidates[x])) - 1;
            for step in 0..TESTED {
                let distance = |p: usize| (self.left[p][x] ^ self.right[p][first + step]).count_ones();
                #[expect(clippy::cast_possible_truncation, reason = "at most 16")]
                let sum = (distance(0) + distance(1)) as u8;
                costs[step * padded + margin + x] = sum;
            }
        }
    }
}

/// To whole pixels.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "at most 255 disparities")]
fn rounded(candidate: u16) -> u8 {
    ((candidate + FIXED_PER_PX / 2) / FIXED_PER_PX) as u8
}

/// Pixels of one block: plain loops over arrays of this length become vector code.
const BLOCK: usize = 32;

#[inline(always)]
fn block<T: Copy + Default>(of: &[T], at: usize) -> [T; BLOCK] {
    let mut block = [T::default(); BLOCK];
    block.copy_from_slice(&of[at..at + BLOCK]);
    block
}

/// Sums `SIDE` columns around the block's pixels.
#[inline(always)]
fn sums<const SIDE: usize>(columns: &[u8], padded: usize, x: usize) -> Sums {
    let mut sums = [[0u16; BLOCK]; TESTED];
    for (candidate, sums) in sums.iter_mut().enumerate() {
        for column in 0..SIDE {
            let column: [u8; BLOCK] = block(columns, candidate * padded + x + column);
            for k in 0..BLOCK {
                sums[k] += u16::from(column[k]);
            }
        }
    }
    sums
}

/// All ones where `condition`, else zero: selecting by masks keeps the loops free of branches.
#[inline(always)]
fn mask(condition: bool) -> u16 {
    u16::from(condition).wrapping_neg()
}

#[inline(always)]
fn select(mask: u16, then: u16, otherwise: u16) -> u16 {
    (then & mask) | (otherwise & !mask)
}

/// Picks the best of the three candidates (the plane's own where equal, since it is sub-pixel), and keeps it where it beats
/// the cost so far.
#[inline(always)]
fn keep_better(
    [less, same, more]: &Sums,
    (factor, shift): (u16, u32),
    candidates: &[u16; BLOCK],
    disparity: &mut [u16; BLOCK],
    cost: &mut [u8; BLOCK],
) {
    for x in 0..BLOCK {
        let candidate = candidates[x];
        let is_less = mask(less[x] <= more[x]);
        let beside = select(
            is_less,
            candidate.saturating_sub(FIXED_PER_PX),
            candidate + FIXED_PER_PX,
        );
        let neighbour = less[x].min(more[x]);
        let winner = select(mask(neighbour < same[x]), beside, candidate);
        let scaled = (neighbour.min(same[x]) * factor) >> shift;
        let better = mask(scaled < u16::from(cost[x]));
        disparity[x] = select(better, winner, disparity[x]);
        #[expect(clippy::cast_possible_truncation, reason = "scaled to 0..=251")]
        let kept = select(better, scaled, u16::from(cost[x])) as u8;
        cost[x] = kept;
    }
}

/// Differing bits of a 5x5 window that a disparity 1/64 px away from the candidate must save: half a bit.
const PRIOR_SHIFT: u32 = 1;

/// Picks the best of the three after a penalty for being away from the candidate, and fits its minimum below a pixel: two
/// lines of equal slope through it and its neighbours.
#[inline(always)]
fn correct(
    [less, same, more]: &Sums,
    (factor, shift): (u16, u32),
    candidates: &[u16; BLOCK],
    disparity: &mut [u16; BLOCK],
    cost: &mut [u8; BLOCK],
) {
    for x in 0..BLOCK {
        let whole = (candidates[x] + FIXED_PER_PX / 2) & !(FIXED_PER_PX - 1);
        // Where the candidate is, seen from the whole pixel: -32..=31; 32 and more so that it does not go below zero.
        let rest = candidates[x].wrapping_sub(whole).cast_signed();
        let away = |from: i16| (from - rest).unsigned_abs() >> PRIOR_SHIFT;
        let here = same[x] + away(0);
        let [before, after] = [less[x] + away(-64), more[x] + away(64)];
        let neighbour = before.min(after);
        let moved = mask(neighbour < here);
        let is_less = mask(before <= after);
        let beside = select(is_less, whole.saturating_sub(FIXED_PER_PX), whole + FIXED_PER_PX);
        let steepest = before.max(after) - here.min(neighbour);
        // 32 * |before - after| / steepest, at most 32, by long division: six bits are fewer operations than any other.
        let mut rest = before.abs_diff(after);
        let mut offset = 0;
        for _ in 0..6 {
            let bit = mask(rest >= steepest);
            offset = (offset << 1) | (bit & 1);
            rest = (rest - (steepest & bit)) << 1;
        }
        let offset = offset & mask(steepest > 0);
        let fitted = select(is_less, whole.saturating_sub(offset), whole + offset);
        disparity[x] = select(moved, beside, fitted);
        let least = select(moved, select(is_less, less[x], more[x]), same[x]);
        #[expect(clippy::cast_possible_truncation, reason = "scaled to 0..=251")]
        let scaled = ((least * factor) >> shift) as u8;
        cost[x] = scaled;
    }
}

#[cfg(test)]
mod tests;
