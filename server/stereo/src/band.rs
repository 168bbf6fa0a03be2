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
use crate::simd::{Kernel, LABELS, Lanes, Level};

/// Pixels a row is padded to a multiple of: as many as the widest vector has.
const ALIGN_PX: usize = 4;
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
    /// Shift and P2 of every pixel.
    shifts: Vec<u8>,
    penalties: Vec<u8>,
}

impl Band {
    /// Room for a level of `width` x `height`.
    pub(crate) fn reshape(&mut self, width: usize, height: usize) {
        (self.width, self.height, self.pitch) = (width, height, width.next_multiple_of(ALIGN_PX));
        let pixels = self.pitch * height;
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
        for row in [&mut scratch.shifts, &mut scratch.penalties] {
            row.resize((width + 1) * ALIGN_PX, 0);
        }
    }

    /// Row `y` of the bands' starts, to be set before anything else.
    pub(crate) fn first_row_mut(&mut self, y: usize) -> &mut [u8] {
        &mut self.first[y * self.pitch..][..self.pitch]
    }

    /// Pixels of a row of path sums, padding included.
    pub(crate) fn pitch(&self) -> usize {
        self.pitch
    }

    /// Starts of row `y`, and its path sums, padding included.
    pub(crate) fn result_row(&self, y: usize) -> (&[u8], &[u8]) {
        let at = y * self.pitch;
        (
            &self.first[at..at + self.width],
            &self.sum[at * LABELS..(at + self.pitch) * LABELS],
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

    /// Paths from the left and from the right in rows `rows`; these start the sums.
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

/// `large - |a - b|`, at least `least`.
#[inline(always)]
fn penalty(of: &Penalties, a: u8, b: u8) -> u8 {
    of.large.saturating_sub(a.abs_diff(b)).max(of.least)
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
        let scratch = &mut band.scratch;
        let mut enter = |y: usize| {
            let first = &band.first[y * pitch..][..pitch];
            let ring = &mut scratch.ring[y % 3 * row_bytes..][..row_bytes];
            horizontal_sums(
                lanes,
                views,
                y,
                first,
                &mut scratch.row,
                &mut scratch.shifts,
                ring,
            );
        };
        // A row outside the image repeats the border's.
        enter(rows.start.saturating_sub(1));
        enter(rows.start);
        for y in rows {
            let (above, below) = (y.saturating_sub(1), (y + 1).min(height - 1));
            let mut enter = |y: usize| {
                let first = &band.first[y * pitch..][..pitch];
                let ring = &mut scratch.ring[y % 3 * row_bytes..][..row_bytes];
                horizontal_sums(
                    lanes,
                    views,
                    y,
                    first,
                    &mut scratch.row,
                    &mut scratch.shifts,
                    ring,
                );
            };
            if below > y {
                enter(below);
            }
            let first = &band.first[y * pitch..][..pitch];
            let cost = &mut band.cost[y * row_bytes..][..row_bytes];
            let ring = |y: usize| &scratch.ring[y % 3 * row_bytes..][..row_bytes];
            let firsts = [above, below].map(|y| &band.first[y * pitch..][..pitch]);
            let rings = [ring(above), ring(y), ring(below)];
            let mut shifts = [0; 2 * ALIGN_PX];
            for x in (0..pitch).step_by(L::PIXELS) {
                for k in 0..L::PIXELS {
                    shifts[k] = first[x + k].wrapping_sub(firsts[0][x + k]);
                    shifts[ALIGN_PX + k] = first[x + k].wrapping_sub(firsts[1][x + k]);
                }
                let at = x * LABELS;
                let above = lanes.shift(lanes.load(&rings[0][at..]), lanes.spread(&shifts));
                let here = lanes.load(&rings[1][at..]);
                let below = lanes.shift(lanes.load(&rings[2][at..]), lanes.spread(&shifts[ALIGN_PX..]));
                let sum = lanes.add(lanes.add(above, below), lanes.add(here, lanes.splat(LOWEST_SUM)));
                let halved = lanes.average(sum, lanes.splat(0));
                lanes.store(lanes.xor(halved, lanes.splat(INVERT)), &mut cost[x * LABELS..]);
            }
        }
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
    for x in (0..pitch).step_by(L::PIXELS) {
        let words = lanes.load_each(right, |k| at - (x + k) + usize::from(first[x + k]));
        let distance = lanes.count_ones(lanes.xor(words, lanes.spread(&left[x..])));
        lanes.store(
            lanes.sub(distance, lanes.splat(UNKNOWN)),
            &mut row[(x + 1) * LABELS..],
        );
    }
    // Shift of the right neighbour's labels into the pixel's band; the left neighbour's is the negative of the one before.
    let shifts = &mut shifts[..pitch + 1];
    shifts[0] = 0;
    shifts[pitch] = 0;
    for x in 0..pitch - 1 {
        shifts[x + 1] = first[x].wrapping_sub(first[x + 1]);
    }
    for x in (0..pitch).step_by(L::PIXELS) {
        let at = x * LABELS;
        let before = lanes.load(&row[at..]);
        let here = lanes.load(&row[at + LABELS..]);
        let after = lanes.load(&row[at + 2 * LABELS..]);
        let before = lanes.shift(before, lanes.sub(lanes.splat(0), lanes.spread(&shifts[x..])));
        let after = lanes.shift(after, lanes.spread(&shifts[x + 1..]));
        lanes.store(lanes.add(here, lanes.add(before, after)), &mut sums[x * LABELS..]);
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
        let (width, height, pitch, pixels) = (band.width, band.height, band.pitch, L::PIXELS);
        let Scratch {
            shifts, penalties, ..
        } = &mut band.scratch;
        let small = lanes.splat(views.penalties.small);
        let invert = lanes.splat(INVERT);
        for top in rows.step_by(pixels) {
            // The last rows may be done twice: the first path starts the sums anew.
            let top = top.min(height.saturating_sub(pixels));
            let row = |k: usize| (top + k).min(height - 1);
            for k in 0..pixels {
                let first = &band.first[row(k) * pitch..][..width];
                let image = &views.image.row(row(k), 0)[views.image.margin_left()..][..width];
                for x in 1..width {
                    shifts[x * pixels + k] = first[x].wrapping_sub(first[x - 1]);
                    penalties[x * pixels + k] = penalty(&views.penalties, image[x], image[x - 1]);
                }
            }
            let at = |x: usize| move |k: usize| (row(k) * pitch + x) * LABELS;
            // Both directions at once: their steps don't wait for each other. Each starts the sums of the half that it
            // meets first, and adds to those of the other.
            let mut right = lanes.load_each(&band.cost, at(0));
            let mut left = lanes.load_each(&band.cost, at(width - 1));
            let (mut best_right, mut best_left) = (lanes.largest(right), lanes.largest(left));
            for x in 0..width {
                let back = width - 1 - x;
                if x > 0 {
                    let before = lanes.shift(right, lanes.spread(&shifts[x * pixels..]));
                    let cost = lanes.load_each(&band.cost, at(x));
                    right = step(
                        lanes,
                        before,
                        best_right,
                        cost,
                        small,
                        lanes.spread(&penalties[x * pixels..]),
                    );
                    best_right = lanes.largest(right);
                    let after = (back + 1) * pixels;
                    let by = lanes.sub(lanes.splat(0), lanes.spread(&shifts[after..]));
                    let cost = lanes.load_each(&band.cost, at(back));
                    left = step(
                        lanes,
                        lanes.shift(left, by),
                        best_left,
                        cost,
                        small,
                        lanes.spread(&penalties[after..]),
                    );
                    best_left = lanes.largest(left);
                }
                let (here, there) = (lanes.xor(right, invert), lanes.xor(left, invert));
                if x < back {
                    lanes.store_each(here, &mut band.sum, at(x));
                    lanes.store_each(there, &mut band.sum, at(back));
                } else if x == back {
                    lanes.store_each(lanes.add_saturating(here, there), &mut band.sum, at(x));
                } else {
                    let sum = lanes.load_each(&band.sum, at(x));
                    lanes.store_each(lanes.add_saturating(sum, here), &mut band.sum, at(x));
                    let sum = lanes.load_each(&band.sum, at(back));
                    lanes.store_each(lanes.add_saturating(sum, there), &mut band.sum, at(back));
                }
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
                for x in 0..pitch {
                    shifts[x] = here[x].wrapping_sub(other[x]);
                    penalties[x] = penalty(&views.penalties, pixels[x], others[x]);
                }
            }
            for x in (0..pitch).step_by(L::PIXELS) {
                let at = x * LABELS;
                let reached = lanes.shift(lanes.load(&path[at..]), lanes.spread(&shifts[x..]));
                let large = lanes.spread(&penalties[x..]);
                let new = step(
                    lanes,
                    reached,
                    lanes.load(&best[at..]),
                    lanes.load(&cost[at..]),
                    small,
                    large,
                );
                lanes.store(new, &mut path[at..]);
                lanes.store(lanes.largest(new), &mut best[at..]);
                let total = lanes.add_saturating(lanes.load(&sum[at..]), lanes.xor(new, invert));
                lanes.store(total, &mut sum[at..]);
            }
        }
    }
}
