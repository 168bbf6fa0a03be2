//! What can be wrong with parameters and with a pair; each variant says what was expected and what was given.

use thiserror::Error;

/// A parameter is out of its range, or two of them contradict each other.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ParamsError {
    /// A number outside its documented range.
    #[error("{name} must be {expected}, got {got}")]
    OutOfRange {
        /// Field name, as in [`Params`](crate::Params).
        name: &'static str,
        /// The accepted range in words.
        expected: &'static str,
        /// The value that was given.
        got: f64,
    },
    /// The image is too small or too large.
    #[error("images must be {min} to {max} px in width and height, got {width_px} x {height_px}")]
    ShapeOutOfRange {
        /// Smallest accepted side in pixels.
        min: usize,
        /// Largest accepted side in pixels.
        max: usize,
        /// Width in pixels that was given.
        width_px: usize,
        /// Height in pixels that was given.
        height_px: usize,
    },
    /// The region of interest is empty or leaves the image.
    #[error(
        "the region of interest {roi:?} must be at least 1 x 1 px and lie inside the {width_px} x {height_px} image"
    )]
    RoiOutsideImage {
        /// The region that was given.
        roi: crate::Roi,
        /// Image width in pixels.
        width_px: usize,
        /// Image height in pixels.
        height_px: usize,
    },
    /// More regions to focus on than there may be.
    #[error("focus must have at most {most} regions, got {got}")]
    TooManyRegions {
        /// The most there may be.
        most: usize,
        /// How many were given.
        got: usize,
    },
    /// A region to focus on is empty, or leaves the image or the region of interest.
    #[error("the focus region {region:?} must be at least 1 x 1 px and lie inside {within:?}")]
    FocusOutside {
        /// The region that was given.
        region: crate::Roi,
        /// The image, or the region of interest.
        within: crate::Roi,
    },
    /// The regions to focus on have more pixels than the image.
    #[error("focus regions must not have more pixels together than the image, {most_px}, got {got_px}")]
    FocusTooLarge {
        /// The image's pixels.
        most_px: usize,
        /// All regions' pixels.
        got_px: usize,
    },
}

/// A pair that can't be matched by this matcher.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum MatchError {
    /// Left and right differ in size.
    #[error("left is {} x {} px but right is {} x {} px: both must have one size", .left.0, .left.1, .right.0, .right.1)]
    SizesDiffer {
        /// Width and height of the left view in pixels.
        left: (usize, usize),
        /// Width and height of the right view in pixels.
        right: (usize, usize),
    },
    /// The pair has another size than the matcher was made for.
    #[error("this matcher was made for {} x {} px, got {} x {} px", .expected.0, .expected.1, .got.0, .got.1)]
    WrongShape {
        /// Width and height in pixels the matcher was made for.
        expected: (usize, usize),
        /// Width and height in pixels of the pair.
        got: (usize, usize),
    },
    /// The buffer is too short for width, height and stride.
    #[error("{height_px} rows of {stride_bytes} bytes ({width_px} px wide) need {needed} bytes, got {got}")]
    BufferTooShort {
        /// Width in pixels.
        width_px: usize,
        /// Height in pixels.
        height_px: usize,
        /// Bytes from one row to the next.
        stride_bytes: usize,
        /// Bytes needed.
        needed: usize,
        /// Bytes given.
        got: usize,
    },
}
