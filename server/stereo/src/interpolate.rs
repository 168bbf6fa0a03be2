//! Disparity interpolation: the mesh's planes, rasterised (paper, section III-B).
//!
//! Every triangle is a plane `d = a u + b v + c` in disparity space. Where the paper looks up each pixel's triangle, the
//! scan lines of the triangles are filled directly: the same result, and a triangle that did not change costs nothing.

use crate::disparity::FIXED_PER_PX;
use crate::mesh::Vertex;

/// Plane coefficients in disparity space: `d = a u + b v + c`, in px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Plane {
    pub(crate) a: f32,
    pub(crate) b: f32,
    pub(crate) c: f32,
}

impl Plane {
    /// Through three vertices; `None` if they lie on one line.
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
pub(crate) fn scan_lines(vertices: &[Vertex; 3], mut row: impl FnMut(usize, usize, usize)) {
    let mut sorted = *vertices;
    sorted.sort_by(|p, q| p.v.total_cmp(&q.v));
    let [top, middle, bottom] = sorted;
    let (first, last) = (top.v as usize, bottom.v as usize);
    let column = |from: &Vertex, to: &Vertex, v: f32| {
        if to.v > from.v {
            from.u + (to.u - from.u) * ((v - from.v) / (to.v - from.v))
        } else {
            from.u
        }
    };
    for y in first..=last {
        let v = y as f32;
        let long = column(&top, &bottom, v);
        // Rows through the middle vertex belong to both short edges; a horizontal edge is then covered whole.
        let (mut left, mut right) = (long, long);
        let mut widen = |u: f32| (left, right) = (left.min(u), right.max(u));
        if v <= middle.v {
            widen(column(&top, &middle, v));
        }
        if v >= middle.v {
            widen(column(&middle, &bottom, v));
        }
        if first == last {
            widen(bottom.u);
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

/// Fills the triangle's pixels of `map` (rows of `width`) with its plane, in 1/64 px, kept within 0..=`max_fixed`.
#[expect(clippy::cast_possible_truncation, reason = "clamped to 16 bit before")]
#[expect(clippy::cast_sign_loss, reason = "clamped to 0 and more before")]
pub(crate) fn fill(map: &mut [u16], width: usize, vertices: &[Vertex; 3], max_fixed: u16) {
    let Some(plane) = Plane::through(vertices) else {
        return;
    };
    // 16 more fractional bits, so that the step along a row is exact enough for the widest image.
    let scale = f32::from(FIXED_PER_PX) * 65536.0;
    let step = (plane.a * scale) as i32;
    let max = i32::from(max_fixed) << 16;
    scan_lines(vertices, |y, from, to| {
        let first = plane.a * from as f32 + plane.b * y as f32 + plane.c;
        let mut value = (first * scale) as i32 + 32768;
        for pixel in &mut map[y * width + from..=y * width + to] {
            *pixel = (value.clamp(0, max) >> 16) as u16;
            value = value.wrapping_add(step);
        }
    });
}

#[cfg(test)]
mod tests;
