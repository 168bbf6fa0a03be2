//! A byte plane with margins, so that no kernel has a border branch.

use crate::image::GrayView;
use crate::simd::{Kernel, Lanes, Level};

/// Columns of margin that every plane has at least, on both sides, at full resolution; a quarter of it at a quarter: room
/// for census (4), matching taps (4) and the one-pixel tests together, or for the labels of a band (16).
pub(crate) const MARGIN_X: usize = 64;
/// Bytes of a cache line, and of the longest vector: one that begins with a line lies in no other.
pub(crate) const CACHE_LINE: usize = 64;

/// Rows of margin above and below.
pub(crate) const MARGIN_Y: usize = 8;

/// Rows of bytes; column 0 of row 0 lies `margin_left` columns and [`MARGIN_Y`] rows inside.
#[derive(Debug, Default)]
pub(crate) struct Plane {
    data: Vec<u8>,
    /// Where the first row begins: at the start of a cache line.
    start: usize,
    width: usize,
    height: usize,
    margin_left: usize,
    stride: usize,
    /// Which row the first one is: of a view taken in piece by piece, the rest is not there.
    first_row: usize,
}

impl Plane {
    /// Gives the plane its size and margins; contents are unspecified afterwards.
    pub(crate) fn reshape(&mut self, width: usize, height: usize, margin_left: usize, margin_right: usize) {
        self.width = width;
        self.height = height;
        self.margin_left = margin_left;
        self.first_row = 0;
        self.stride = margin_left + width + margin_right;
        self.data
            .resize(self.stride * (height + 2 * MARGIN_Y) + CACHE_LINE, 0);
        self.start = self.data.as_ptr().align_offset(CACHE_LINE).min(CACHE_LINE);
    }

    /// Columns, margins included.
    pub(crate) fn stride(&self) -> usize {
        self.stride
    }

    /// Rows, margins excluded.
    pub(crate) fn height(&self) -> usize {
        self.height
    }

    /// Columns, margins excluded.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// Where column 0 is within a row.
    pub(crate) fn margin_left(&self) -> usize {
        self.margin_left
    }

    /// Row `y - MARGIN_Y` with its margins; `y` counts from the topmost margin row.
    fn padded_row(&self, y: usize) -> &[u8] {
        &self.bytes()[y * self.stride..][..self.stride]
    }

    /// Row `y + dy` with its margins, for `dy` within [`MARGIN_Y`].
    pub(crate) fn row(&self, y: usize, dy: i8) -> &[u8] {
        self.padded_row((y + MARGIN_Y - self.first_row).wrapping_add_signed(isize::from(dy)))
    }

    /// All rows one after another, margins included.
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.data[self.start..]
    }

    fn bytes_mut(&mut self) -> &mut [u8] {
        &mut self.data[self.start..]
    }

    /// Where column `index` (margins counted) of row `y` is in [`Self::bytes`].
    pub(crate) fn position(&self, index: usize, y: usize) -> usize {
        (y + MARGIN_Y) * self.stride + index
    }

    /// Row `y` with its margins, for writing.
    pub(crate) fn row_mut(&mut self, y: usize) -> &mut [u8] {
        let stride = self.stride;
        &mut self.bytes_mut()[(y + MARGIN_Y) * stride..][..stride]
    }

    /// Sets every byte, margins included.
    pub(crate) fn fill(&mut self, value: u8) {
        self.data.fill(value);
    }

    /// Copies the pixels of `view` such that column 0, row 0 is the view's pixel (`left_px`, `top_px`); what lies outside
    /// the view repeats its edge. Only `rows` are copied, counted from the topmost margin row.
    pub(crate) fn copy_from(
        &mut self,
        view: &GrayView<'_>,
        (left_px, top_px): (isize, usize),
        rows: std::ops::Range<usize>,
    ) {
        let (stride, margin_left) = (self.stride, self.margin_left);
        let last_row = view.height_px() - 1;
        let data = &mut self.bytes_mut()[rows.start * stride..rows.end * stride];
        for (y, row) in rows.zip(data.chunks_exact_mut(stride)) {
            let source = view.row((y + top_px).saturating_sub(MARGIN_Y).min(last_row));
            // First source column of this row, then how many columns lie left of the view, inside, and right of it.
            let first = left_px.saturating_sub_unsigned(margin_left);
            let before = first.min(0).unsigned_abs().min(stride);
            let from = usize::try_from(first).unwrap_or(0).min(source.len());
            let inside = (stride - before).min(source.len() - from);
            row[..before].fill(source[0]);
            row[before..before + inside].copy_from_slice(&source[from..from + inside]);
            row[before + inside..].fill(source[source.len() - 1]);
        }
    }

    /// The same for all of its rows and margins, row 0 becoming row `first_row`.
    pub(crate) fn show(&mut self, view: &GrayView<'_>, (left_px, top_px): (isize, usize), first_row: usize) {
        self.copy_from(view, (left_px, top_px + first_row), 0..self.padded_height());
        self.first_row = first_row;
    }

    /// Rows, margins included.
    pub(crate) fn padded_height(&self) -> usize {
        self.height + 2 * MARGIN_Y
    }

    /// Becomes `source` at half its resolution: means of two by two pixels, margins included.
    pub(crate) fn halve(&mut self, level: Level, source: &Self) {
        let margin_left = source.margin_left / 2;
        let (width, height) = (source.width.div_ceil(2), source.height.div_ceil(2));
        self.reshape(
            width,
            height,
            margin_left,
            source.stride / 2 - margin_left - width,
        );
        let last = source.height + 2 * MARGIN_Y - 2;
        let (stride, rows) = (self.stride, self.padded_height());
        for (y, row) in self.bytes_mut().chunks_exact_mut(stride).take(rows).enumerate() {
            // Both planes have the same rows of margin; what lies further out repeats the outermost.
            let first = (2 * y).saturating_sub(MARGIN_Y).min(last);
            level.run(Halve {
                upper: source.padded_row(first),
                lower: source.padded_row(first + 1),
                row,
            });
        }
    }
}

struct Halve<'a> {
    upper: &'a [u8],
    lower: &'a [u8],
    row: &'a mut [u8],
}

impl Kernel for Halve<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let pairs = self
            .upper
            .as_chunks::<2>()
            .0
            .iter()
            .zip(self.lower.as_chunks::<2>().0);
        for (mean, (upper, lower)) in self.row.iter_mut().zip(pairs) {
            let sum = [upper[0], upper[1], lower[0], lower[1]]
                .map(u16::from)
                .iter()
                .sum::<u16>();
            #[expect(clippy::cast_possible_truncation, reason = "a mean of bytes")]
            {
                *mean = ((sum + 2) / 4) as u8;
            }
        }
    }
}

#[cfg(test)]
mod tests;
