//! Which parts of a map changed, so that only those are evaluated again: one bit for every 64 pixels of a row.

use std::ops::Range;

/// Columns of a bit; 64 of them are the widest image.
const BLOCK_PX: usize = 64;
/// Rows that are evaluated together.
pub(crate) const STRIP_PX: usize = 8;

/// Marks of a map.
#[derive(Debug, Default)]
pub(crate) struct Changes {
    rows: Vec<u64>,
}

/// Marks of some of its rows.
#[derive(Debug)]
pub(crate) struct Part<'a> {
    rows: &'a mut [u64],
}

impl Part<'_> {
    /// Columns `first..=last` changed in row `y`, counted from the part's first.
    #[inline(always)]
    pub(crate) fn mark(&mut self, y: usize, first: usize, last: usize) {
        self.rows[y] |= (u64::MAX << (first / BLOCK_PX)) & (u64::MAX >> (63 - last / BLOCK_PX));
    }
}

impl Changes {
    /// Nothing changed in a map of `height` rows.
    pub(crate) fn reset(&mut self, height: usize) {
        self.rows.clear();
        self.rows.resize(height, 0);
    }

    /// All of a map of `height` rows changed.
    pub(crate) fn everything(&mut self, height: usize) {
        self.rows.clear();
        self.rows.resize(height, u64::MAX);
    }

    /// Columns `first..=last` of row `y` changed.
    #[inline(always)]
    pub(crate) fn mark(&mut self, y: usize, first: usize, last: usize) {
        Part { rows: &mut self.rows }.mark(y, first, last);
    }

    /// The marks of every `rows` rows.
    pub(crate) fn parts_mut(&mut self, rows: usize) -> impl Iterator<Item = Part<'_>> {
        self.rows.chunks_mut(rows).map(|rows| Part { rows })
    }

    /// Calls `visit(rows, columns)` for areas that together cover `rows` of a map of `width` wherever a row less than
    /// `reach` away is marked. `rows` start at a multiple of [`STRIP_PX`]; areas don't depend on how a map is cut there.
    pub(crate) fn areas(
        &self,
        rows: Range<usize>,
        width: usize,
        reach: usize,
        mut visit: impl FnMut(Range<usize>, Range<usize>),
    ) {
        let mut top = rows.start;
        let mut marks = self.strip(top, rows.end, reach);
        while top < rows.end {
            // Strips with the same marks are one area.
            let mut bottom = (top + STRIP_PX).min(rows.end);
            let mut below = 0;
            while bottom < rows.end {
                below = self.strip(bottom, rows.end, reach);
                if below != marks {
                    break;
                }
                bottom = (bottom + STRIP_PX).min(rows.end);
            }
            // Nothing lies beyond the last column.
            let mut left = marks & (u64::MAX >> (63 - (width - 1) / BLOCK_PX));
            while left != 0 {
                let first = left.trailing_zeros() as usize;
                let end = first + (left >> first).trailing_ones() as usize;
                visit(top..bottom, first * BLOCK_PX..(end * BLOCK_PX).min(width));
                left = if end == 64 { 0 } else { left & (u64::MAX << end) };
            }
            (top, marks) = (bottom, below);
        }
    }

    fn strip(&self, top: usize, end: usize, reach: usize) -> u64 {
        let rows = top.saturating_sub(reach)..((top + STRIP_PX).min(end) + reach).min(self.rows.len());
        self.rows[rows].iter().fold(0, |all, row| all | row)
    }
}

#[cfg(test)]
mod tests {
    use super::Changes;

    fn areas(changes: &Changes, rows: std::ops::Range<usize>, reach: usize) -> Vec<[usize; 4]> {
        let mut areas = Vec::new();
        changes.areas(rows, 4096, reach, |rows, columns| {
            areas.push([rows.start, rows.end, columns.start, columns.end]);
        });
        areas
    }

    #[test]
    fn areas_are_the_marked_blocks_and_the_strips_in_reach() {
        let mut changes = Changes::default();
        changes.reset(40);
        assert!(areas(&changes, 0..40, 2).is_empty());
        changes.mark(18, 130, 200);
        for y in [3, 11] {
            changes.mark(y, 0, 0);
            changes.mark(y, 4095, 4095);
        }
        assert_eq!(
            areas(&changes, 0..40, 2),
            [[0, 16, 0, 64], [0, 16, 4032, 4096], [16, 24, 128, 256]]
        );
        changes.mark(9, 0, 4095);
        assert_eq!(areas(&changes, 8..16, 0), [[8, 16, 0, 4096]]);
    }

    #[test]
    fn a_row_out_of_reach_of_a_strip_does_not_touch_it() {
        let mut changes = Changes::default();
        changes.reset(40);
        changes.mark(18, 0, 0);
        assert_eq!(areas(&changes, 0..40, 2), [[16, 24, 0, 64]]);
        assert_eq!(areas(&changes, 0..40, 3), [[8, 24, 0, 64]]);
    }
}
