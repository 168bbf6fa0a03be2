//! Filling: a pixel without a disparity gets one from its neighbours in the four directions.
//!
//! What the right view does not see belongs to the background, so the largest of the four is never right; the smallest
//! may be an outlier. The second smallest is neither.

use crate::fork_join::{self, ForkJoin};
use crate::marks;
use crate::simd::{Kernel, Lanes, Level};

/// There is no valid pixel in a direction.
const NONE: u16 = u16::MAX;

/// Scratch of one way through a map.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    /// The last valid disparity of every column so far.
    kept: Vec<u16>,
    /// Where gaps of a row begin and end.
    ends: Vec<u8>,
}

/// A part of a map: rows from top to bottom, or the other way round.
struct Rows<'a> {
    width: usize,
    disparity: &'a mut [u16],
    /// 1 where there is a disparity, else 0.
    valid: &'a [u8],
    upwards: bool,
}

/// Fills a map's pixels that are not valid; without any valid pixel they become 0.
///
/// Half a map looks from the top, half from the bottom, and each goes on where the other has been: two threads have no row
/// in common.
pub(crate) fn fill(
    level: Level,
    width: usize,
    disparity: &mut [u16],
    valid: &[u8],
    scratch: &mut [Scratch; 2],
    join: &dyn ForkJoin,
) {
    let middle = disparity.len() / width / 2 * width;
    for is_back in [false, true] {
        let (upper, lower) = disparity.split_at_mut(middle);
        let [down, up] = scratch;
        // On the way back each half is met by what has seen the other one.
        let (first, second) = if is_back { (up, down) } else { (down, up) };
        let halves = [
            (upper, &valid[..middle], is_back, first),
            (lower, &valid[middle..], !is_back, second),
        ];
        fork_join::for_each(
            join,
            halves.into_iter(),
            |_, (disparity, valid, upwards, scratch)| {
                let rows = Rows {
                    width,
                    disparity,
                    valid,
                    upwards,
                };
                if is_back {
                    level.run(Back { rows, scratch });
                } else {
                    level.run(Look { rows, scratch });
                }
            },
        );
    }
}

impl Rows<'_> {
    fn count(&self) -> usize {
        self.valid.len() / self.width
    }

    /// Disparities and validity of row `k` on the way.
    #[inline(always)]
    fn row(&mut self, k: usize) -> (&mut [u16], &[u8]) {
        let y = if self.upwards { self.count() - 1 - k } else { k };
        let pixels = y * self.width..(y + 1) * self.width;
        (&mut self.disparity[pixels.clone()], &self.valid[pixels])
    }
}

/// A pixel to fill remembers the last valid one that was seen, in its own place.
struct Look<'a> {
    rows: Rows<'a>,
    scratch: &'a mut Scratch,
}

impl Kernel for Look<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self { mut rows, scratch } = self;
        let kept = &mut scratch.kept;
        kept.clear();
        kept.resize(rows.width, NONE);
        for k in 0..rows.count() {
            let (row, valid) = rows.row(k);
            keep_valid(valid, row, kept);
            row.copy_from_slice(kept);
        }
    }
}

/// The other way: with the last valid one of that way, and the ends of the gap in the row.
struct Back<'a> {
    rows: Rows<'a>,
    /// Of the way that looked at the other half.
    scratch: &'a mut Scratch,
}

impl Kernel for Back<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self { mut rows, scratch } = self;
        let Scratch { kept, ends } = scratch;
        let width = rows.width;
        marks::clear(ends, width);
        for k in 0..rows.count() {
            let (row, valid) = rows.row(k);
            keep_valid(valid, row, kept);
            (ends[0], ends[width]) = (1 - valid[0], 1 - valid[width - 1]);
            for (end, pair) in ends[1..width].iter_mut().zip(valid.windows(2)) {
                *end = pair[0] ^ pair[1];
            }
            let mut marks = marks::positions(ends);
            while let (Some(start), Some(end)) = (marks.next(), marks.next()) {
                let left = if start > 0 { row[start - 1] } else { NONE };
                let right = row.get(end).copied().unwrap_or(NONE);
                for (value, kept) in row[start..end].iter_mut().zip(&kept[start..end]) {
                    *value = second_least(left, right, *kept, *value);
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
    use super::fill;
    use crate::fork_join::Serial;
    use crate::simd::Level;

    fn filled(width: usize, disparity: &[u16], valid: &[u8]) -> Vec<u16> {
        let mut results = Level::available().into_iter().map(|level| {
            let mut map = disparity.to_vec();
            fill(level, width, &mut map, valid, &mut Default::default(), &Serial);
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
