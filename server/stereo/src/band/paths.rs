//! Paths through the bands: along rows, several rows side by side, and along columns.

use std::ops::Range;

use super::{GROUP, Grid, Half, INVERT, Penalties, Scratch, Sweep, Views, subtract};
use crate::simd::{Kernel, LABELS, Lanes};

/// `to[x]`: `large - |a[x] - b[x]|`, at least `least`.
#[inline(always)]
fn penalise(of: &Penalties, a: &[u8], b: &[u8], to: &mut [u8]) {
    for ((to, a), b) in to.iter_mut().zip(a).zip(b) {
        *to = of.large.saturating_sub(a.abs_diff(*b)).max(of.least);
    }
}

/// One step of a path: `before` (and its `best` label) at the pixel before, `cost` here, all upside down.
#[inline(always)]
fn step<L: Lanes>(lanes: L, before: L::V, best: L::V, cost: L::V, small: L::V, large: L::V) -> L::V {
    let beside = lanes.max(lanes.label_below(before), lanes.label_above(before));
    let reached = lanes.max(before, lanes.sub_saturating(beside, small));
    let reached = lanes.max(reached, lanes.sub_saturating(best, large));
    lanes.sub(cost, lanes.sub(best, reached))
}

pub(super) struct Across<'a> {
    pub(super) grid: &'a Grid,
    pub(super) half: &'a mut Half,
    pub(super) scratch: &'a mut Scratch,
    pub(super) views: &'a Views<'a>,
    pub(super) rows: Range<usize>,
}

impl Kernel for Across<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self {
            grid,
            half,
            scratch,
            views,
            rows,
        } = self;
        let (width, pitch) = (grid.width, grid.pitch);
        let Scratch {
            sums,
            shifts,
            penalties,
            group_shifts,
            group_penalties,
            ..
        } = scratch;
        for top in rows.clone().step_by(GROUP) {
            // Some of the last rows may be done twice: the first path starts the sums anew.
            let top = top.min(rows.end - GROUP);
            for (k, y) in (top..top + GROUP).enumerate() {
                let first = &grid.first_row(y)[..width];
                let image = &views.image.row(y, 0)[views.image.margin_left()..][..width];
                let shifts = &mut shifts[k * (pitch + 1)..][..=width];
                let penalties = &mut penalties[k * (pitch + 1)..][..=width];
                subtract(&first[1..], &first[..width - 1], &mut shifts[1..width]);
                penalise(
                    &views.penalties,
                    &image[1..],
                    &image[..width - 1],
                    &mut penalties[1..width],
                );
                // Beyond the ends there is nothing: a path starts with the cost.
                (shifts[0], shifts[width]) = (0, 0);
                (penalties[0], penalties[width]) = (0, 0);
            }
            side_by_side(shifts, pitch + 1, &mut group_shifts[..=width]);
            side_by_side(penalties, pitch + 1, &mut group_penalties[..=width]);
            for within in (0..GROUP).step_by(L::PIXELS) {
                let row = top - half.rows.start + within;
                let bytes = row * pitch * LABELS..(row + L::PIXELS) * pitch * LABELS;
                let paths = Paths {
                    costs: &half.cost[bytes.clone()],
                    sums: &mut sums[..width * L::BYTES],
                    results: &mut half.sum[bytes],
                    within,
                    shifts: &group_shifts[..=width],
                    penalties: &group_penalties[..=width],
                };
                paths.follow(lanes, pitch, views.penalties.small);
            }
        }
    }
}

/// [`GROUP`] rows, each `pitch` after the one before, as one of groups.
#[inline(always)]
fn side_by_side(rows: &[u8], pitch: usize, groups: &mut [[u8; GROUP]]) {
    let count = groups.len();
    let [a, b, c, d] = [0, 1, 2, 3].map(|row| &rows[row * pitch..][..count]);
    for x in 0..count {
        // As one number: so the loop becomes vector code.
        let [a, b, c, d] = [u32::from(a[x]), u32::from(b[x]), u32::from(c[x]), u32::from(d[x])];
        groups[x] = (a | b << 8 | c << 16 | d << 24).to_le_bytes();
    }
}

/// Horizontal paths of as many rows as a vector has pixels.
struct Paths<'a> {
    costs: &'a [u8],
    /// Sums of as far as the first of the two paths has got, by columns.
    sums: &'a mut [u8],
    results: &'a mut [u8],
    /// Place of the rows in their group.
    within: usize,
    /// Shifts and P2 on the way from the column before, by columns.
    shifts: &'a [[u8; GROUP]],
    penalties: &'a [[u8; GROUP]],
}

impl Paths<'_> {
    #[inline(always)]
    fn follow<L: Lanes>(self, lanes: L, pitch: usize, small: u8) {
        let (small, invert) = (lanes.splat(small), lanes.splat(INVERT));
        let width = self.shifts.len() - 1;
        let costs = self.costs.as_chunks::<LABELS>().0;
        let row = |k: usize| &costs[k % L::PIXELS * pitch..][..width];
        let costs = [row(0), row(1), row(2), row(3)];
        let mut rows = self.results.as_chunks_mut::<LABELS>().0.chunks_exact_mut(pitch);
        let mut row = || rows.next().unwrap_or_default();
        let mut results = [row(), row(), row(), row()];
        // Both directions at once: their steps don't wait for each other. Each starts the sums of the half that it meets
        // first, and adds to those of the other.
        let (mut right, mut best_right) = (lanes.splat(0), lanes.splat(0));
        let (mut left, mut best_left) = (right, best_right);
        for x in 0..width {
            let back = width - 1 - x;
            let by = lanes.spread(&self.shifts[x][self.within..]);
            let large = lanes.spread(&self.penalties[x][self.within..]);
            let cost = lanes.load_pixels(costs, x);
            right = step(lanes, lanes.shift(right, by), best_right, cost, small, large);
            best_right = lanes.largest(right);
            let by = lanes.sub(
                lanes.splat(0),
                lanes.spread(&self.shifts[back + 1][self.within..]),
            );
            let large = lanes.spread(&self.penalties[back + 1][self.within..]);
            let cost = lanes.load_pixels(costs, back);
            left = step(lanes, lanes.shift(left, by), best_left, cost, small, large);
            best_left = lanes.largest(left);
            let (here, there) = (lanes.xor(right, invert), lanes.xor(left, invert));
            if x < back {
                lanes.store(here, &mut self.sums[x * L::BYTES..]);
                lanes.store(there, &mut self.sums[back * L::BYTES..]);
            } else if x == back {
                lanes.store_pixels(lanes.add_saturating(here, there), &mut results, x);
            } else {
                let sum = lanes.load(&self.sums[x * L::BYTES..]);
                lanes.store_pixels(lanes.add_saturating(sum, here), &mut results, x);
                let sum = lanes.load(&self.sums[back * L::BYTES..]);
                lanes.store_pixels(lanes.add_saturating(sum, there), &mut results, back);
            }
        }
    }
}

pub(super) struct Along<'a> {
    pub(super) grid: &'a Grid,
    pub(super) half: &'a mut Half,
    pub(super) sweep: &'a mut Sweep,
    pub(super) views: &'a Views<'a>,
    pub(super) rows: Range<usize>,
}

impl Kernel for Along<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self {
            grid,
            half,
            sweep,
            views,
            rows,
        } = self;
        let (height, pitch, upwards) = (grid.height, grid.pitch, sweep.upwards);
        let Scratch {
            path,
            best,
            shifts,
            penalties,
            ..
        } = &mut sweep.scratch;
        let (shifts, penalties) = (&mut shifts[..pitch], &mut penalties[..pitch]);
        let small = lanes.splat(views.penalties.small);
        let invert = lanes.splat(INVERT);
        let count = rows.len();
        for k in 0..count {
            let y = if upwards { rows.end - 1 - k } else { rows.start + k };
            let row = y - half.rows.start;
            let bytes = row * pitch * LABELS..(row + 1) * pitch * LABELS;
            let (cost, sum) = (&half.cost[bytes.clone()], &mut half.sum[bytes]);
            let starts = if upwards { y + 1 == height } else { y == 0 };
            let before = if upwards { y + 1 } else { y.wrapping_sub(1) };
            if starts {
                // Nothing before: the path is the cost. A shift beyond all labels and no penalty make it so.
                shifts.fill(0);
                path.fill(0);
                best.fill(0);
                penalties.fill(0);
            } else {
                let here = grid.first_row(y);
                let other = grid.first_row(before);
                let margin = views.image.margin_left();
                let pixels = &views.image.row(y, 0)[margin..][..pitch];
                let others = &views.image.row(before, 0)[margin..][..pitch];
                subtract(here, other, shifts);
                penalise(&views.penalties, pixels, others, penalties);
            }
            let state = path
                .chunks_exact_mut(L::BYTES)
                .zip(best.chunks_exact_mut(L::BYTES));
            let maps = cost.chunks_exact(L::BYTES).zip(sum.chunks_exact_mut(L::BYTES));
            let ways = shifts
                .chunks_exact(L::PIXELS)
                .zip(penalties.chunks_exact(L::PIXELS));
            for (((path, best), (cost, sum)), (by, large)) in state.zip(maps).zip(ways) {
                let before = lanes.shift(lanes.load(path), lanes.spread(by));
                let (cost, large) = (lanes.load(cost), lanes.spread(large));
                let new = step(lanes, before, lanes.load(best), cost, small, large);
                lanes.store(new, path);
                lanes.store(lanes.largest(new), best);
                let total = lanes.add_saturating(lanes.load(sum), lanes.xor(new, invert));
                lanes.store(total, sum);
            }
        }
    }
}
