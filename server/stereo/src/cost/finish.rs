//! What is made of the candidates' sums: the better result is kept, or the candidate corrected below a pixel.

use super::{Best, TESTED, Window};
use crate::disparity::FIXED_PER_PX;
use crate::simd::{Lanes, MOST_BYTES, mask};

/// What is made of the sums of the three candidates.
pub(super) trait Finish: Copy {
    /// A run of a row: `sums[k]` holds the sums over the window's rows of candidate k, from `radius` columns before the first.
    fn finish<L: Lanes>(self, lanes: L, sums: [&[u8]; TESTED], candidates: &[u16], best: Best<'_>);
}

#[inline(always)]
fn select(mask: u16, then: u16, otherwise: u16) -> u16 {
    (then & mask) | (otherwise & !mask)
}

/// Picks the best of the three candidates (the plane's own where equal, since it is sub-pixel), and keeps it where it beats
/// the cost so far; if it is the `FIRST`, everywhere. Bytes suffice: from 255 differing bits on, nothing is valid any more.
#[derive(Clone, Copy)]
pub(super) struct KeepBetter<const FIRST: bool> {
    pub(super) window: Window,
    /// It must be better by more than this.
    pub(super) by: u8,
}

impl<const FIRST: bool> KeepBetter<FIRST> {
    /// Differing bits of the windows of a vector of pixels; of 400 (5x5) or 392 (7x7, each two columns' mean), at most 255.
    #[inline(always)]
    fn window<L: Lanes>(self, lanes: L, sums: &[u8]) -> L::V {
        let column = |k: usize| lanes.load(&sums[k..]);
        match self.window {
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

    /// The costs so far.
    #[inline(always)]
    fn before<L: Lanes>(self, lanes: L, costs: &[u8]) -> L::V {
        if FIRST {
            lanes.splat(u8::MAX)
        } else {
            lanes.load(costs)
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
        let enough = lanes.sub_saturating(cost, lanes.splat(self.by));
        let worse = lanes.equal(lanes.max(scaled, enough), scaled);
        [which, lanes.not(worse), lanes.select(worse, cost, scaled)]
    }
}

impl<const FIRST: bool> Finish for KeepBetter<FIRST> {
    #[inline(always)]
    fn finish<L: Lanes>(self, lanes: L, sums: [&[u8]; TESTED], candidates: &[u16], best: Best<'_>) {
        let n = candidates.len();
        if n < L::BYTES {
            let (mut which, mut better, mut cost) = ([0; MOST_BYTES], [0; MOST_BYTES], [0; MOST_BYTES]);
            cost[..n].copy_from_slice(best.cost);
            let vectors = self.vector(lanes, sums, self.before(lanes, &cost));
            lanes.store(vectors[0], &mut which);
            lanes.store(vectors[1], &mut better);
            lanes.store(vectors[2], &mut cost);
            best.cost.copy_from_slice(&cost[..n]);
            move_to::<FIRST>(candidates, &which, &better, best.disparity);
            return;
        }
        // The last vector overlaps the one before; keeping what is better twice changes nothing.
        for block in 0..n.div_ceil(L::BYTES) {
            let x = (block * L::BYTES).min(n - L::BYTES);
            let sums = [&sums[0][x..], &sums[1][x..], &sums[2][x..]];
            let costs = &mut best.cost[x..x + L::BYTES];
            let vectors = self.vector(lanes, sums, self.before(lanes, costs));
            let (mut which, mut better) = ([0; MOST_BYTES], [0; MOST_BYTES]);
            lanes.store(vectors[0], &mut which);
            lanes.store(vectors[1], &mut better);
            lanes.store(vectors[2], costs);
            let disparity = &mut best.disparity[x..x + L::BYTES];
            move_to::<FIRST>(&candidates[x..x + L::BYTES], &which, &better, disparity);
        }
    }
}

/// Where `better`, or everywhere if it is the `FIRST`, the candidate moved by `which` - 1 pixels.
#[inline(always)]
fn move_to<const FIRST: bool>(
    candidates: &[u16],
    which: &[u8; MOST_BYTES],
    better: &[u8; MOST_BYTES],
    disparity: &mut [u16],
) {
    let chosen = which.iter().zip(better);
    for ((disparity, candidate), (which, better)) in disparity.iter_mut().zip(candidates).zip(chosen) {
        let moved = (candidate + FIXED_PER_PX * u16::from(*which)).saturating_sub(FIXED_PER_PX);
        *disparity = select(mask(FIRST | (*better > 0)), moved, *disparity);
    }
}

/// Differing bits of a 5x5 window that a disparity 1/64 px away from the candidate must save: half a bit.
const PRIOR_SHIFT: u32 = 1;

/// Picks the best of the three after a penalty for being away from the candidate, and fits its minimum below a pixel: two
/// lines of equal slope through it and its neighbours.
#[derive(Clone, Copy)]
pub(super) struct Correct;

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
