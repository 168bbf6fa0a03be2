//! The mesh that is sent: the triangles that hold, with the vertices they use.

use crate::disparity::FIXED_PER_PX;
use crate::frame::Window;
use crate::interpolate::{Plane, scan_lines};
use crate::mesh::{Mesh, MeshParams, Vertex};
use crate::simd::{Kernel, Lanes, Level};
use crate::triangulation::Triangle;

/// Disparity change per pixel from which a surface is seen so nearly edge-on that it is a jump between two surfaces.
const MAX_GRADIENT: f32 = 1.0;
/// Mask pixels from which a triangle's validation says something.
const ENOUGH_PIXELS: u32 = 4;
/// A pixel this close to a plane lies on it, px, or closer than the mesh was asked to be.
const ON_PLANE_PX: f32 = 1.0;
/// Pixels counted at a time.
const PIXELS: usize = 16;
/// Marks a vertex that is not in the output yet.
const UNUSED: u32 = u32::MAX;
/// What is known of a pixel: [`TEXTURED`] if it says something about a triangle, and [`CONFIRMED`] if its disparity is right.
const TEXTURED: u8 = 1;
const CONFIRMED: u8 = 2;

/// What is known of the window's pixels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Evidence<'a> {
    pub(crate) window: Window,
    pub(crate) mask: &'a [u8],
    pub(crate) disparity: &'a [u16],
    pub(crate) confidence: &'a [u8],
    /// Pixels with this confidence and more confirm a triangle that they lie on.
    pub(crate) confirmed_from: u8,
}

/// A triangle to be judged.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Facet {
    /// Numbers of the vertices, one for one.
    pub(crate) indices: [usize; 3],
    pub(crate) vertices: [Vertex; 3],
    /// Whether a vertex's disparity is a guess.
    pub(crate) is_guess: bool,
}

impl From<Triangle> for Facet {
    fn from(triangle: Triangle) -> Self {
        // spade's faces turn counter-clockwise in its own frame; with v down that is the other way round for the viewer.
        let [a, b, c] = triangle.indices;
        let [p, q, r] = triangle.vertices;
        Self {
            indices: [a, c, b],
            vertices: [p, r, q],
            is_guess: triangle.has_corner(),
        }
    }
}

/// Scratch, kept from mesh to mesh.
#[derive(Debug, Default)]
pub(crate) struct Writer {
    numbers: Vec<u32>,
    known: Vec<u8>,
    lines: Vec<Line>,
}

/// Row, first and last column.
type Line = (usize, usize, usize);

impl Writer {
    /// Adds to `out` the facets that `params` keeps; their indices are below `vertices`.
    pub(crate) fn write(
        &mut self,
        level: Level,
        (vertices, facets): (usize, impl Iterator<Item = Facet>),
        evidence: Evidence<'_>,
        params: &MeshParams,
        out: &mut Mesh,
    ) {
        self.numbers.clear();
        self.numbers.resize(vertices, UNUSED);
        self.known.resize(evidence.mask.len(), 0);
        level.run(Write {
            facets,
            numbers: &mut self.numbers,
            known: &mut self.known,
            lines: &mut self.lines,
            evidence,
            params,
            out,
        });
    }

    /// The share of the facets that `params` keeps.
    pub(crate) fn share_kept(
        &mut self,
        level: Level,
        facets: impl Iterator<Item = Facet>,
        evidence: Evidence<'_>,
        params: &MeshParams,
    ) -> f64 {
        self.known.resize(evidence.mask.len(), 0);
        level.run(ShareKept {
            facets,
            known: &mut self.known,
            lines: &mut self.lines,
            evidence,
            params,
        })
    }
}

struct ShareKept<'a, F> {
    facets: F,
    known: &'a mut [u8],
    lines: &'a mut Vec<Line>,
    evidence: Evidence<'a>,
    params: &'a MeshParams,
}

impl<F: Iterator<Item = Facet>> Kernel for ShareKept<'_, F> {
    type Output = f64;

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> f64 {
        let mut judge = Judge::new(self.evidence, self.known, self.lines, self.params);
        let (mut kept, mut judged) = (0u32, 0u32);
        for facet in self.facets {
            kept += u32::from(judge.keeps(&facet));
            judged += 1;
        }
        f64::from(kept) / f64::from(judged.max(1))
    }
}

struct Write<'a, F> {
    facets: F,
    numbers: &'a mut [u32],
    known: &'a mut [u8],
    lines: &'a mut Vec<Line>,
    evidence: Evidence<'a>,
    params: &'a MeshParams,
    out: &'a mut Mesh,
}

impl<F: Iterator<Item = Facet>> Kernel for Write<'_, F> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let window = self.evidence.window;
        #[expect(
            clippy::cast_precision_loss,
            reason = "image positions and disparities are exact in f32"
        )]
        let [left, top, nearest] = [window.roi.x, window.roi.y, window.min_disparity_px].map(|at| at as f32);
        let mut judge = Judge::new(self.evidence, self.known, self.lines, self.params);
        for facet in self.facets {
            if !judge.keeps(&facet) {
                continue;
            }
            let mut numbers = [0; 3];
            for (k, place) in numbers.iter_mut().enumerate() {
                let number = &mut self.numbers[facet.indices[k]];
                if *number == UNUSED {
                    *number = u32::try_from(self.out.vertices.len()).unwrap_or(UNUSED);
                    let Vertex { u, v, disparity } = facet.vertices[k];
                    self.out.vertices.push(Vertex {
                        u: u + left,
                        v: v + top,
                        disparity: disparity + nearest,
                    });
                }
                *place = *number;
            }
            self.out.triangles.push(numbers);
        }
    }
}

struct Judge<'a> {
    width: usize,
    disparity: &'a [u16],
    known: &'a [u8],
    params: &'a MeshParams,
    lines: &'a mut Vec<Line>,
}

impl<'a> Judge<'a> {
    /// `known` becomes what is known of the pixels.
    #[inline(always)]
    fn new(
        evidence: Evidence<'a>,
        known: &'a mut [u8],
        lines: &'a mut Vec<Line>,
        params: &'a MeshParams,
    ) -> Self {
        let pixels = evidence.mask.iter().zip(evidence.confidence);
        for (known, (mask, confidence)) in known.iter_mut().zip(pixels) {
            let is_confirmed = u8::from(*confidence >= evidence.confirmed_from);
            *known = (TEXTURED + CONFIRMED * is_confirmed) * mask;
        }
        Self {
            width: evidence.window.roi.width,
            disparity: evidence.disparity,
            known,
            params,
            lines,
        }
    }

    #[inline(always)]
    fn keeps(&mut self, facet: &Facet) -> bool {
        self.params.keep_rejected || self.holds(facet)
    }

    /// Whether the facet is a surface: not steeper than one can see, and confirmed by its own pixels where it has texture.
    #[inline(always)]
    fn holds(&mut self, facet: &Facet) -> bool {
        let Some(plane) = Plane::through(&facet.vertices) else {
            return false;
        };
        if plane.is_steeper_than(MAX_GRADIENT) {
            return false;
        }
        let (textured, confirmed) = self.count(&plane, &facet.vertices);
        if textured >= ENOUGH_PIXELS {
            return confirmed as f32 >= self.params.min_valid_share * textured as f32;
        }
        let [a, b, c] = facet.vertices.map(|vertex| vertex.disparity);
        let step = a.max(b).max(c) - a.min(b).min(c);
        !facet.is_guess && step <= self.params.max_disparity_step_px
    }

    /// Textured pixels, and those of them that are confirmed and lie on the plane.
    #[inline(always)]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        reason = "disparities in 1/64 px and 16 bits more fit 31 bits, and places in an image fit 25"
    )]
    fn count(&mut self, plane: &Plane, vertices: &[Vertex; 3]) -> (u32, u32) {
        let scale = f32::from(FIXED_PER_PX) * 65536.0;
        let step = (plane.a * scale) as i32;
        let within = (self.params.tolerance_px.max(ON_PLANE_PX) * scale) as i32;
        let last = self.known.len() - PIXELS;
        let mut counts = Counts::default();
        self.lines.clear();
        scan_lines(vertices, |y, from, to| self.lines.push((y, from, to)));
        for &(y, from, to) in &*self.lines {
            let first = plane.a * from as f32 + plane.b * y as f32 + plane.c;
            let first = (first * scale) as i32;
            let row = y * self.width;
            let (mut at, end) = (row + from, row + to + 1);
            while at < end {
                // Always so many pixels, of which those outside the triangle don't count: most rows are short.
                let start = at.min(last);
                let inside = (at - start) as i32..(end - start) as i32;
                let (Some(known), Some(disparity)) = (
                    self.known[start..].first_chunk(),
                    self.disparity[start..].first_chunk(),
                ) else {
                    break;
                };
                let here = first.wrapping_add((start as i32 - (row + from) as i32).wrapping_mul(step));
                counts.add(known, disparity, inside, (here, step), within);
                at = start + PIXELS;
            }
        }
        counts.total()
    }
}

/// Counts of pixels, each place by itself.
#[derive(Default)]
struct Counts {
    textured: [u16; PIXELS],
    confirmed: [u16; PIXELS],
}

impl Counts {
    /// Adds the pixels whose places are `inside`; `plane` is at the first place and what the next have more.
    #[inline(always)]
    fn add(
        &mut self,
        known: &[u8; PIXELS],
        disparity: &[u16; PIXELS],
        inside: std::ops::Range<i32>,
        (first, step): (i32, i32),
        within: i32,
    ) {
        for (k, place) in (0..PIXELS).zip(0i32..) {
            let counts = u8::from(inside.start <= place) & u8::from(place < inside.end);
            let plane = first.wrapping_add(place.wrapping_mul(step));
            let distance = (i32::from(disparity[k]) << 16).wrapping_sub(plane).wrapping_abs();
            let is_close = u8::from(distance <= within);
            self.textured[k] += u16::from(known[k] & counts);
            self.confirmed[k] += u16::from((known[k] / CONFIRMED) & is_close & counts);
        }
    }

    /// Textured pixels, and confirmed ones.
    #[inline(always)]
    fn total(&self) -> (u32, u32) {
        let total = |counts: &[u16; PIXELS]| counts.iter().map(|&count| u32::from(count)).sum();
        (total(&self.textured), total(&self.confirmed))
    }
}

#[cfg(test)]
mod tests;
