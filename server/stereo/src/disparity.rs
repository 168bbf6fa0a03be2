//! The result map: fixed-point disparity and an 8-bit confidence for every pixel of the left view.

use crate::image::Shape;

/// Steps of the fixed-point disparity in one pixel: values are in 1/64 px.
pub const FIXED_PER_PX: u16 = 64;

/// Disparity and confidence of every pixel of the left view, row by row without padding.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DisparityMap {
    shape: Shape,
    fixed: Vec<u16>,
    confidence: Vec<u8>,
}

impl DisparityMap {
    /// An all-invalid map of `shape`; allocates 3 bytes a pixel.
    #[must_use]
    pub fn new(shape: Shape) -> Self {
        Self {
            shape,
            fixed: vec![0; shape.area_px()],
            confidence: vec![0; shape.area_px()],
        }
    }

    /// Makes the map all-invalid and of `shape`, keeping its memory where that is large enough.
    pub fn reset(&mut self, shape: Shape) {
        self.shape = shape;
        self.fixed.clear();
        self.fixed.resize(shape.area_px(), 0);
        self.confidence.clear();
        self.confidence.resize(shape.area_px(), 0);
    }

    /// Width and height.
    #[must_use]
    pub fn shape(&self) -> Shape {
        self.shape
    }

    /// Disparities in 1/64 px ([`FIXED_PER_PX`]), 0 = invalid; a valid disparity under 1/64 px is stored as 1.
    #[must_use]
    pub fn fixed(&self) -> &[u16] {
        &self.fixed
    }

    /// Confidence of every pixel: 0 for invalid or unvalidated ones, up to 254.
    #[must_use]
    pub fn confidence(&self) -> &[u8] {
        &self.confidence
    }

    /// Both maps, for writing.
    pub fn parts_mut(&mut self) -> (&mut [u16], &mut [u8]) {
        (&mut self.fixed, &mut self.confidence)
    }

    /// Disparity at column `x`, row `y` in pixels, `None` where invalid or outside.
    #[must_use]
    pub fn disparity_px(&self, x: usize, y: usize) -> Option<f32> {
        if x >= self.shape.width_px() {
            return None;
        }
        let fixed = *self.fixed.get(y * self.shape.width_px() + x)?;
        (fixed > 0).then(|| px_from_fixed(fixed))
    }

    /// All disparities in pixels, NaN where invalid.
    pub fn iter_px(&self) -> impl Iterator<Item = f32> + '_ {
        self.fixed
            .iter()
            .map(|&fixed| if fixed > 0 { px_from_fixed(fixed) } else { f32::NAN })
    }
}

fn px_from_fixed(fixed: u16) -> f32 {
    f32::from(fixed) / f32::from(FIXED_PER_PX)
}
