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
    /// Evaluates rows `first_row..` as far as `best` reaches, and updates `best`.
    pub(crate) fn update(&self, first_row: usize, best: &mut Best<'_>, scratch: &mut Scratch) {
        let (width, radius) = (self.width, self.window.radius());
        let side = 2 * radius + 1;
        // A margin of `radius` on both sides repeats the border's costs.
        let padded = width + 2 * radius;
        scratch.ring.clear();
        scratch.ring.resize(side * TESTED * padded, 0);
        scratch.columns.clear();
        scratch.columns.resize(TESTED * padded, 0);
        let rows = best.disparity.len() / width;
        let clamp = |row: usize| row.saturating_sub(radius).min(self.height - 1);
        for k in 0..side - 1 {
            self.enter_row(clamp(first_row + k), k, padded, scratch);
        }
        for row in 0..rows {
            self.enter_row(
                clamp(first_row + row + side - 1),
                (row + side - 1) % side,
                padded,
                scratch,
            );
            let span = row * width..(row + 1) * width;
            let candidates = &self.candidates[(first_row + row) * width..][..width];
            let sums = &scratch.columns;
            let (disparity, cost) = (&mut best.disparity[span.clone()], &mut best.cost[span]);
            match self.window {
                Window::Side5 => keep_better::<5>(sums, self.window.scale(), candidates, disparity, cost),
                Window::Side7 => keep_better::<7>(sums, self.window.scale(), candidates, disparity, cost),
            }
        }
    }

    /// Replaces slot `slot` of the ring by the raw costs of row `y`, and brings the column sums up to date.
    fn enter_row(&self, y: usize, slot: usize, padded: usize, scratch: &mut Scratch) {
        let (width, radius) = (self.width, self.window.radius());
        let row = &mut scratch.ring[slot * TESTED * padded..][..TESTED * padded];
        for (sum, cost) in scratch.columns.iter_mut().zip(&*row) {
            *sum -= cost;
        }
        {
            let (less, rest) = row.split_at_mut(padded);
            let (same, more) = rest.split_at_mut(padded);
            let inner = radius..radius + width;
            let at = self.right.index(0);
            let left = self.left.planes();
            let right = self.right.planes();
            let left: [&[u8]; PLANES] = [0, 1].map(|p| &left[p].row(y, 0)[self.left.index(0)..][..width]);
            let right: [&[u8]; PLANES] = [0, 1].map(|p| right[p].row(y, 0));
            let candidates = &self.candidates[y * width..][..width];
            raw_costs(
                left,
                right,
                at,
                candidates,
                [
                    &mut less[inner.clone()],
                    &mut same[inner.clone()],
                    &mut more[inner],
                ],
            );
            for costs in [less, same, more] {
                let (first, last) = (costs[radius], costs[radius + width - 1]);
                costs[..radius].fill(first);
                costs[radius + width..].fill(last);
            }
        }
        for (sum, cost) in scratch.columns.iter_mut().zip(&*row) {
            *sum += cost;
        }
    }
}

/// Hamming distances (0..=16) of a row of left words to the right words at d - 1, d and d + 1, d = candidate rounded.
/// `at` is where the mirrored right row holds disparity 0 of column 0.
fn raw_costs(
    left: [&[u8]; PLANES],
    right: [&[u8]; PLANES],
    at: usize,
    candidates: &[u16],
    [less, same, more]: [&mut [u8]; TESTED],
) {
    let width = candidates.len();
    let (first, second) = (&left[0][..width], &left[1][..width]);
    let (less, same, more) = (&mut less[..width], &mut same[..width], &mut more[..width]);
    for x in 0..width {
        let d = usize::from((candidates[x] + FIXED_PER_PX / 2) / FIXED_PER_PX);
        let from = at - x + d - 1;
        // Both planes' four words from d - 1 on side by side; the fourth is not used.
        let low = u32::from_le_bytes(four(right[0], from)) ^ (u32::from(first[x]) * 0x0101_0101);
        let high = u32::from_le_bytes(four(right[1], from)) ^ (u32::from(second[x]) * 0x0101_0101);
        let v = u64::from(low) | u64::from(high) << 32;
        let v = v - ((v >> 1) & 0x5555_5555_5555_5555);
        let v = (v & 0x3333_3333_3333_3333) + ((v >> 2) & 0x3333_3333_3333_3333);
        let v = (v + (v >> 4)) & 0x0F0F_0F0F_0F0F_0F0F;
        let [a, b, c, _, d, e, f, _] = v.to_le_bytes();
        (less[x], same[x], more[x]) = (a + d, b + e, c + f);
    }
}

fn four(row: &[u8], from: usize) -> [u8; 4] {
    let bytes = &row[from..from + 4];
    [bytes[0], bytes[1], bytes[2], bytes[3]]
}

/// Pixels of one block: plain loops over arrays of this length become vector code.
const BLOCK: usize = 32;

/// Sums `SIDE` columns around every pixel, picks the best of the three candidates (the plane's own where equal, since it
/// is sub-pixel), and keeps it where it beats the cost so far.
fn keep_better<const SIDE: usize>(
    columns: &[u8],
    scale: (u16, u32),
    candidates: &[u16],
    disparity: &mut [u16],
    cost: &mut [u8],
) {
    let width = candidates.len();
    let padded = width + SIDE - 1;
    // The last block overlaps the one before where the width is no multiple: keeping the better twice changes nothing.
    let blocks = (0..width / BLOCK).map(|block| block * BLOCK);
    for x in blocks.chain((!width.is_multiple_of(BLOCK)).then(|| width - BLOCK)) {
        let [less, same, more] = [0, 1, 2].map(|candidate| {
            let mut sums = [0u16; BLOCK];
            for column in 0..SIDE {
                let column: [u8; BLOCK] = block(columns, candidate * padded + x + column);
                for (sum, cost) in sums.iter_mut().zip(column) {
                    *sum += u16::from(cost);
                }
            }
            sums
        });
        let candidates: [u16; BLOCK] = block(candidates, x);
        let (mut disparities, mut costs) = (block::<u16>(disparity, x), block::<u8>(cost, x));
        keep_better_block(
            [&less, &same, &more],
            scale,
            &candidates,
            &mut disparities,
            &mut costs,
        );
        disparity[x..x + BLOCK].copy_from_slice(&disparities);
        cost[x..x + BLOCK].copy_from_slice(&costs);
    }
}

fn block<T: Copy + Default>(of: &[T], at: usize) -> [T; BLOCK] {
    let mut block = [T::default(); BLOCK];
    block.copy_from_slice(&of[at..at + BLOCK]);
    block
}

/// All ones where `condition`, else zero: selecting by masks keeps the loops free of branches.
fn mask(condition: bool) -> u16 {
    u16::from(condition).wrapping_neg()
}

fn keep_better_block(
    [less, same, more]: [&[u16; BLOCK]; TESTED],
    (factor, shift): (u16, u32),
    candidates: &[u16; BLOCK],
    disparity: &mut [u16; BLOCK],
    cost: &mut [u8; BLOCK],
) {
    let select = |mask: u16, then: u16, otherwise: u16| (then & mask) | (otherwise & !mask);
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

#[cfg(test)]
mod tests;
