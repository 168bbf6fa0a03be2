//! Matching costs within the bands.

use std::ops::Range;

use super::{Grid, Half, INVERT, LOWEST_SUM, Scratch, UNKNOWN, Views, subtract};
use crate::simd::{Kernel, LABELS, Lanes};

pub(super) struct Costs<'a> {
    pub(super) grid: &'a Grid,
    pub(super) half: &'a mut Half,
    pub(super) scratch: &'a mut Scratch,
    pub(super) views: &'a Views<'a>,
    pub(super) rows: Range<usize>,
}

impl Kernel for Costs<'_> {
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
        let (pitch, height) = (grid.pitch, grid.height);
        let row_bytes = pitch * LABELS;
        let Scratch {
            row,
            ring,
            shifts,
            penalties: others,
            ..
        } = scratch;
        let first_row = |y: usize| grid.first_row(y);
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
                let cost = &mut half.cost[(y - half.rows.start) * row_bytes..][..row_bytes];
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
