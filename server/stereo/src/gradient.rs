//! Image gradient of the left view: the high-gradient mask (the paper's Omega_I) and the strength by which supports are
//! chosen. Epipolar lines are rows, so only the horizontal gradient tells how well a pixel can be matched.

use crate::plane::Plane;
use crate::simd::{Kernel, Lanes, Level};

/// A pixel is in the mask from this (|gx| + |gy|) / 8 of the 3x3 Sobel gradient on (8-bit gray levels).
const MASK_FROM: u16 = 8;

/// Mask and strength of every pixel, row by row without margins.
#[derive(Debug, Default)]
pub(crate) struct Gradient {
    /// 1 for the pixels of the high-gradient mask, else 0.
    pub(crate) mask: Vec<u8>,
    /// |gx| / 4 of the 3x3 Sobel gradient.
    pub(crate) strength: Vec<u8>,
    width: usize,
}

impl Gradient {
    pub(crate) fn reshape(&mut self, width: usize, height: usize) {
        self.width = width;
        self.mask.resize(width * height, 0);
        self.strength.resize(width * height, 0);
    }

    /// Both maps from the padded left image.
    pub(crate) fn compute(&mut self, level: Level, image: &Plane) {
        level.run(Compute {
            gradient: self,
            image,
        });
    }
}

struct Compute<'a> {
    gradient: &'a mut Gradient,
    image: &'a Plane,
}

impl Kernel for Compute<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self { gradient, image } = self;
        let (width, from) = (gradient.width, image.margin_left() - 1);
        let rows = gradient
            .mask
            .chunks_exact_mut(width)
            .zip(gradient.strength.chunks_exact_mut(width));
        for (y, (mask, strength)) in rows.enumerate() {
            let row = |dy: i8| &image.row(y, dy)[from..from + width + 2];
            let (above, here, below) = (row(-1), row(0), row(1));
            sobel_row(above, here, below, mask, strength);
        }
    }
}

/// One row; the inputs have one more pixel on each side than the outputs.
#[inline(always)]
fn sobel_row(above: &[u8], here: &[u8], below: &[u8], mask: &mut [u8], strength: &mut [u8]) {
    let width = mask.len();
    let (above, here, below) = (&above[..width + 2], &here[..width + 2], &below[..width + 2]);
    for x in 0..width {
        let at = |row: &[u8], dx: usize| i16::from(row[x + dx]);
        let gx = at(above, 2) - at(above, 0) + 2 * (at(here, 2) - at(here, 0)) + at(below, 2) - at(below, 0);
        let gy =
            at(below, 0) + 2 * at(below, 1) + at(below, 2) - at(above, 0) - 2 * at(above, 1) - at(above, 2);
        mask[x] = u8::from((gx.unsigned_abs() + gy.unsigned_abs()) / 8 >= MASK_FROM);
        strength[x] = (gx.unsigned_abs() / 4).min(255) as u8;
    }
}

#[cfg(test)]
mod tests;
