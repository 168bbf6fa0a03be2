//! Image gradient of the left view: the high-gradient mask (the paper's Omega_I) and the strength by which supports are
//! chosen. Epipolar lines are rows, so only the horizontal gradient tells how well a pixel can be matched.

use std::ops::Range;

use crate::plane::Plane;
use crate::simd::{Kernel, Lanes, Level};
use crate::support::Candidate;

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
    /// A row's sums and differences over three rows.
    smooth: Vec<i16>,
    steep: Vec<i16>,
}

impl Gradient {
    pub(crate) fn reshape(&mut self, width: usize, height: usize) {
        self.width = width;
        self.mask.resize(width * height, 0);
        self.strength.resize(width * height, 0);
    }

    /// Both maps from the padded left image.
    pub(crate) fn compute(&mut self, level: Level, image: &Plane, rows: Range<usize>) {
        level.run(Compute {
            gradient: self,
            image,
            rows,
        });
    }

    /// Pixels that need not be tried again: as if they had no gradient.
    pub(crate) fn forget(&mut self, pixels: &[Candidate]) {
        for pixel in pixels {
            self.strength[pixel.y * self.width + pixel.x] = 0;
        }
    }
}

struct Compute<'a> {
    gradient: &'a mut Gradient,
    image: &'a Plane,
    rows: Range<usize>,
}

/// Pixels of one block: plain loops over arrays of this length become vector code.
const BLOCK: usize = 32;

impl Kernel for Compute<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self {
            gradient,
            image,
            rows,
        } = self;
        let (width, from) = (gradient.width, image.margin_left() - 1);
        // Whole blocks: the margin is wider than one.
        let padded = (width + 2).next_multiple_of(BLOCK);
        let (smooth, steep) = (&mut gradient.smooth, &mut gradient.steep);
        smooth.resize(padded, 0);
        steep.resize(padded, 0);
        for y in rows {
            let above = image.row(y, -1)[from..from + padded].as_chunks::<BLOCK>().0;
            let here = image.row(y, 0)[from..from + padded].as_chunks::<BLOCK>().0;
            let below = image.row(y, 1)[from..from + padded].as_chunks::<BLOCK>().0;
            let columns = smooth.as_chunks_mut::<BLOCK>().0.iter_mut();
            let columns = columns.zip(steep.as_chunks_mut::<BLOCK>().0);
            for (block, (smooth, steep)) in columns.enumerate() {
                let (above, here, below) = (&above[block], &here[block], &below[block]);
                for k in 0..BLOCK {
                    smooth[k] = i16::from(above[k]) + 2 * i16::from(here[k]) + i16::from(below[k]);
                    steep[k] = i16::from(below[k]) - i16::from(above[k]);
                }
            }
            let row = y * width..(y + 1) * width;
            let (mask, strength) = (&mut gradient.mask[row.clone()], &mut gradient.strength[row]);
            if width < BLOCK {
                sobel(&smooth[..width + 2], &steep[..width + 2], mask, strength);
                continue;
            }
            // The last block overlaps the one before where the width is no multiple.
            for block in 0..width.div_ceil(BLOCK) {
                let x = (block * BLOCK).min(width - BLOCK);
                let (smooth, steep) = (&smooth[x..][..BLOCK + 2], &steep[x..][..BLOCK + 2]);
                sobel(
                    smooth,
                    steep,
                    &mut mask[x..][..BLOCK],
                    &mut strength[x..][..BLOCK],
                );
            }
        }
    }
}

/// From the columns' sums (1, 2, 1) and differences; they have one more column on each side than the outputs.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "a quarter of at most 1020")]
fn sobel(smooth: &[i16], steep: &[i16], mask: &mut [u8], strength: &mut [u8]) {
    let n = mask.len();
    let (smooth, steep, strength) = (&smooth[..n + 2], &steep[..n + 2], &mut strength[..n]);
    for x in 0..n {
        let gx = (smooth[x + 2] - smooth[x]).unsigned_abs();
        let gy = (steep[x] + 2 * steep[x + 1] + steep[x + 2]).unsigned_abs();
        mask[x] = u8::from((gx + gy) / 8 >= MASK_FROM);
        strength[x] = (gx / 4) as u8;
    }
}

#[cfg(test)]
mod tests;
