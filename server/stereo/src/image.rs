//! Views of gray images, their shape, and regions of them. Views borrow: no pixel is copied here.

use crate::error::{MatchError, ParamsError};

/// Width and height of the images a matcher works on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Shape {
    width_px: usize,
    height_px: usize,
}

impl Shape {
    /// Smallest accepted width and height in pixels.
    pub const MIN_SIDE_PX: usize = 32;
    /// Largest accepted width and height in pixels.
    pub const MAX_SIDE_PX: usize = 4096;

    /// A shape of `width_px` x `height_px`.
    ///
    /// # Errors
    /// [`ParamsError::ShapeOutOfRange`] unless both sides are 32 to 4096 px.
    pub fn new(width_px: usize, height_px: usize) -> Result<Self, ParamsError> {
        let range = Self::MIN_SIDE_PX..=Self::MAX_SIDE_PX;
        if range.contains(&width_px) && range.contains(&height_px) {
            Ok(Self { width_px, height_px })
        } else {
            Err(ParamsError::ShapeOutOfRange {
                min: Self::MIN_SIDE_PX,
                max: Self::MAX_SIDE_PX,
                width_px,
                height_px,
            })
        }
    }

    /// Width in pixels.
    #[must_use]
    pub fn width_px(self) -> usize {
        self.width_px
    }

    /// Height in pixels.
    #[must_use]
    pub fn height_px(self) -> usize {
        self.height_px
    }

    /// Number of pixels.
    #[must_use]
    pub fn area_px(self) -> usize {
        self.width_px * self.height_px
    }
}

/// A rectangle of pixels: columns `x..x + width`, rows `y..y + height`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Roi {
    /// Leftmost column in pixels.
    pub x: usize,
    /// Topmost row in pixels.
    pub y: usize,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
}

impl Roi {
    /// The whole image.
    #[must_use]
    pub fn full(shape: Shape) -> Self {
        Self {
            x: 0,
            y: 0,
            width: shape.width_px(),
            height: shape.height_px(),
        }
    }

    /// Number of pixels.
    #[must_use]
    pub fn area_px(&self) -> usize {
        self.width.saturating_mul(self.height)
    }

    /// Whether all of it is inside `other`; both lie in one image.
    #[must_use]
    pub fn lies_in_region(&self, other: Self) -> bool {
        let fits =
            |from: usize, length: usize, first: usize, n: usize| from >= first && from + length <= first + n;
        fits(self.x, self.width, other.x, other.width) && fits(self.y, self.height, other.y, other.height)
    }

    /// Whether it has at least one pixel and none outside an image of `shape`.
    #[must_use]
    pub fn lies_in(&self, shape: Shape) -> bool {
        let fits = |from: usize, length: usize, n: usize| {
            length > 0 && from.checked_add(length).is_some_and(|end| end <= n)
        };
        fits(self.x, self.width, shape.width_px()) && fits(self.y, self.height, shape.height_px())
    }
}

/// An 8-bit gray image, row by row, `stride_bytes` apart.
#[derive(Debug, Clone, Copy)]
pub struct GrayView<'a> {
    data: &'a [u8],
    width_px: usize,
    height_px: usize,
    stride_bytes: usize,
}

impl<'a> GrayView<'a> {
    /// A view of `data`: `height_px` rows of `width_px` bytes, one every `stride_bytes`.
    ///
    /// # Errors
    /// [`MatchError::BufferTooShort`] if `stride_bytes < width_px` or `data` ends before the last row does.
    pub fn new(
        data: &'a [u8],
        width_px: usize,
        height_px: usize,
        stride_bytes: usize,
    ) -> Result<Self, MatchError> {
        let needed = match height_px {
            0 => Some(0),
            rows => stride_bytes
                .checked_mul(rows - 1)
                .and_then(|n| n.checked_add(width_px)),
        };
        if stride_bytes < width_px || needed.is_none_or(|n| data.len() < n) {
            return Err(MatchError::BufferTooShort {
                width_px,
                height_px,
                stride_bytes,
                needed: needed
                    .unwrap_or(usize::MAX)
                    .max(width_px.saturating_mul(height_px)),
                got: data.len(),
            });
        }
        Ok(Self {
            data,
            width_px,
            height_px,
            stride_bytes,
        })
    }

    /// Width in pixels.
    #[must_use]
    pub fn width_px(&self) -> usize {
        self.width_px
    }

    /// Height in pixels.
    #[must_use]
    pub fn height_px(&self) -> usize {
        self.height_px
    }

    /// The pixels of row `y`.
    ///
    /// # Panics
    /// If `y >= height_px`.
    #[must_use]
    pub fn row(&self, y: usize) -> &'a [u8] {
        &self.data[y * self.stride_bytes..][..self.width_px]
    }
}

/// A rectified pair: row `y` of the left view and row `y` of the right view see the same points, and a point at column
/// `x_left` is at `x_right = x_left - disparity`, `disparity >= 0`.
#[derive(Debug, Clone, Copy)]
pub struct StereoPair<'a> {
    left: GrayView<'a>,
    right: GrayView<'a>,
}

impl<'a> StereoPair<'a> {
    /// A pair of two views of one size.
    ///
    /// # Errors
    /// [`MatchError::SizesDiffer`].
    pub fn new(left: GrayView<'a>, right: GrayView<'a>) -> Result<Self, MatchError> {
        let size = |view: &GrayView<'_>| (view.width_px, view.height_px);
        if size(&left) == size(&right) {
            Ok(Self { left, right })
        } else {
            Err(MatchError::SizesDiffer {
                left: size(&left),
                right: size(&right),
            })
        }
    }

    /// The left view: disparities and the mesh are in its pixels.
    #[must_use]
    pub fn left(&self) -> GrayView<'a> {
        self.left
    }

    /// The right view.
    #[must_use]
    pub fn right(&self) -> GrayView<'a> {
        self.right
    }
}
