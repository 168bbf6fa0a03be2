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
use crate::changes::Blocks;
use crate::disparity::FIXED_PER_PX;
use crate::plane::CACHE_LINE;
use crate::simd::{Kernel, Lanes, Level, MOST_BYTES};

mod finish;
use finish::{Correct, Finish, KeepBetter};

/// Costs are scaled such that all bits differing is about this, whatever the window.
pub(crate) const COST_OF_ALL_BITS: u8 = 250;

/// The window's side: 5x5 or 7x7 pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Window {
    Side5,
    Side7,
}

impl Window {
    /// Columns and rows to each side.
    pub(crate) fn radius(self) -> usize {
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
    /// The candidates of a row's blocks.
    plan: Vec<Planned>,
}

/// The candidates of a block of pixels, in whole px.
#[derive(Debug, Clone, Copy)]
struct Planned {
    least: u8,
    /// How much each is above the least.
    which: [u8; MOST_BYTES],
    /// Whether one table holds the right words of all.
    fits: bool,
}

/// How much the candidates of a block may differ for one table.
#[expect(clippy::cast_possible_truncation, reason = "below 64")]
const fn reach<L: Lanes>() -> u8 {
    (L::TABLE - L::BYTES - TESTED + 1) as u8
}

const DESCENDING: [u8; MOST_BYTES] = {
    let mut numbers = [0; MOST_BYTES];
    let mut k = 0;
    while k < MOST_BYTES {
        #[expect(clippy::cast_possible_truncation, reason = "below 64")]
        {
            numbers[k] = (MOST_BYTES - 1 - k) as u8;
        }
        k += 1;
    }
    numbers
};

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
    /// Evaluates the rows from `first_row` as far as `best` reaches, of row `y` the blocks `changed(y)`, and keeps what is better
    /// than `best`.
    pub(crate) fn update(
        &self,
        first_row: usize,
        changed: impl Fn(usize) -> Blocks,
        best: &mut Best<'_>,
        scratch: &mut Scratch,
    ) {
        self.update_by(0, first_row, changed, best, scratch);
    }

    /// The same, but keeps only what is better by more than `by` (of 250).
    pub(crate) fn update_by(
        &self,
        by: u8,
        first_row: usize,
        changed: impl Fn(usize) -> Blocks,
        best: &mut Best<'_>,
        scratch: &mut Scratch,
    ) {
        self.level.run(Area {
            evaluation: self,
            first_row,
            changed,
            best,
            scratch,
            finish: KeepBetter::<false> {
                window: self.window,
                by,
            },
        });
    }

    /// The same for whole rows that have no result so far.
    pub(crate) fn begin(&self, first_row: usize, best: &mut Best<'_>, scratch: &mut Scratch) {
        self.level.run(Area {
            evaluation: self,
            first_row,
            changed: |_| Blocks::ALL,
            best,
            scratch,
            finish: KeepBetter::<true> {
                window: self.window,
                by: 0,
            },
        });
    }

    /// Evaluates the same rows whole, and replaces `best` by the candidates corrected by up to a pixel, below a pixel: the
    /// better a candidate is in itself, the more the images must speak for another disparity.
    pub(crate) fn correct(&self, first_row: usize, best: &mut Best<'_>, scratch: &mut Scratch) {
        self.level.run(Area {
            evaluation: self,
            first_row,
            changed: |_| Blocks::ALL,
            best,
            scratch,
            finish: Correct,
        });
    }
}

struct Area<'a, 'b, C, F> {
    evaluation: &'a Evaluation<'a>,
    first_row: usize,
    changed: C,
    best: &'a mut Best<'b>,
    scratch: &'a mut Scratch,
    finish: F,
}

impl<C: Fn(usize) -> Blocks, F: Finish> Kernel for Area<'_, '_, C, F> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self {
            evaluation,
            first_row,
            changed,
            best,
            scratch,
            finish,
        } = self;
        let (width, radius) = (evaluation.width, evaluation.window.radius());
        let side = 2 * radius + 1;
        // The window reaches beyond the columns; vectors that start within them do so by up to a vector more.
        let pitch = (MARGIN + width + radius + MOST_BYTES).next_multiple_of(CACHE_LINE);
        scratch.reset::<L>(side, pitch);
        let (ring, sums) = (aligned(&mut scratch.ring), aligned(&mut scratch.sums));
        let rows = best.disparity.len() / width;
        // Above and below the image its border rows repeat.
        let clamp = |row: usize| row.saturating_sub(radius).min(evaluation.height - 1);
        for row in 0..rows + side - 1 {
            // A block's row is entered if a window needs it. What is left out in between does no harm: the sums are always those
            // of the ring, and a row of windows begins with as many rows as the ring has.
            let windows = row.saturating_sub(side - 1)..(row + 1).min(rows);
            let mut needed = Blocks::NONE;
            for row in windows {
                needed = needed.or(changed(first_row + row));
            }
            let entered = evaluation.row(clamp(first_row + row));
            let ring = &mut ring[row % side * TESTED * pitch..][..TESTED * pitch];
            for columns in needed.runs(width) {
                let entry = Entry {
                    ring,
                    sums,
                    plan: &mut scratch.plan,
                    pitch,
                    radius,
                };
                entered.enter(lanes, columns, entry);
            }
            let Some(row) = row.checked_sub(side - 1) else {
                continue;
            };
            for columns in changed(first_row + row).runs(width) {
                let (less, rest) = sums.split_at(pitch);
                let (same, more) = rest.split_at(pitch);
                let from = MARGIN + columns.start - radius;
                let sums = [&less[from..], &same[from..], &more[from..]];
                let span = row * width + columns.start..row * width + columns.end;
                let best = Best {
                    disparity: &mut best.disparity[span.clone()],
                    cost: &mut best.cost[span],
                };
                let candidates = &evaluation.candidates[(first_row + row) * width..][columns];
                finish.finish(lanes, sums, candidates, best);
            }
        }
    }
}

/// Columns of room before the first one in a row of costs, for a window's reach: then that one begins a cache line.
const MARGIN: usize = CACHE_LINE;

/// The part from the first cache line on.
fn aligned(bytes: &mut [u8]) -> &mut [u8] {
    let start = bytes.as_ptr().align_offset(CACHE_LINE).min(CACHE_LINE);
    &mut bytes[start..]
}

impl Scratch {
    /// Room for a ring of `side` rows of `pitch`, and their sums: all zero.
    fn reset<L: Lanes>(&mut self, side: usize, pitch: usize) {
        self.ring.clear();
        self.ring.resize(side * TESTED * pitch + CACHE_LINE, 0);
        self.sums.clear();
        self.sums.resize(TESTED * pitch + CACHE_LINE, 0);
        let nothing = Planned {
            least: 0,
            which: [0; MOST_BYTES],
            fits: true,
        };
        self.plan.resize(pitch.div_ceil(L::BYTES), nothing);
    }
}

impl Evaluation<'_> {
    #[inline(always)]
    fn row(&self, y: usize) -> Words<'_> {
        let (left, right) = (self.left.planes(), self.right.planes());
        Words {
            left: [
                &left[0].row(y, 0)[self.left.index(0)..][..self.width],
                &left[1].row(y, 0)[self.left.index(0)..][..self.width],
            ],
            right: [right[0].row(y, 0), right[1].row(y, 0)],
            at: self.right.index(0),
            candidates: &self.candidates[y * self.width..][..self.width],
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

/// Where a row's raw costs go: those of candidate k and column x to `k * pitch + MARGIN + x`.
struct Entry<'a> {
    /// Holds the row that leaves the window, then this one.
    ring: &'a mut [u8],
    sums: &'a mut [u8],
    plan: &'a mut [Planned],
    pitch: usize,
    radius: usize,
}

impl Words<'_> {
    /// Replaces the raw costs of `columns`, and as many to both sides as a window reaches, by this row's, and brings the sums up
    /// to date.
    #[inline(always)]
    fn enter<L: Lanes>(&self, lanes: L, columns: Range<usize>, entry: Entry<'_>) {
        let (width, radius, pitch) = (self.candidates.len(), entry.radius, entry.pitch);
        let columns = columns.start.saturating_sub(radius)..(columns.end + radius).min(width);
        let (begins, ends) = (columns.start == 0, columns.end == width);
        let sums = self.add(lanes, columns, entry);
        // Beyond the image its border columns repeat.
        for sums in sums.chunks_exact_mut(pitch) {
            if begins {
                let first = sums[MARGIN];
                sums[MARGIN - radius..MARGIN].fill(first);
            }
            if ends {
                let last = sums[MARGIN + width - 1];
                sums[MARGIN + width..][..radius].fill(last);
            }
        }
    }

    /// Hamming distances (0..=16) of `columns` at d - 1, d and d + 1, d = candidate rounded.
    ///
    /// Neighbours' right words lie close together: where a block's candidates differ little, all of them come from one
    /// table of consecutive words.
    #[inline(always)]
    fn add<'a, L: Lanes>(&self, lanes: L, columns: Range<usize>, entry: Entry<'a>) -> &'a mut [u8] {
        let (first, n) = (columns.start, columns.len());
        if n < L::BYTES {
            let mut costs = [[0; MOST_BYTES]; TESTED];
            self.one_by_one(columns, &mut costs);
            for (step, costs) in costs.iter().enumerate() {
                let at = step * entry.pitch + MARGIN + first;
                for (k, cost) in costs[..n].iter().enumerate() {
                    entry.sums[at + k] = entry.sums[at + k] - entry.ring[at + k] + cost;
                    entry.ring[at + k] = *cost;
                }
            }
            return entry.sums;
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
                let at = step * entry.pitch + MARGIN + first + offset;
                let (ring, sums) = (&mut entry.ring[at..], &mut entry.sums[at..]);
                let others = lanes.sub(lanes.load(sums), lanes.load(ring));
                lanes.store(lanes.add(others, cost), sums);
                lanes.store(cost, ring);
            }
        }
        entry.sums
    }

    #[inline(always)]
    fn plan<L: Lanes>(&self, lanes: L, x: usize, planned: &mut Planned) {
        let candidates = &self.candidates[x..x + L::BYTES];
        let (least, most) = lanes.least_and_most(candidates);
        let (least, most) = (rounded(least), rounded(most));
        for (which, candidate) in planned.which[..L::BYTES].iter_mut().zip(candidates) {
            *which = rounded(*candidate) - least;
        }
        planned.least = least;
        planned.fits = most - least <= reach::<L>();
    }

    #[inline(always)]
    fn block<L: Lanes>(&self, lanes: L, x: usize, planned: &Planned) -> [L::V; TESTED] {
        let above = lanes.load(&planned.which);
        if planned.fits {
            return self.looked_up(lanes, x, planned.least, above);
        }
        // A table for those near the first one that has none yet, until all have one.
        let mut costs = [lanes.splat(0); TESTED];
        let mut left = [0; MOST_BYTES];
        lanes.store(lanes.splat(u8::MAX), &mut left);
        while let Some(k) = left[..L::BYTES].iter().position(|&left| left > 0) {
            let from = planned.which[k].saturating_sub(reach::<L>() / 2);
            let above = lanes.sub(above, lanes.splat(from));
            let near = lanes.equal(lanes.min(above, lanes.splat(reach::<L>())), above);
            let new = self.looked_up(lanes, x, planned.least + from, lanes.and(near, above));
            for (cost, new) in costs.iter_mut().zip(new) {
                *cost = lanes.select(near, new, *cost);
            }
            let rest = lanes.and(lanes.load(&left), lanes.not(near));
            lanes.store(rest, &mut left);
        }
        costs
    }

    /// Costs of a block whose candidates are `least` and `above` that, at most [`reach`].
    #[inline(always)]
    fn looked_up<L: Lanes>(&self, lanes: L, x: usize, least: u8, above: L::V) -> [L::V; TESTED] {
        let first = self.at - (x + L::BYTES - 1) + usize::from(least) - 1;
        // In the mirrored row a block runs from its last pixel to its first.
        let mut which = lanes.add(above, lanes.load(&DESCENDING[MOST_BYTES - L::BYTES..]));
        let mut costs = [lanes.splat(0); TESTED];
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

#[cfg(test)]
mod tests;
