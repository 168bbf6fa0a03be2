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

use std::ops::Range;

use crate::census::Census;
use crate::disparity::FIXED_PER_PX;
use crate::simd::{Kernel, Lanes, Level, MOST_BYTES};

/// Costs are scaled such that all bits differing is about this, whatever the window.
pub(crate) const COST_OF_ALL_BITS: u8 = 250;

/// The window's side: 5x5 or 7x7 pixels.
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
}

/// Candidates a pixel: one less, as interpolated, one more.
const TESTED: usize = 3;
/// Census planes of the pattern this kernel is for.
const PLANES: usize = 2;

/// Rows of scratch for one area.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    /// Raw costs of the window's rows, a ring of rows; each holds the three candidates one after another.
    ring: Vec<u8>,
    /// Sums of the ring's rows.
    sums: Vec<u8>,
    /// Where the right words of a row's blocks are.
    plan: Vec<Planned>,
}

/// Where a block of pixels finds its right words: pixel k at `first + which[k]` for the smallest of its three candidates.
#[derive(Debug, Clone, Copy)]
struct Planned {
    /// `None` where the candidates differ too much for one table.
    first: Option<usize>,
    which: [u8; MOST_BYTES],
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
    /// Evaluates `columns` of the rows from `first_row` as far as `best` reaches, and keeps what is better than `best`.
    pub(crate) fn update(
        &self,
        first_row: usize,
        columns: Range<usize>,
        best: &mut Best<'_>,
        scratch: &mut Scratch,
    ) {
        // Less than a vector would be evaluated one by one.
        let columns = columns.start.min(self.width.saturating_sub(MOST_BYTES))..columns.end;
        self.level.run(Area {
            evaluation: self,
            first_row,
            columns,
            best,
            scratch,
            finish: KeepBetter(self.window),
        });
    }

    /// Evaluates the same rows whole, and replaces `best` by the candidates corrected by up to a pixel, below a pixel: the
    /// better a candidate is in itself, the more the images must speak for another disparity.
    pub(crate) fn correct(&self, first_row: usize, best: &mut Best<'_>, scratch: &mut Scratch) {
        self.level.run(Area {
            evaluation: self,
            first_row,
            columns: 0..self.width,
            best,
            scratch,
            finish: Correct,
        });
    }
}

/// What is made of the sums of the three candidates.
trait Finish: Copy {
    /// One row: `sums[k]` holds the sums over the window's rows of candidate k, from `radius` columns before the first.
    fn finish<L: Lanes>(self, lanes: L, sums: [&[u8]; TESTED], candidates: &[u16], best: Best<'_>);
}

struct Area<'a, 'b, F> {
    evaluation: &'a Evaluation<'a>,
    first_row: usize,
    columns: Range<usize>,
    best: &'a mut Best<'b>,
    scratch: &'a mut Scratch,
    finish: F,
}

impl<F: Finish> Kernel for Area<'_, '_, F> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self {
            evaluation,
            first_row,
            columns,
            best,
            scratch,
            finish,
        } = self;
        let (width, radius) = (evaluation.width, evaluation.window.radius());
        let side = 2 * radius + 1;
        // The window reaches beyond the columns; vectors that start within them do so by up to a vector more.
        let pitch = columns.len() + 2 * radius + MOST_BYTES;
        scratch.ring.clear();
        scratch.ring.resize(side * TESTED * pitch, 0);
        scratch.sums.clear();
        scratch.sums.resize(TESTED * pitch, 0);
        let nothing = Planned {
            first: None,
            which: [0; MOST_BYTES],
        };
        scratch.plan.resize(pitch.div_ceil(L::BYTES), nothing);
        let rows = best.disparity.len() / width;
        // Above and below the image its border rows repeat.
        let clamp = |row: usize| row.saturating_sub(radius).min(evaluation.height - 1);
        for row in 0..rows + side - 1 {
            let ring = &mut scratch.ring[row % side * TESTED * pitch..][..TESTED * pitch];
            evaluation.enter_row(
                lanes,
                clamp(first_row + row),
                &columns,
                ring,
                (&mut scratch.sums, &mut scratch.plan),
            );
            let Some(row) = row.checked_sub(side - 1) else {
                continue;
            };
            let (less, rest) = scratch.sums.split_at(pitch);
            let (same, more) = rest.split_at(pitch);
            let span = row * width + columns.start..row * width + columns.end;
            let best = Best {
                disparity: &mut best.disparity[span.clone()],
                cost: &mut best.cost[span],
            };
            let candidates = &evaluation.candidates[(first_row + row) * width..][columns.clone()];
            finish.finish(lanes, [less, same, more], candidates, best);
        }
    }
}

impl Evaluation<'_> {
    /// Replaces a slot of the ring by the raw costs of row `y`, and brings the sums up to date.
    #[inline(always)]
    fn enter_row<L: Lanes>(
        &self,
        lanes: L,
        y: usize,
        columns: &Range<usize>,
        ring: &mut [u8],
        (sums, plan): (&mut [u8], &mut [Planned]),
    ) {
        let (width, radius) = (self.width, self.window.radius());
        let pitch = ring.len() / TESTED;
        let (left, right) = (self.left.planes(), self.right.planes());
        let words = Words {
            left: [
                &left[0].row(y, 0)[self.left.index(0)..][..width],
                &left[1].row(y, 0)[self.left.index(0)..][..width],
            ],
            right: [right[0].row(y, 0), right[1].row(y, 0)],
            at: self.right.index(0),
            candidates: &self.candidates[y * width..][..width],
        };
        let needed = columns.start.saturating_sub(radius)..(columns.end + radius).min(width);
        let margin = needed.start + radius - columns.start;
        let end = margin + needed.len();
        let entry = Entry {
            ring,
            sums,
            plan,
            pitch,
            margin,
        };
        words.enter(lanes, needed, entry);
        // Beyond the image its border columns repeat.
        for sums in sums.chunks_exact_mut(pitch) {
            let (first, last) = (sums[margin], sums[end - 1]);
            sums[..margin].fill(first);
            sums[end..end + radius].fill(last);
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

/// Where a row's raw costs go: candidate k's at `k * pitch + margin` and on.
struct Entry<'a> {
    /// Holds the row that leaves the window, then this one.
    ring: &'a mut [u8],
    sums: &'a mut [u8],
    plan: &'a mut [Planned],
    pitch: usize,
    margin: usize,
}

impl Words<'_> {
    /// Hamming distances (0..=16) of `columns` at d - 1, d and d + 1, d = candidate rounded.
    ///
    /// Neighbours' right words lie close together: where a block's candidates differ little, all of them come from one
    /// table of consecutive words.
    #[inline(always)]
    fn enter<L: Lanes>(&self, lanes: L, columns: Range<usize>, entry: Entry<'_>) {
        let (first, n) = (columns.start, columns.len());
        if n < L::BYTES {
            let mut costs = [[0; MOST_BYTES]; TESTED];
            self.one_by_one(columns, &mut costs);
            for (step, costs) in costs.iter().enumerate() {
                let at = step * entry.pitch + entry.margin;
                for (k, cost) in costs[..n].iter().enumerate() {
                    entry.sums[at + k] = entry.sums[at + k] - entry.ring[at + k] + cost;
                    entry.ring[at + k] = *cost;
                }
            }
            return;
        }
        // The last block overlaps the one before where the width is no multiple; entering twice changes nothing.
        let offset = |block: usize| (block * L::BYTES).min(n - L::BYTES);
        // First where to look for all blocks, then looking: else each would wait for its addresses.
        for (block, planned) in entry.plan[..n.div_ceil(L::BYTES)].iter_mut().enumerate() {
            self.plan(lanes, first + offset(block), planned);
        }
        for (block, planned) in entry.plan[..n.div_ceil(L::BYTES)].iter().enumerate() {
            let offset = offset(block);
            let costs = self.block(lanes, first + offset, planned);
            for (step, cost) in costs.into_iter().enumerate() {
                let at = step * entry.pitch + entry.margin + offset;
                let (ring, sums) = (&mut entry.ring[at..], &mut entry.sums[at..]);
                let others = lanes.sub(lanes.load(sums), lanes.load(ring));
                lanes.store(lanes.add(others, cost), sums);
                lanes.store(cost, ring);
            }
        }
    }

    #[inline(always)]
    fn plan<L: Lanes>(&self, lanes: L, x: usize, planned: &mut Planned) {
        let candidates = &self.candidates[x..x + L::BYTES];
        let (least, most) = lanes.least_and_most(candidates);
        let (least, most) = (rounded(least), rounded(most));
        // In the mirrored row a block runs from its last pixel to its first.
        for (k, (which, candidate)) in planned.which[..L::BYTES].iter_mut().zip(candidates).enumerate() {
            #[expect(clippy::cast_possible_truncation, reason = "below 64")]
            let back = (L::BYTES - 1 - k) as u8;
            *which = back.wrapping_add(rounded(*candidate) - least);
        }
        let fits = usize::from(most - least) <= L::TABLE - L::BYTES - TESTED + 1;
        planned.first = fits.then_some(self.at - (x + L::BYTES - 1) + usize::from(least) - 1);
    }

    #[inline(always)]
    fn block<L: Lanes>(&self, lanes: L, x: usize, planned: &Planned) -> [L::V; TESTED] {
        let mut costs = [lanes.splat(0); TESTED];
        let Some(first) = planned.first else {
            let mut bytes = [[0; MOST_BYTES]; TESTED];
            self.one_by_one(x..x + L::BYTES, &mut bytes);
            for (cost, bytes) in costs.iter_mut().zip(&bytes) {
                *cost = lanes.load(bytes);
            }
            return costs;
        };
        let mut which = lanes.load(&planned.which);
        for cost in &mut costs {
            for p in 0..PLANES {
                let words = lanes.lookup(&self.right[p][first..], which);
                let differing = lanes.xor(words, lanes.load(&self.left[p][x..]));
                *cost = lanes.add(*cost, lanes.count_ones(differing));
            }
            which = lanes.add(which, lanes.splat(1));
        }
        costs
    }

    #[inline(always)]
    fn one_by_one(&self, columns: Range<usize>, costs: &mut [[u8; MOST_BYTES]; TESTED]) {
        for (k, x) in columns.enumerate() {
            let first = self.at - x + usize::from(rounded(self.candidates[x])) - 1;
            for (step, costs) in costs.iter_mut().enumerate() {
                let distance = |p: usize| (self.left[p][x] ^ self.right[p][first + step]).count_ones();
                #[expect(clippy::cast_possible_truncation, reason = "at most 16")]
                let sum = (distance(0) + distance(1)) as u8;
                costs[k] = sum;
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
/// the cost so far. Bytes suffice: from 255 differing bits on, nothing is valid any more.
#[derive(Clone, Copy)]
struct KeepBetter(Window);

impl KeepBetter {
    /// Differing bits of the windows of a vector of pixels; of 400 (5x5) or 392 (7x7, each two columns' mean), at most 255.
    #[inline(always)]
    fn window<L: Lanes>(self, lanes: L, sums: &[u8]) -> L::V {
        let column = |k: usize| lanes.load(&sums[k..]);
        match self.0 {
            Window::Side5 => {
                let inner = lanes.add(column(1), column(2));
                let outer = lanes.add(column(0), column(4));
                lanes.add_saturating(lanes.add_saturating(inner, outer), column(3))
            }
            Window::Side7 => {
                let inner = lanes.average(column(2), column(4));
                let outer = lanes.average(column(0), column(6));
                let between = lanes.average(column(1), column(5));
                let half = lanes.average(column(3), lanes.splat(0));
                let sum = lanes.add_saturating(inner, outer);
                lanes.add_saturating(lanes.add_saturating(sum, between), half)
            }
        }
    }

    /// A vector of pixels: which of the candidates is best (0, 1, 2), all ones where it beats `cost`, and the new cost.
    #[inline(always)]
    fn vector<L: Lanes>(self, lanes: L, [less, same, more]: [&[u8]; TESTED], cost: L::V) -> [L::V; 3] {
        let (less, same, more) = (
            self.window(lanes, less),
            self.window(lanes, same),
            self.window(lanes, more),
        );
        let beside = lanes.min(less, more);
        let least = lanes.min(beside, same);
        // 0 where less, 2 where more, 1 where neither beats the middle.
        let side = lanes.and(lanes.splat(2), lanes.not(lanes.equal(beside, less)));
        let middle = lanes.equal(least, same);
        let which = lanes.select(middle, lanes.splat(1), side);
        // 250 of 400: half and an eighth.
        let half = lanes.halve(least);
        let scaled = lanes.add(half, lanes.halve(lanes.halve(half)));
        let kept = lanes.min(scaled, cost);
        [which, lanes.not(lanes.equal(kept, cost)), kept]
    }
}

impl Finish for KeepBetter {
    #[inline(always)]
    fn finish<L: Lanes>(self, lanes: L, sums: [&[u8]; TESTED], candidates: &[u16], best: Best<'_>) {
        let n = candidates.len();
        if n < L::BYTES {
            let (mut which, mut better, mut cost) = ([0; MOST_BYTES], [0; MOST_BYTES], [0; MOST_BYTES]);
            cost[..n].copy_from_slice(best.cost);
            let vectors = self.vector(lanes, sums, lanes.load(&cost));
            lanes.store(vectors[0], &mut which);
            lanes.store(vectors[1], &mut better);
            lanes.store(vectors[2], &mut cost);
            best.cost.copy_from_slice(&cost[..n]);
            move_to(candidates, &which, &better, best.disparity);
            return;
        }
        // The last vector overlaps the one before; keeping what is better twice changes nothing.
        for block in 0..n.div_ceil(L::BYTES) {
            let x = (block * L::BYTES).min(n - L::BYTES);
            let sums = [&sums[0][x..], &sums[1][x..], &sums[2][x..]];
            let costs = &mut best.cost[x..x + L::BYTES];
            let vectors = self.vector(lanes, sums, lanes.load(costs));
            let (mut which, mut better) = ([0; MOST_BYTES], [0; MOST_BYTES]);
            lanes.store(vectors[0], &mut which);
            lanes.store(vectors[1], &mut better);
            lanes.store(vectors[2], costs);
            let disparity = &mut best.disparity[x..x + L::BYTES];
            move_to(&candidates[x..x + L::BYTES], &which, &better, disparity);
        }
    }
}

/// Where `better`, the candidate moved by `which` - 1 pixels.
#[inline(always)]
fn move_to(candidates: &[u16], which: &[u8; MOST_BYTES], better: &[u8; MOST_BYTES], disparity: &mut [u16]) {
    let chosen = which.iter().zip(better);
    for ((disparity, candidate), (which, better)) in disparity.iter_mut().zip(candidates).zip(chosen) {
        let moved = (candidate + FIXED_PER_PX * u16::from(*which)).saturating_sub(FIXED_PER_PX);
        *disparity = select(mask(*better > 0), moved, *disparity);
    }
}

/// Differing bits of a 5x5 window that a disparity 1/64 px away from the candidate must save: half a bit.
const PRIOR_SHIFT: u32 = 1;

/// Picks the best of the three after a penalty for being away from the candidate, and fits its minimum below a pixel: two
/// lines of equal slope through it and its neighbours.
#[derive(Clone, Copy)]
struct Correct;

impl Finish for Correct {
    #[inline(always)]
    fn finish<L: Lanes>(self, _: L, sums: [&[u8]; TESTED], candidates: &[u16], best: Best<'_>) {
        let n = candidates.len();
        // The last block overlaps the one before; correcting twice changes nothing. No image is narrower than a block.
        for block in 0..n.div_ceil(BLOCK) {
            let x = (block * BLOCK).min(n - BLOCK);
            let span = x..x + BLOCK;
            let windows = [window_5(sums[0], x), window_5(sums[1], x), window_5(sums[2], x)];
            let (disparity, cost) = (&mut best.disparity[span.clone()], &mut best.cost[span.clone()]);
            correct(&windows, &candidates[span], disparity, cost);
        }
    }
}

/// Pixels of one block: plain loops over arrays of this length become vector code.
const BLOCK: usize = 32;

/// Sums five columns around the block's pixels.
#[inline(always)]
fn window_5(columns: &[u8], x: usize) -> [u16; BLOCK] {
    let mut sums = [0; BLOCK];
    for column in 0..5 {
        let column = &columns[x + column..][..BLOCK];
        for k in 0..BLOCK {
            sums[k] += u16::from(column[k]);
        }
    }
    sums
}

#[inline(always)]
fn correct(
    [less, same, more]: &[[u16; BLOCK]; TESTED],
    candidates: &[u16],
    disparity: &mut [u16],
    cost: &mut [u8],
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
        let scaled = ((least * 5) >> 3) as u8;
        cost[x] = scaled;
    }
}

#[cfg(test)]
mod tests;
