//! Disparity interpolation: the mesh's planes, rasterised (paper, section III-B).
//!
//! Every triangle is a plane `d = a u + b v + c` in disparity space. Where the paper looks up each pixel's triangle, the
//! scan lines of the triangles are filled directly: the same result, and a triangle that did not change costs nothing.

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

    /// Steepness in px of disparity per px.
    pub(crate) fn gradient(&self) -> f32 {
        self.a.hypot(self.b)
    }
}

/// Calls `row(v, u_first, u_last)` for every scan line of a triangle; pixels on its edges are inside.
#[expect(clippy::cast_possible_truncation, reason = "whole pixels of an image")]
#[expect(clippy::cast_sign_loss, reason = "vertices have no negative coordinates")]
#[inline(always)]
pub(crate) fn scan_lines(vertices: &[Vertex; 3], mut row: impl FnMut(usize, usize, usize)) {
    let mut sorted = *vertices;
    sorted.sort_by(|p, q| p.v.total_cmp(&q.v));
    let [top, middle, bottom] = sorted;
    let (first, last) = (top.v as usize, bottom.v as usize);
    // Columns a row; what is divided by zero is not used.
    let slope = |from: &Vertex, to: &Vertex| (to.u - from.u) / (to.v - from.v);
    let (long, upper, lower) = (
        slope(&top, &bottom),
        slope(&top, &middle),
        slope(&middle, &bottom),
    );
    for y in first..=last {
        let v = y as f32;
        let one = if first == last {
            bottom.u
        } else {
            top.u + long * (v - top.v)
        };
        let other = if v < middle.v {
            top.u + upper * (v - top.v)
        } else if v > middle.v {
            middle.u + lower * (v - middle.v)
        } else {
            middle.u
        };
        let (mut left, mut right) = (one.min(other), one.max(other));
        if first == last {
            (left, right) = (left.min(top.u), right.max(top.u));
        }
        // Rounding must not lose a pixel that lies exactly on an edge.
        let (from, to) = (
            (left - 1e-3).ceil().max(0.0) as usize,
            (right + 1e-3).floor() as usize,
        );
        if from <= to {
            row(y, from, to);
        }
    }
}

/// Fills the triangles' pixels of `map` (rows of `width`) with their planes, in 1/64 px, kept within 0..=`max_fixed`.
pub(crate) fn fill(
    level: Level,
    map: &mut [u16],
    width: usize,
    triangles: impl Iterator<Item = [Vertex; 3]>,
    max_fixed: u16,
) {
    level.run(Fill {
        map,
        width,
        triangles,
        max_fixed,
    });
}

struct Fill<'a, T> {
    map: &'a mut [u16],
    width: usize,
    triangles: T,
    max_fixed: u16,
}

impl<T: Iterator<Item = [Vertex; 3]>> Kernel for Fill<'_, T> {
    type Output = ();

    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "clamped to 16 bit before")]
    fn run<L: Lanes>(self, lanes: L) {
        let Self {
            map,
            width,
            triangles,
            max_fixed,
        } = self;
        // 16 more fractional bits, so that the step along a row is exact enough for the widest image.
        let scale = f32::from(FIXED_PER_PX) * 65536.0;
        let max = i32::from(max_fixed) << 16;
        for vertices in triangles {
            let Some(plane) = Plane::through(&vertices) else {
                continue;
            };
            let step = (plane.a * scale) as i32;
            scan_lines(&vertices, |y, from, to| {
                let first = plane.a * from as f32 + plane.b * y as f32 + plane.c;
                lanes.ramp(
                    &mut map[y * width + from..=y * width + to],
                    (first * scale) as i32 + 32768,
                    step,
                    max,
                );
            });
        }
    }
}

#[cfg(test)]
mod tests;
