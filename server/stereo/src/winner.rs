//! Winners of a band: the best label of every pixel, below a pixel, and whether the right view agrees.

use crate::band::{Grid, Half};
use crate::disparity::FIXED_PER_PX;
use crate::simd::{Kernel, LABELS, Lanes, Level};

/// Largest difference in px between the disparities the two views choose.
const LEFT_RIGHT_PX: u8 = 1;

/// Scratch of one row.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    /// Best (sum, disparity) of every pixel of the right view, mirrored.
    right: Vec<u16>,
    /// Disparity of the best label of every pixel, and what the right view answers.
    whole: Vec<u8>,
    back: Vec<u8>,
    /// Sums before, at and after the best label.
    before: Vec<u8>,
    least: Vec<u8>,
    after: Vec<u8>,
}

/// Fills one row: `disparity` in 1/64 px of the level, `valid` 1 where the right view, which has `columns_before` columns
/// left of the first, sees the pixel and has the same winner within a pixel.
pub(crate) fn row(
    level: Level,
    (grid, half, columns_before): (&Grid, &Half, isize),
    y: usize,
    scratch: &mut Scratch,
    (disparity, valid): (&mut [u16], &mut [u8]),
) {
    level.run(Row {
        grid,
        half,
        columns_before,
        y,
        scratch,
        disparity,
        valid,
    });
}

struct Row<'a> {
    grid: &'a Grid,
    half: &'a Half,
    columns_before: isize,
    y: usize,
    scratch: &'a mut Scratch,
    disparity: &'a mut [u16],
    valid: &'a mut [u8],
}

impl Kernel for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self {
            grid,
            half,
            columns_before,
            y,
            scratch,
            disparity,
            valid,
        } = self;
        let width = disparity.len();
        let (first, sums) = half.result_row(grid, y);
        let Scratch {
            right,
            whole,
            back,
            before,
            least,
            after,
        } = scratch;
        for row in [&mut *whole, &mut *back, &mut *before, &mut *least, &mut *after] {
            row.resize(first.len(), 0);
        }
        for x in (0..width).step_by(L::BYTES) {
            let best = winners(lanes, &sums[x..x + L::BYTES]);
            lanes.store(lanes.add(best.label, lanes.load(&first[x..])), &mut whole[x..]);
            lanes.store(best.before, &mut before[x..]);
            lanes.store(best.least, &mut least[x..]);
            lanes.store(best.after, &mut after[x..]);
        }
        below_a_pixel(
            &whole[..width],
            [&before[..width], &least[..width], &after[..width]],
            disparity,
        );
        // Mirrored, so that a pixel's labels meet consecutive right pixels; beyond the image's left end there is room.
        right.clear();
        right.resize(width + usize::from(u8::MAX) + LABELS, u16::MAX);
        // Neighbours meet the same right pixels, and a load that overlaps a store just made waits for it: so they are
        // taken far apart.
        let (right, first) = (&mut right[..], &first[..width]);
        for phase in 0..2 * LABELS {
            for x in (phase / 2 + phase % 2 * LABELS..width).step_by(2 * LABELS) {
                let at = width - 1 - x + usize::from(first[x]);
                if let Some(right) = right[at..].first_chunk_mut::<LABELS>() {
                    lanes.keep_least(right, &sums[x], u16::from(first[x]));
                }
            }
        }
        // What lies beyond the right view's left border agrees with nothing.
        right[width
            .saturating_add_signed(columns_before)
            .min(width + usize::from(u8::MAX))..]
            .fill(u16::MAX);
        for (x, back) in back[..width].iter_mut().enumerate() {
            [_, *back] = right[width - 1 - x + usize::from(whole[x])].to_be_bytes();
        }
        for ((valid, whole), back) in valid.iter_mut().zip(&*whole).zip(&*back) {
            *valid = u8::from(back.abs_diff(*whole) <= LEFT_RIGHT_PX);
        }
    }
}

/// The winners of as many pixels as a vector has bytes.
struct Winners<V> {
    label: V,
    /// Sums of the label before the winner, of the winner, and of the one after it.
    before: V,
    least: V,
    after: V,
}

/// Of equal labels the first wins. At the band's ends there is only one neighbour, and nothing to fit: `before` and `after`
/// are alike there.
#[inline(always)]
fn winners<L: Lanes>(lanes: L, sums: &[[u8; LABELS]]) -> Winners<L::V> {
    let mut labels = [lanes.splat(0); LABELS];
    let lane = |lane: usize| &sums[lane % L::PIXELS * LABELS..][..LABELS];
    let sixteens = [lane(0), lane(1), lane(2), lane(3)];
    for (k, label) in labels.iter_mut().enumerate() {
        *label = lanes.load_pixels(sixteens, k);
    }
    // Sixteen pixels' labels become sixteen labels of all pixels: four perfect shuffles transpose 16 x 16 bytes.
    for _ in 0..4 {
        let shuffled = labels;
        for k in 0..LABELS / 2 {
            (labels[2 * k], labels[2 * k + 1]) = lanes.interleave(shuffled[k], shuffled[k + LABELS / 2]);
        }
    }
    let mut least = labels[0];
    for label in &labels[1..] {
        least = lanes.min(least, *label);
    }
    let worst = lanes.splat(u8::MAX);
    let (mut label, mut before, mut after) = (lanes.splat(0), worst, worst);
    for k in (0..LABELS).rev() {
        let is_inner = k > 0 && k + 1 < LABELS;
        let [below, above] = if is_inner {
            [labels[k - 1], labels[k + 1]]
        } else {
            [worst; 2]
        };
        #[expect(clippy::cast_possible_truncation, reason = "below 16")]
        let own = lanes.splat(k as u8);
        let wins = lanes.equal(labels[k], least);
        label = lanes.select(wins, own, label);
        before = lanes.select(wins, below, before);
        after = lanes.select(wins, above, after);
    }
    Winners {
        label,
        before,
        least,
        after,
    }
}

/// Two lines of equal slope through the best and its neighbours: 32 * |before - after| / steepest, at most 32, by long
/// division, for which a few operations on whole rows do.
#[inline(always)]
fn below_a_pixel(whole: &[u8], [before, least, after]: [&[u8]; 3], disparity: &mut [u16]) {
    let width = disparity.len();
    let (whole, before, least, after) = (
        &whole[..width],
        &before[..width],
        &least[..width],
        &after[..width],
    );
    for x in 0..width {
        let (before, least, after) = (u16::from(before[x]), u16::from(least[x]), u16::from(after[x]));
        let steepest = before.max(after) - least;
        let mut rest = before.abs_diff(after);
        let mut step = 0;
        for _ in 0..6 {
            let bit = u16::from(rest >= steepest).wrapping_neg();
            step = (step << 1) | (bit & 1);
            rest = (rest - (steepest & bit)) << 1;
        }
        let step = step & u16::from(steepest > 0).wrapping_neg();
        let fixed = u16::from(whole[x]) * FIXED_PER_PX;
        let (less, more) = (fixed.saturating_sub(step), fixed + step);
        disparity[x] = if before < after { less } else { more };
    }
}
