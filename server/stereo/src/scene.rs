//! Images for the tests of the stages.

use crate::census::{Census, Pattern};
use crate::image::GrayView;
use crate::plane::{MARGIN_X, Plane};
use crate::simd::Level;

/// Reproducible noise (xorshift).
pub(crate) struct Noise(u64);

impl Noise {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    /// 0 to `n - 1`.
    pub(crate) fn below(&mut self, n: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        usize::try_from((self.0 >> 16) % n as u64).unwrap()
    }

    pub(crate) fn bytes(&mut self, count: usize, below: usize) -> Vec<u8> {
        (0..count)
            .map(|_| u8::try_from(self.below(below)).unwrap())
            .collect()
    }

    pub(crate) fn words(&mut self, count: usize, below: usize) -> Vec<u16> {
        (0..count)
            .map(|_| u16::try_from(self.below(below)).unwrap())
            .collect()
    }
}

/// A gray image.
pub(crate) struct Image {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pixels: Vec<u8>,
}

impl Image {
    pub(crate) fn from_fn(width: usize, height: usize, pixel: impl Fn(usize, usize) -> u8) -> Self {
        let pixels = (0..width * height)
            .map(|at| pixel(at % width, at / width))
            .collect();
        Self {
            width,
            height,
            pixels,
        }
    }

    /// Random gray levels below `levels`: few of them make many ties.
    pub(crate) fn noise(noise: &mut Noise, width: usize, height: usize, levels: usize) -> Self {
        let pixels = noise.bytes(width * height, levels);
        Self {
            width,
            height,
            pixels,
        }
    }

    /// What a camera `disparity_px(x, y)` to the right sees: the pixel at `x` shows what is at `x + disparity_px` here.
    pub(crate) fn seen_from_the_right(&self, disparity_px: impl Fn(usize, usize) -> usize) -> Self {
        Self::from_fn(self.width, self.height, |x, y| {
            self.at((x + disparity_px(x, y)).cast_signed(), y.cast_signed())
        })
    }

    /// The pixel at column `x`, row `y`; outside, the nearest one.
    pub(crate) fn at(&self, x: isize, y: isize) -> u8 {
        let clamp = |at: isize, n: usize| at.clamp(0, n.cast_signed() - 1).unsigned_abs();
        self.pixels[clamp(y, self.height) * self.width + clamp(x, self.width)]
    }

    pub(crate) fn view(&self) -> GrayView<'_> {
        GrayView::new(&self.pixels, self.width, self.height, self.width).unwrap()
    }

    /// The whole image with margins of that many columns.
    pub(crate) fn padded(&self, margin_left: usize, margin_right: usize) -> Plane {
        let mut plane = Plane::default();
        plane.reshape(self.width, self.height, margin_left, margin_right);
        let rows = 0..plane.padded_height();
        plane.copy_from(&self.view(), (0, 0), rows);
        plane
    }
}

/// Both views of a window, prepared like a frame does it.
pub(crate) struct Views {
    pub(crate) right_image: Plane,
    pub(crate) left: Census,
    pub(crate) right: Census,
}

impl Views {
    /// Columns `x..x + width` of the two images.
    pub(crate) fn of_window(
        pattern: Pattern,
        [left, right]: [&Image; 2],
        (x, width): (usize, usize),
        disparities: usize,
    ) -> Self {
        let far = disparities + MARGIN_X;
        let prepare = |image: &Image, margins: [usize; 2], mirrored: bool| {
            let (mut plane, mut census) = (Plane::default(), Census::default());
            plane.reshape(width, image.height, margins[0], margins[1]);
            let rows = 0..plane.padded_height();
            plane.copy_from(&image.view(), (x.cast_signed(), 0), rows);
            census.reshape(pattern, &plane, plane.height(), mirrored);
            let end = (image.width + margins[0] - x).min(plane.stride());
            census.compute(
                Level::detect(),
                pattern,
                &plane,
                margins[0].saturating_sub(x)..end,
            );
            (plane, census)
        };
        let (_, left) = prepare(left, [MARGIN_X, far], false);
        let (right_image, right) = prepare(right, [far, MARGIN_X], true);
        Self {
            right_image,
            left,
            right,
        }
    }

    pub(crate) fn of(pattern: Pattern, images: [&Image; 2], disparities: usize) -> Self {
        Self::of_window(pattern, images, (0, images[0].width), disparities)
    }
}

/// Byte `plane` of the code of the pixel at column `x`, which may lie in the margins, and row `y + dy`.
pub(crate) fn code(census: &Census, plane: usize, mirrored: bool, x: isize, (y, dy): (usize, i8)) -> u8 {
    let step = if mirrored { -x } else { x };
    census.planes()[plane].row(y, dy)[census.index(0).checked_add_signed(step).unwrap()]
}
