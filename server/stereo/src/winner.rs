//! Winners of a band: the best label of every pixel, below a pixel, and whether the right view agrees.

use crate::band::Band;
use crate::disparity::FIXED_PER_PX;
use crate::simd::{Kernel, LABELS, Lanes, Level};

/// Largest difference in px between the disparities the two views choose.
const LEFT_RIGHT_PX: u8 = 1;

/// Scratch of one row.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    /// Best (sum, disparity) of every pixel of the right view, mirrored.
    right: Vec<u16>,
    whole: Vec<u8>,
    /// Best, rank, before and after of every pixel, in the first four of its labels.
    packed: Vec<u8>,
    /// Sums before, at and after the best label.
    before: Vec<u16>,
    least: Vec<u16>,
    after: Vec<u16>,
}

/// Fills one row: `disparity` in 1/64 px of the level, `valid` 1 where the right view, which has `columns_before` columns
/// left of the first, sees the pixel and has the same winner within a pixel.
pub(crate) fn row(
    level: Level,
    (band, columns_before): (&Band, isize),
    y: usize,
    scratch: &mut Scratch,
    disparity: &mut [u16],
    valid: &mut [u8],
) {
    level.run(Row {
        band,
        columns_before,
        y,
        scratch,
        disparity,
        valid,
    });
}

struct Row<'a> {
    band: &'a Band,
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
            band,
            columns_before,
            y,
            scratch,
            disparity,
            valid,
        } = self;
        let (first, sums) = band.result_row(y);
        let width = first.len();
        let sums = sums.as_chunks::<LABELS>().0;
        // Mirrored, so that a pixel's labels meet consecutive right pixels; beyond the image's left end there is room.
        let right = &mut scratch.right;
        right.clear();
        right.resize(width + usize::from(u8::MAX) + LABELS, u16::MAX);
        scratch.whole.resize(width, 0);
        let (whole, disparity) = (&mut scratch.whole[..width], &mut disparity[..width]);
        scratch.packed.resize(band.pitch() * LABELS, 0);
        pack(lanes, sums.as_flattened(), &mut scratch.packed);
        let (packed, _) = scratch.packed.as_chunks::<LABELS>();
        for row in [&mut scratch.before, &mut scratch.least, &mut scratch.after] {
            row.resize(width, 0);
        }
        let (before, least) = (&mut scratch.before[..width], &mut scratch.least[..width]);
        let after = &mut scratch.after[..width];
        for x in 0..width {
            let [best, rank, below, above, ..] = packed[x];
            (before[x], least[x], after[x]) = (u16::from(below), u16::from(!best), u16::from(above));
            whole[x] = first[x] + (HIGHEST_RANK - rank);
            // At the band's ends there is only one neighbour, and nothing to fit: as if both were alike.
            if rank == HIGHEST_RANK || rank == 1 {
                (before[x], after[x]) = (255, 255);
            }
        }
        for x in 0..width {
            // Two lines of equal slope through the best and its neighbours: 32 * |before - after| / steepest, at most 32,
            // by long division, for which a few operations on whole rows do.
            let steepest = before[x].max(after[x]) - least[x];
            let mut rest = before[x].abs_diff(after[x]);
            let mut step = 0;
            for _ in 0..6 {
                let bit = u16::from(rest >= steepest).wrapping_neg();
                step = (step << 1) | (bit & 1);
                rest = (rest - (steepest & bit)) << 1;
            }
            let step = step & u16::from(steepest > 0).wrapping_neg();
            let fixed = u16::from(whole[x]) * FIXED_PER_PX;
            let (less, more) = (fixed.saturating_sub(step), fixed + step);
            disparity[x] = if before[x] < after[x] { less } else { more };
        }
        // Neighbours meet the same right pixels; taking every sixteenth keeps loads from waiting for stores just made.
        for phase in 0..LABELS {
            for x in (phase..width).step_by(LABELS) {
                let start = u16::from(first[x]);
                let at = width - 1 - x + usize::from(start);
                let Some(right) = right[at..].first_chunk_mut::<LABELS>() else {
                    continue;
                };
                lanes.keep_least(right, &sums[x], start);
            }
        }
        for (x, valid) in valid[..width].iter_mut().enumerate() {
            let d = usize::from(whole[x]);
            let [_, back] = right[width - 1 - x + d].to_be_bytes();
            let seen = d.cast_signed() <= x.cast_signed() + columns_before;
            *valid = u8::from(seen && back.abs_diff(whole[x]) <= LEFT_RIGHT_PX);
        }
    }
}

/// Label k has rank 16 - k: the first of equals has the highest.
const RANKS: [u8; 64] = {
    let mut ranks = [0; 64];
    let mut k = 0;
    while k < 64 {
        #[expect(clippy::cast_possible_truncation, reason = "at most 16")]
        {
            ranks[k] = (LABELS - k % LABELS) as u8;
        }
        k += 1;
    }
    ranks
};
const HIGHEST_RANK: u8 = 16;

/// Byte `which` of every pixel all ones.
const fn only(which: usize) -> [u8; 64] {
    let mut only = [0; 64];
    let mut k = which;
    while k < 64 {
        only[k] = 255;
        k += LABELS;
    }
    only
}
const ONLY: [[u8; 64]; 4] = [only(0), only(1), only(2), only(3)];

/// For every pixel of `sums`: 255 - the least sum, its rank, and the sums of the labels before and after it (0 where there
/// is none).
#[inline(always)]
fn pack<L: Lanes>(lanes: L, sums: &[u8], packed: &mut [u8]) {
    let ranks = lanes.load(&RANKS);
    for (sums, packed) in sums.chunks_exact(L::BYTES).zip(packed.chunks_exact_mut(L::BYTES)) {
        let sums = lanes.load(sums);
        let inverse = lanes.xor(sums, lanes.splat(255));
        let best = lanes.largest(inverse);
        let rank = lanes.largest(lanes.and(lanes.equal(inverse, best), ranks));
        let winner = lanes.equal(ranks, rank);
        let before = lanes.largest(lanes.and(winner, lanes.label_below(sums)));
        let after = lanes.largest(lanes.and(winner, lanes.label_above(sums)));
        let mut all = lanes.and(best, lanes.load(&ONLY[0]));
        all = lanes.add(all, lanes.and(rank, lanes.load(&ONLY[1])));
        all = lanes.add(all, lanes.and(before, lanes.load(&ONLY[2])));
        all = lanes.add(all, lanes.and(after, lanes.load(&ONLY[3])));
        lanes.store(all, packed);
    }
}
