//! Census transform (Zabih and Woodfill 1994) as byte planes.
//!
//! Every pixel is described by the signs of comparisons with some neighbours: bit = neighbour brighter than centre. Eight
//! comparisons make a byte, and each byte has a plane of its own, so that matching, validation and propagation are all
//! plain loops over bytes. The right view's planes are stored mirrored: the pixel at column `x` is at `width - 1 - x`, so
//! that candidates of growing disparity, `x - d`, lie one after another.

use std::ops::Range;

use crate::plane::Plane;
use crate::simd::{Kernel, Lanes, Level};

/// Furthest column a pattern looks at.
const REACH_PX: usize = 4;

/// Eight neighbours (dx, dy) of one byte.
type Neighbours = [(i8, i8); 8];

/// Which neighbours are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Pattern {
    /// The first 8 comparisons of `Sparse9x7`: enough where neighbours help each other.
    Sparse9x7First,
    /// 16 comparisons, sparse over 9x7 px, point symmetric.
    Sparse9x7,
    /// All 24 neighbours of the 5x5 window (paper, section III-C).
    Full5x5,
}

const SPARSE_9X7: [Neighbours; 2] = [
    [(1, 0), (-1, 0), (4, 0), (-4, 0), (0, 1), (0, -1), (0, 3), (0, -3)],
    [
        (2, 2),
        (-2, -2),
        (2, -2),
        (-2, 2),
        (4, 2),
        (-4, -2),
        (4, -2),
        (-4, 2),
    ],
];

const FULL_5X5: [Neighbours; 3] = [
    [
        (-2, -2),
        (-1, -2),
        (0, -2),
        (1, -2),
        (2, -2),
        (-2, -1),
        (-1, -1),
        (0, -1),
    ],
    [
        (1, -1),
        (2, -1),
        (-2, 0),
        (-1, 0),
        (1, 0),
        (2, 0),
        (-2, 1),
        (-1, 1),
    ],
    [(0, 1), (1, 1), (2, 1), (-2, 2), (-1, 2), (0, 2), (1, 2), (2, 2)],
];

impl Pattern {
    pub(crate) fn planes(self) -> &'static [Neighbours] {
        match self {
            Self::Sparse9x7First => &SPARSE_9X7[..1],
            Self::Sparse9x7 => &SPARSE_9X7,
            Self::Full5x5 => &FULL_5X5,
        }
    }

    /// Comparisons a pixel.
    pub(crate) fn bits(self) -> usize {
        8 * self.planes().len()
    }
}

/// Stands for what lies outside the image: with as many ones as zeros, half of the bits differ from a word on average.
const OUTSIDE: u8 = 0x0F;

/// The codes of one view.
#[derive(Debug, Default)]
pub(crate) struct Census {
    planes: Vec<Plane>,
    mirrored: bool,
}

impl Census {
    /// Room for the codes of `height` rows like `image`'s.
    pub(crate) fn reshape(&mut self, pattern: Pattern, image: &Plane, height: usize, mirrored: bool) {
        self.mirrored = mirrored;
        let (left, right) = (
            image.margin_left(),
            image.stride() - image.margin_left() - image.width(),
        );
        let (left, right) = if mirrored { (right, left) } else { (left, right) };
        self.planes.resize_with(pattern.planes().len(), Plane::default);
        for plane in &mut self.planes {
            plane.reshape(image.width(), height, left, right);
            plane.fill(OUTSIDE);
        }
    }

    /// All codes of `image`; `inside` are the columns of its rows (margins counted) that exist in the view.
    pub(crate) fn compute(&mut self, level: Level, pattern: Pattern, image: &Plane, inside: Range<usize>) {
        self.compute_rows(level, pattern, image, inside, 0..image.height());
    }

    /// The codes of some rows.
    pub(crate) fn compute_rows(
        &mut self,
        level: Level,
        pattern: Pattern,
        image: &Plane,
        inside: Range<usize>,
        rows: Range<usize>,
    ) {
        let columns = inside.start.max(REACH_PX)..inside.end.min(image.stride() - REACH_PX);
        if columns.is_empty() {
            return;
        }
        level.run(CensusRows {
            census: self,
            pattern,
            image,
            columns,
            rows,
        });
    }

    /// The planes, each of the same shape.
    pub(crate) fn planes(&self) -> &[Plane] {
        &self.planes
    }

    /// Rows of the view.
    pub(crate) fn height(&self) -> usize {
        self.planes[0].height()
    }

    /// Where column `x` of the view is within a row.
    pub(crate) fn index(&self, x: usize) -> usize {
        let plane = &self.planes[0];
        plane.margin_left() + if self.mirrored { plane.width() - 1 - x } else { x }
    }
}

struct CensusRows<'a> {
    census: &'a mut Census,
    pattern: Pattern,
    image: &'a Plane,
    columns: Range<usize>,
    rows: Range<usize>,
}

impl Kernel for CensusRows<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self {
            census,
            pattern,
            image,
            columns,
            rows,
        } = self;
        let stride = image.stride();
        let (mirrored, count) = (census.mirrored, columns.len());
        let first = if mirrored {
            stride - columns.end
        } else {
            columns.start
        };
        for y in rows {
            let centre = &image.row(y, 0)[columns.clone()];
            for (plane, neighbours) in census.planes.iter_mut().zip(pattern.planes()) {
                let mut others = [centre; 8];
                for (other, &(dx, dy)) in others.iter_mut().zip(neighbours) {
                    let from = columns.start.wrapping_add_signed(isize::from(dx));
                    *other = &image.row(y, dy)[from..from + count];
                }
                let codes = &mut plane.row_mut(y)[first..first + count];
                codes_of_row(lanes, centre, &others, mirrored, codes);
            }
        }
    }
}

/// One byte of codes for every pixel of `centre`.
#[inline(always)]
fn codes_of_row<L: Lanes>(lanes: L, centre: &[u8], others: &[&[u8]; 8], mirrored: bool, codes: &mut [u8]) {
    let count = centre.len();
    if count < L::BYTES {
        for x in 0..count {
            let bit = |k: usize| u8::from(others[k][x] > centre[x]) << k;
            let at = if mirrored { count - 1 - x } else { x };
            codes[at] = (0..8).map(bit).sum();
        }
        return;
    }
    // The last vector overlaps the one before where the row is no multiple.
    for block in 0..count.div_ceil(L::BYTES) {
        let x = (block * L::BYTES).min(count - L::BYTES);
        let here = lanes.load(&centre[x..]);
        let mut code = lanes.splat(0);
        for (k, other) in others.iter().enumerate() {
            code = lanes.add_where_more(code, 1 << k, lanes.load(&other[x..]), here);
        }
        if mirrored {
            lanes.store(lanes.reverse(code), &mut codes[count - L::BYTES - x..]);
        } else {
            lanes.store(code, &mut codes[x..]);
        }
    }
}

#[cfg(test)]
mod tests;
