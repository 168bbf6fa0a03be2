//! Filling: a pixel without a disparity gets one from its neighbours in the four directions.
//!
//! What the right view does not see belongs to the background, so the largest of the four is never right; the smallest
//! may be an outlier. The second smallest is neither.

use crate::marks;
use crate::simd::{Kernel, Lanes, Level};

/// There is no valid pixel in a direction.
const NONE: u16 = u16::MAX;

/// Scratch of a map.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    /// The last valid disparity of every column so far.
    above: Vec<u16>,
    /// Where gaps of a row begin and end.
    ends: Vec<u8>,
}

/// Fills the pixels of `disparity` (rows of `width`) where `valid` is 0 instead of 1; without any valid pixel they become 0.
pub(crate) fn fill(level: Level, width: usize, disparity: &mut [u16], valid: &[u8], scratch: &mut Scratch) {
    level.run(Fill {
        width,
        disparity,
        valid,
        scratch,
    });
}

struct Fill<'a> {
    width: usize,
    disparity: &'a mut [u16],
    valid: &'a [u8],
    scratch: &'a mut Scratch,
}

impl Kernel for Fill<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self {
            width,
            disparity,
            valid,
            scratch,
        } = self;
        let Scratch { above, ends } = scratch;
        above.clear();
        above.resize(width, NONE);
        // Upwards: a pixel to fill remembers the next valid one below, in its own place.
        for (row, valid) in disparity
            .chunks_exact_mut(width)
            .zip(valid.chunks_exact(width))
            .rev()
        {
            keep_valid(valid, row, above);
            row.copy_from_slice(above);
        }
        // Downwards, with the last valid one above, and the ends of the gap in the row.
        above.fill(NONE);
        marks::clear(ends, width);
        for (row, valid) in disparity.chunks_exact_mut(width).zip(valid.chunks_exact(width)) {
            keep_valid(valid, row, above);
            (ends[0], ends[width]) = (1 - valid[0], 1 - valid[width - 1]);
            for (end, pair) in ends[1..width].iter_mut().zip(valid.windows(2)) {
                *end = pair[0] ^ pair[1];
            }
            let mut marks = marks::positions(ends);
            while let (Some(start), Some(end)) = (marks.next(), marks.next()) {
                let left = if start > 0 { row[start - 1] } else { NONE };
                let right = row.get(end).copied().unwrap_or(NONE);
                for (value, above) in row[start..end].iter_mut().zip(&above[start..end]) {
                    *value = second_least(left, right, *above, *value);
                }
            }
        }
    }
}

/// `kept` becomes `row` where that is valid. By masks, because a choice becomes a branch.
#[inline(always)]
fn keep_valid(valid: &[u8], row: &[u16], kept: &mut [u16]) {
    for ((kept, value), valid) in kept.iter_mut().zip(row).zip(valid) {
        let mask = u16::from(*valid).wrapping_neg();
        *kept = (value & mask) | (*kept & !mask);
    }
}

/// The second smallest that there is; the only one, or 0, if there are no two.
#[inline(always)]
fn second_least(a: u16, b: u16, c: u16, d: u16) -> u16 {
    let (least, second) = (
        a.min(b).min(c.min(d)),
        a.min(b).max(c.min(d)).min(a.max(b).min(c.max(d))),
    );
    let chosen = if second == NONE { least } else { second };
    if chosen == NONE { 0 } else { chosen }
}

#[cfg(test)]
mod tests {
    use super::{Scratch, fill};
    use crate::simd::Level;

    fn filled(width: usize, disparity: &[u16], valid: &[u8]) -> Vec<u16> {
        let mut results = Level::available().into_iter().map(|level| {
            let mut map = disparity.to_vec();
            fill(level, width, &mut map, valid, &mut Scratch::default());
            map
        });
        let first = results.next().expect("the scalar level is always there");
        assert!(results.all(|result| result == first));
        first
    }

    #[test]
    fn a_gap_gets_the_second_smallest_of_four() {
        let disparity = [9, 40, 9, 30, 0, 0, 9, 10, 9];
        assert_eq!(filled(3, &disparity, &[1, 1, 1, 1, 0, 0, 1, 1, 1])[4], 30);
        assert_eq!(filled(3, &disparity, &[1, 1, 1, 1, 0, 1, 1, 1, 1])[4], 10);
    }

    #[test]
    fn a_gap_with_one_neighbour_gets_that_and_one_without_any_becomes_nothing() {
        assert_eq!(filled(4, &[0, 0, 7, 0], &[0, 0, 1, 0]), [7; 4]);
        assert_eq!(filled(2, &[5, 6, 7, 8], &[0; 4]), [0; 4]);
        assert_eq!(filled(2, &[5, 6, 7, 8], &[1; 4]), [5, 6, 7, 8]);
    }
}
