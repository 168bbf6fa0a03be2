//! Which parts of a map changed, so that only those are evaluated again: one bit for every 64 pixels of a row.

use std::ops::Range;

/// Columns of a bit; 64 of them are the widest image.
pub(crate) const BLOCK_PX: usize = 64;
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

    /// Columns `first..=last` of row `y` changed.
    #[inline(always)]
    pub(crate) fn mark(&mut self, y: usize, first: usize, last: usize) {
        Part { rows: &mut self.rows }.mark(y, first, last);
    }

    /// The marks of every `rows` rows.
    pub(crate) fn parts_mut(&mut self, rows: usize) -> impl Iterator<Item = Part<'_>> {
        self.rows.chunks_mut(rows).map(|rows| Part { rows })
    }

    /// The blocks of row `y` that are marked there or in a row at most `reach` away.
    #[inline(always)]
    pub(crate) fn blocks(&self, y: usize, reach: usize) -> Blocks {
        let rows = y.saturating_sub(reach)..(y + reach + 1).min(self.rows.len());
        Blocks(self.rows[rows].iter().fold(0, |all, row| all | row))
    }
}

/// Some of a row's blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Blocks(u64);

impl Blocks {
    pub(crate) const ALL: Self = Self(u64::MAX);
    pub(crate) const NONE: Self = Self(0);

    #[inline(always)]
    pub(crate) fn or(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// The columns of a row of `width` that are in the blocks, in runs of at least a block's length: the last one may begin in
    /// the block before. Without a whole block in the row, all of it is one.
    #[inline(always)]
    pub(crate) fn runs(self, width: usize) -> Runs {
        // Nothing lies beyond the last column.
        Runs {
            left: self.0 & (u64::MAX >> (63 - (width - 1) / BLOCK_PX)),
            width,
        }
    }
}

/// Runs of columns, from left to right.
pub(crate) struct Runs {
    left: u64,
    width: usize,
}

impl Iterator for Runs {
    type Item = Range<usize>;

    #[inline(always)]
    fn next(&mut self) -> Option<Range<usize>> {
        if self.left == 0 {
            return None;
        }
        let first = self.left.trailing_zeros() as usize;
        let end = first + (self.left >> first).trailing_ones() as usize;
        self.left = if end == 64 {
            0
        } else {
            self.left & (u64::MAX << end)
        };
        let last_start = self.width.saturating_sub(BLOCK_PX);
        Some((first * BLOCK_PX).min(last_start)..(end * BLOCK_PX).min(self.width))
    }
}

#[cfg(test)]
mod tests {
    use super::{Blocks, Changes};

    fn runs(blocks: Blocks, width: usize) -> Vec<[usize; 2]> {
        blocks.runs(width).map(|run| [run.start, run.end]).collect()
    }

    #[test]
    fn runs_are_the_blocks_marked_in_the_rows_in_reach() {
        let mut changes = Changes::default();
        changes.reset(40);
        assert_eq!(changes.blocks(3, 40), Blocks::NONE);
        changes.mark(18, 130, 200);
        for y in [3, 11] {
            changes.mark(y, 0, 0);
            changes.mark(y, 4095, 4095);
        }
        for (y, reach, expected) in [
            (18, 0, vec![[128, 256]]),
            (17, 0, vec![]),
            (16, 2, vec![[128, 256]]),
            (21, 2, vec![]),
            (9, 2, vec![[0, 64], [4032, 4096]]),
            (15, 4, vec![[0, 64], [128, 256], [4032, 4096]]),
            (39, 21, vec![[128, 256]]),
        ] {
            assert_eq!(runs(changes.blocks(y, reach), 4096), expected, "row {y}, {reach}");
        }
    }

    #[test]
    fn a_run_has_the_length_of_a_block_or_the_rows() {
        let mut changes = Changes::default();
        changes.reset(1);
        changes.mark(0, 150, 150);
        let blocks = changes.blocks(0, 0);
        assert_eq!(runs(blocks, 200), [[128, 192]]);
        assert_eq!(runs(blocks, 160), [[96, 160]]);
        assert_eq!(runs(Blocks::ALL, 160), [[0, 160]]);
        assert_eq!(runs(Blocks::ALL, 40), [[0, 40]]);
        assert_eq!(runs(Blocks::ALL, 4096), [[0, 4096]]);
    }
}
