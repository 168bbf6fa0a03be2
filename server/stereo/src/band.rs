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

use crate::census::Census;
use crate::plane::Plane;
use crate::simd::{Kernel, LABELS, Lanes, Level, MOST_PIXELS};

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

/// Bands, costs and path sums of one pyramid level.
#[derive(Debug, Default)]
pub(crate) struct Band {
    width: usize,
    height: usize,
    /// Pixels from one row to the next.
    pitch: usize,
    /// Disparity of each pixel's label 0.
    first: Vec<u8>,
    /// C, upside down.
    cost: Vec<u8>,
    /// S, saturated: only what can't win saturates.
    sum: Vec<u8>,
    scratch: Scratch,
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
    /// Room for a level of `width` x `height`.
    pub(crate) fn reshape(&mut self, width: usize, height: usize) {
        (self.width, self.height, self.pitch) = (width, height, width.next_multiple_of(MOST_PIXELS));
        // Whole blocks can be read wherever a row begins.
        let pixels = self.pitch * height + BLOCK_PX;
        self.first.resize(pixels, 0);
        self.cost.resize(pixels * LABELS, 0);
        self.sum.resize(pixels * LABELS, 0);
        let scratch = &mut self.scratch;
        // The pixel after a row is never written: of a longer row it would hold distances.
        scratch.row.clear();
        scratch.row.resize((self.pitch + 2) * LABELS, 0);
        scratch.ring.resize(3 * self.pitch * LABELS, 0);
        for row in [&mut scratch.path, &mut scratch.best] {
            row.resize(self.pitch * LABELS, 0);
        }
        scratch.sums.resize(width * MOST_PIXELS * LABELS, 0);
        for row in [&mut scratch.shifts, &mut scratch.penalties] {
            row.resize(GROUP * (self.pitch + 1), 0);
        }
        for group in [&mut scratch.group_shifts, &mut scratch.group_penalties] {
            group.resize(width + 1, [0; GROUP]);
        }
    }

    /// Row `y` of the bands' starts, to be set before anything else.
    pub(crate) fn first_row_mut(&mut self, y: usize) -> &mut [u8] {
        &mut self.first[y * self.pitch..][..self.pitch]
    }

    /// Starts of row `y` and its path sums, as whole blocks: what comes after the row's pixels means nothing.
    pub(crate) fn result_row(&self, y: usize) -> (&[u8], &[[u8; LABELS]]) {
        let at = y * self.pitch;
        let pixels = at..at + self.width.next_multiple_of(BLOCK_PX);
        (
            &self.first[pixels.clone()],
            &self.sum.as_chunks::<LABELS>().0[pixels],
        )
    }

    /// Matching costs of rows `rows`.
    pub(crate) fn costs(&mut self, level: Level, views: &Views<'_>, rows: std::ops::Range<usize>) {
        level.run(Costs {
            band: self,
            views,
            rows,
        });
    }

    /// Paths from the left and from the right in rows `rows`, [`GROUP`] of them at least; these start the sums.
    pub(crate) fn across(&mut self, level: Level, views: &Views<'_>, rows: std::ops::Range<usize>) {
        level.run(Across {
            band: self,
            views,
            rows,
        });
    }

    /// Paths from the top (`upwards`: from the bottom) in rows `rows`, to be called for consecutive rows in that order.
    pub(crate) fn along(
        &mut self,
        level: Level,
        views: &Views<'_>,
        rows: std::ops::Range<usize>,
        upwards: bool,
    ) {
        level.run(Along {
            band: self,
            views,
            rows,
            upwards,
        });
    }
}

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

struct Costs<'a> {
    band: &'a mut Band,
    views: &'a Views<'a>,
    rows: std::ops::Range<usize>,
}

impl Kernel for Costs<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self { band, views, rows } = self;
        let (pitch, height) = (band.pitch, band.height);
        let row_bytes = pitch * LABELS;
        let Scratch {
            row,
            ring,
            shifts,
            penalties: others,
            ..
        } = &mut band.scratch;
        let first_row = |y: usize| &band.first[y * pitch..][..pitch];
        let mut next = rows.start;
        for entered in rows.start.saturating_sub(1)..(rows.end + 1).min(height) {
            let sums = &mut ring[entered % 3 * row_bytes..][..row_bytes];
            horizontal_sums(lanes, views, entered, first_row(entered), row, shifts, sums);
            // Rows whose neighbours are all there; a row outside the image repeats the border's.
            let complete = if entered + 1 == height { height } else { entered }.min(rows.end);
            for y in next..complete {
                let (above, below) = (y.saturating_sub(1), (y + 1).min(height - 1));
                subtract(first_row(y), first_row(above), shifts);
                subtract(first_row(y), first_row(below), others);
                let cost = &mut band.cost[y * row_bytes..][..row_bytes];
                let sums = [above, y, below].map(|y| &ring[y % 3 * row_bytes..][..row_bytes]);
                let shifts = shifts.chunks_exact(L::PIXELS).zip(others.chunks_exact(L::PIXELS));
                let beside = sums[0].chunks_exact(L::BYTES).zip(sums[2].chunks_exact(L::BYTES));
                let here = cost
                    .chunks_exact_mut(L::BYTES)
                    .zip(sums[1].chunks_exact(L::BYTES));
                for (((cost, here), (above, below)), (shift_above, shift_below)) in
                    here.zip(beside).zip(shifts)
                {
                    let above = lanes.shift(lanes.load(above), lanes.spread(shift_above));
                    let below = lanes.shift(lanes.load(below), lanes.spread(shift_below));
                    let here = lanes.add(lanes.load(here), lanes.splat(LOWEST_SUM));
                    let halved = lanes.average(lanes.add(here, lanes.add(above, below)), lanes.splat(0));
                    lanes.store(lanes.xor(halved, lanes.splat(INVERT)), cost);
                }
            }
            next = complete.max(next);
        }
    }
}

/// `to[x] = a[x] - b[x]`, wrapping.
#[inline(always)]
fn subtract(a: &[u8], b: &[u8], to: &mut [u8]) {
    for ((to, a), b) in to.iter_mut().zip(a).zip(b) {
        *to = a.wrapping_sub(*b);
    }
}

/// Sums of three neighbours' distances, each less `UNKNOWN` (so that a shift's zeros are unknown), of row `y`.
#[inline(always)]
fn horizontal_sums<L: Lanes>(
    lanes: L,
    views: &Views<'_>,
    y: usize,
    first: &[u8],
    row: &mut [u8],
    shifts: &mut [u8],
    sums: &mut [u8],
) {
    let pitch = first.len();
    let left = &views.left.planes()[0].row(y, 0)[views.left.index(0)..][..pitch];
    let right = views.right.planes()[0].row(y, 0);
    let at = views.right.index(0);
    let pixels = first.chunks_exact(L::PIXELS).zip(left.chunks_exact(L::PIXELS));
    let distances = row[LABELS..].chunks_exact_mut(L::BYTES);
    for (((first, left), distances), x) in pixels.zip(distances).zip((0..pitch).step_by(L::PIXELS)) {
        let words = lanes.load_each(right, |k| at - (x + k) + usize::from(first[k]));
        let distance = lanes.count_ones(lanes.xor(words, lanes.spread(left)));
        lanes.store(lanes.sub(distance, lanes.splat(UNKNOWN)), distances);
    }
    // Shift of the right neighbour's labels into the pixel's band; the left neighbour's is the negative of the one before.
    shifts[0] = 0;
    shifts[pitch] = 0;
    subtract(&first[..pitch - 1], &first[1..], &mut shifts[1..pitch]);
    let vectors = row
        .chunks_exact(L::BYTES)
        .zip(row[LABELS..].chunks_exact(L::BYTES))
        .zip(row[2 * LABELS..].chunks_exact(L::BYTES));
    let shifts = shifts
        .chunks_exact(L::PIXELS)
        .zip(shifts[1..].chunks_exact(L::PIXELS));
    let sums = sums.chunks_exact_mut(L::BYTES);
    for ((((before, here), after), (shift_before, shift_after)), sums) in vectors.zip(shifts).zip(sums) {
        let shift_before = lanes.sub(lanes.splat(0), lanes.spread(shift_before));
        let before = lanes.shift(lanes.load(before), shift_before);
        let after = lanes.shift(lanes.load(after), lanes.spread(shift_after));
        lanes.store(lanes.add(lanes.load(here), lanes.add(before, after)), sums);
    }
}

struct Across<'a> {
    band: &'a mut Band,
    views: &'a Views<'a>,
    rows: std::ops::Range<usize>,
}

impl Kernel for Across<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self { band, views, rows } = self;
        let (width, pitch) = (band.width, band.pitch);
        let Scratch {
            sums,
            shifts,
            penalties,
            group_shifts,
            group_penalties,
            ..
        } = &mut band.scratch;
        for top in rows.clone().step_by(GROUP) {
            // Some of the last rows may be done twice: the first path starts the sums anew.
            let top = top.min(rows.end - GROUP);
            for (k, y) in (top..top + GROUP).enumerate() {
                let first = &band.first[y * pitch..][..width];
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
                let bytes = (top + within) * pitch * LABELS..(top + within + L::PIXELS) * pitch * LABELS;
                let paths = Paths {
                    costs: &band.cost[bytes.clone()],
                    sums: &mut sums[..width * L::BYTES],
                    results: &mut band.sum[bytes],
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

struct Along<'a> {
    band: &'a mut Band,
    views: &'a Views<'a>,
    rows: std::ops::Range<usize>,
    upwards: bool,
}

impl Kernel for Along<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self {
            band,
            views,
            rows,
            upwards,
        } = self;
        let (height, pitch) = (band.height, band.pitch);
        let Scratch {
            path,
            best,
            shifts,
            penalties,
            ..
        } = &mut band.scratch;
        let (shifts, penalties) = (&mut shifts[..pitch], &mut penalties[..pitch]);
        let small = lanes.splat(views.penalties.small);
        let invert = lanes.splat(INVERT);
        let count = rows.len();
        for k in 0..count {
            let y = if upwards { rows.end - 1 - k } else { rows.start + k };
            let bytes = y * pitch * LABELS..(y + 1) * pitch * LABELS;
            let (cost, sum) = (&band.cost[bytes.clone()], &mut band.sum[bytes]);
            let starts = if upwards { y + 1 == height } else { y == 0 };
            let before = if upwards { y + 1 } else { y.wrapping_sub(1) };
            if starts {
                // Nothing before: the path is the cost. A shift beyond all labels and no penalty make it so.
                shifts.fill(0);
                path.fill(0);
                best.fill(0);
                penalties.fill(0);
            } else {
                let here = &band.first[y * pitch..][..pitch];
                let other = &band.first[before * pitch..][..pitch];
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
