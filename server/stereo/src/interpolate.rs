//! Disparity interpolation: the mesh's planes, rasterised (paper, section III-B).
//!
//! Every triangle is a plane `d = a u + b v + c` in disparity space. Where the paper looks up each pixel's triangle, the
//! scan lines of the triangles are filled directly: the same result, and a triangle that did not change costs nothing.

use std::ops::Range;

use crate::disparity::FIXED_PER_PX;
use crate::mesh::Vertex;
use crate::simd::{Kernel, Lanes, Level};

/// Plane coefficients in disparity space: `d = a u + b v + c`, in px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Plane {
    pub(crate) a: f32,
    pub(crate) b: f32,
    pub(crate) c: f32,
}

impl Plane {
    /// Through three vertices; `None` if they lie on one line.
    #[inline(always)]
    pub(crate) fn through([p, q, r]: &[Vertex; 3]) -> Option<Self> {
        let (qu, qv, qd) = (q.u - p.u, q.v - p.v, q.disparity - p.disparity);
        let (ru, rv, rd) = (r.u - p.u, r.v - p.v, r.disparity - p.disparity);
        let twice_area = qu * rv - qv * ru;
        if twice_area == 0.0 {
            return None;
        }
        let a = (qd * rv - rd * qv) / twice_area;
        let b = (rd * qu - qd * ru) / twice_area;
        Some(Self {
            a,
            b,
            c: p.disparity - a * p.u - b * p.v,
        })
    }

    /// Whether the disparity changes by more than `limit` px a px.
    #[inline(always)]
    pub(crate) fn is_steeper_than(&self, limit: f32) -> bool {
        self.a * self.a + self.b * self.b > limit * limit
    }
}

/// Fractional bits of an edge's column: enough for exact pixels over the tallest image.
const EDGE_BITS: u32 = 32;
/// Rounding must not lose a pixel that lies exactly on an edge.
const EDGE_SLACK: i64 = 1 << 16;

/// An edge of a triangle, going down: its column in the current row and what a row adds to it.
#[derive(Clone, Copy)]
struct Edge {
    column: i64,
    step: i64,
}

impl Edge {
    /// `rows` further down.
    #[inline(always)]
    fn after(self, rows: i64) -> Self {
        Self {
            column: self.column + self.step * rows,
            ..self
        }
    }

    /// From a vertex (u, v) to one that is not higher. Both triangles of an edge compute the same columns, so that no pixel
    /// between them is lost.
    #[inline(always)]
    fn down(from: (i64, i64), to: (i64, i64)) -> Self {
        let rows = (to.1 - from.1).max(1);
        Self {
            column: from.0 << EDGE_BITS,
            step: ((to.0 - from.0) << EDGE_BITS) / rows,
        }
    }
}

/// Calls `row(v, u_first, u_last)` for every scan line of a triangle of whole pixels; pixels on its edges are inside.
#[inline(always)]
pub(crate) fn scan_lines(vertices: &[Vertex; 3], row: impl FnMut(usize, usize, usize)) {
    scan_lines_within(vertices, 0..i64::MAX, row);
}

/// The same for those of its scan lines that are in `rows`.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "whole pixels of an image")]
#[expect(clippy::cast_sign_loss, reason = "vertices have no negative coordinates")]
fn scan_lines_within(vertices: &[Vertex; 3], rows: Range<i64>, mut row: impl FnMut(usize, usize, usize)) {
    let [top, middle, bottom] = from_top(vertices);
    let long = Edge::down(top, bottom);
    // Without height it is the line from its first to its last vertex.
    let (is_line, line_end) = (top.1 == bottom.1, bottom.0 << EDGE_BITS);
    let long_is_left = is_line || long.column + long.step * (middle.1 - top.1) < middle.0 << EDGE_BITS;
    // A horizontal edge is covered whole by the row of the middle vertex.
    for (from, to, end) in [(top, middle, middle.1), (middle, bottom, bottom.1 + 1)] {
        let (first, end) = (from.1.max(rows.start), end.min(rows.end));
        let mut short = Edge::down(from, to).after(first - from.1);
        short.column = if is_line { line_end } else { short.column };
        let long = long.after(first - top.1);
        let (mut left, mut right) = if long_is_left {
            (long, short)
        } else {
            (short, long)
        };
        left.column += (1 << EDGE_BITS) - 1 - EDGE_SLACK;
        right.column += EDGE_SLACK;
        for v in first..end {
            let (first, last) = (left.column >> EDGE_BITS, right.column >> EDGE_BITS);
            if first <= last {
                row(v as usize, first as usize, last as usize);
            }
            left.column += left.step;
            right.column += right.step;
        }
    }
}

/// The vertices (u, v) from the top down, and from left to right where they are alike high.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "whole pixels of an image")]
fn from_top(vertices: &[Vertex; 3]) -> [(i64, i64); 3] {
    // As one number each, they are sorted without a branch.
    let one = |vertex: &Vertex| i64::from(vertex.v as i32) << 32 | i64::from(vertex.u as i32);
    let [a, b, c] = [one(&vertices[0]), one(&vertices[1]), one(&vertices[2])];
    let (low, high) = (a.min(b), a.max(b));
    let (middle, last) = (high.min(c), high.max(c));
    let (first, middle) = (low.min(middle), low.max(middle));
    let two = |vertex: i64| (vertex & i64::from(u32::MAX), vertex >> 32);
    [two(first), two(middle), two(last)]
}

/// Fills a whole map.
#[cfg(test)]
pub(crate) fn fill(
    level: Level,
    map: &mut [u16],
    width: usize,
    triangles: impl Iterator<Item = [Vertex; 3]>,
    max_fixed: u16,
) {
    let strip = Strip {
        first_row: 0,
        map,
        width,
    };
    strip.fill(level, triangles, max_fixed, |_, _, _| ());
}

/// Rows of a map from `first_row` on.
pub(crate) struct Strip<'a> {
    pub(crate) first_row: usize,
    pub(crate) map: &'a mut [u16],
    pub(crate) width: usize,
}

impl Strip<'_> {
    /// Fills the triangles' pixels in the strip with their planes, in 1/64 px, kept within 0..=`max_fixed`, calling `filled(row, first, last)` for every row of a triangle there.
    pub(crate) fn fill(
        self,
        level: Level,
        triangles: impl Iterator<Item = [Vertex; 3]>,
        max_fixed: u16,
        filled: impl FnMut(usize, usize, usize),
    ) {
        level.run(Fill {
            strip: self,
            triangles,
            max_fixed,
            filled,
        });
    }
}

struct Fill<'a, T, F> {
    strip: Strip<'a>,
    triangles: T,
    max_fixed: u16,
    filled: F,
}

impl<T: Iterator<Item = [Vertex; 3]>, F: FnMut(usize, usize, usize)> Kernel for Fill<'_, T, F> {
    type Output = ();

    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "clamped to 16 bit before")]
    #[expect(clippy::cast_possible_wrap, reason = "rows are few")]
    fn run<L: Lanes>(self, lanes: L) {
        let Self {
            strip:
                Strip {
                    first_row,
                    map,
                    width,
                },
            triangles,
            max_fixed,
            mut filled,
        } = self;
        let max = i32::from(max_fixed) << 16;
        let rows = first_row as i64..(first_row + map.len() / width) as i64;
        let (start, end) = (rows.start as f32, rows.end as f32);
        for vertices in triangles {
            // Most triangles lie in one strip.
            if vertices.iter().all(|vertex| vertex.v < start) || vertices.iter().all(|vertex| vertex.v >= end)
            {
                continue;
            }
            let Some(plane) = Plane::through(&vertices) else {
                continue;
            };
            let ramp = Ramp::of(&plane, &vertices[0]);
            scan_lines_within(&vertices, rows.clone(), |y, from, to| {
                filled(y, from, to);
                let at = (y - first_row) * width;
                let row = &mut map[at + from..at + to + 1];
                lanes.ramp(row, ramp.at(from, y), (ramp.a >> 16) as i32, max);
            });
        }
    }
}

/// A plane in whole numbers: disparities in 1/64 px with 32 more fractional bits.
struct Ramp {
    a: i64,
    b: i64,
    u: i64,
    v: i64,
    d: i64,
}

impl Ramp {
    #[inline(always)]
    #[expect(
        clippy::cast_possible_truncation,
        reason = "whole pixels, and disparities that fit"
    )]
    fn of(plane: &Plane, through: &Vertex) -> Self {
        let scale = f32::from(FIXED_PER_PX) * 65536.0 * 65536.0;
        Self {
            a: (plane.a * scale) as i64,
            b: (plane.b * scale) as i64,
            u: through.u as i64,
            v: through.v as i64,
            d: (through.disparity * scale) as i64 + (1 << 31),
        }
    }

    /// With 16 fractional bits. Within a triangle it is between the disparities of the vertices.
    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "disparities fit")]
    #[expect(clippy::cast_possible_wrap, reason = "columns and rows are small")]
    fn at(&self, x: usize, y: usize) -> i32 {
        let (x, y) = (x as i64 - self.u, y as i64 - self.v);
        ((self.d + self.a * x + self.b * y) >> 16) as i32
    }
}

#[cfg(test)]
mod tests;
