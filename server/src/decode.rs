//! Images in: file headers before any work, and pixels to the gray views the core matches.
//!
//! Pixels are taken as they lie in the file or buffer: rectified images have no orientation but their own, so EXIF's
//! is ignored, and so are colour profiles, alpha and animation frames after the first.

mod deep;
mod jpeg;
mod pixels;
mod png;

use std::fmt;

use stereo::{GrayView, Shape};

use self::deep::Deep;
use self::pixels::Layout;
use crate::job::{ImageData, ImageEncoding, PixelFormat};
use crate::status::ServiceError;

/// Which image of the pair is meant; errors name it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The left image.
    Left,
    /// The right image.
    Right,
}

impl fmt::Display for Side {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Left => "left",
            Self::Right => "right",
        })
    }
}

/// Memory for decoding one image, kept by its worker from frame to frame; as large as the largest image it has seen.
#[derive(Debug, Default)]
pub struct GrayScratch {
    gray: Vec<u8>,
    colour: Vec<u8>,
}

/// An image in colour: three bytes a pixel (red, green, blue), row by row without padding.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ColorImage {
    /// Width in pixels.
    pub width_px: usize,
    /// Height in pixels.
    pub height_px: usize,
    /// The pixels.
    pub rgb: Vec<u8>,
}

impl ColorImage {
    /// The colour of the pixel nearest to column `u_px`, row `v_px`, at the border the border's.
    #[must_use]
    pub fn nearest(&self, u_px: f32, v_px: f32) -> [u8; 3] {
        let (x, y) = (
            nearest_index(u_px, self.width_px),
            nearest_index(v_px, self.height_px),
        );
        self.rgb.as_chunks::<3>().0[y * self.width_px + x]
    }
}

/// What `file` is by its first bytes (PNG or JPEG), and its width and height in px by its header. Allocates nothing
/// that grows with the size it claims.
///
/// # Errors
/// [`ServiceError::Invalid`] if it is neither or its header is damaged or empty, [`ServiceError::TooLarge`] if it
/// claims more pixels than can ever be matched. Limits below that are the caller's.
pub fn inspect(side: Side, file: &[u8]) -> Result<(ImageEncoding, u32, u32), ServiceError> {
    let (encoding, size) = if file.starts_with(b"\x89PNG\r\n\x1a\n") {
        (ImageEncoding::Png, png::size_px(file))
    } else if file.starts_with(b"\xff\xd8\xff") {
        (ImageEncoding::Jpeg, jpeg::size_px(file))
    } else {
        return Err(ServiceError::Invalid(format!(
            "the {side} image ({} bytes) is neither a PNG nor a JPEG file: send one of them, or raw pixels with their \
             encoding, width and height",
            file.len()
        )));
    };
    let (width_px, height_px) = size.map_err(|why| damaged(side, encoding, &why))?;
    let max = Shape::MAX_SIDE_PX;
    if u64::from(width_px) * u64::from(height_px) > (max * max) as u64 {
        return Err(ServiceError::TooLarge(format!(
            "the {side} image's header says {width_px} x {height_px} px, at most {max} x {max} are accepted: send it \
             smaller"
        )));
    }
    Ok((encoding, width_px, height_px))
}

/// `image` as 8-bit gray. Raw mono8 is viewed in place; everything else is written to `scratch`: colours as BT.601
/// luma, 16-bit values by the eight highest bits that the image uses (a 12-bit camera's count for as much as a full
/// range), YUYV and JPEG by their own luma.
///
/// # Errors
/// [`ServiceError::Invalid`] naming the image if its data are too short, damaged, or not what was said about them,
/// [`ServiceError::Unmatchable`] if a side is longer than 4096 px. Memory is bounded by that size, whatever the file
/// says.
pub fn gray<'a>(
    side: Side,
    image: &'a ImageData,
    scratch: &'a mut GrayScratch,
) -> Result<GrayView<'a>, ServiceError> {
    let (width_px, height_px) = checked_size(side, image)?;
    let (data, stride_bytes) = match image.encoding {
        ImageEncoding::Raw(PixelFormat::Mono8) => {
            check_raw(side, image, Layout::Raw(PixelFormat::Mono8))?;
            (image.data.as_ref(), image.step_bytes as usize)
        }
        _ => {
            let GrayScratch { gray, colour } = scratch;
            gray.resize(width_px * height_px, 0);
            if image.encoding == ImageEncoding::Jpeg {
                jpeg::read_gray(&image.data, (image.width_px, image.height_px), gray, colour)
                    .map_err(|why| damaged(side, image.encoding, &why))?;
            } else {
                let mut deep = Deep::in_memory(colour);
                for_each_row(side, image, |y, layout, row| {
                    if layout == Deep::LAYOUT {
                        deep.push(&row[..2 * width_px]);
                    } else {
                        layout.write_gray(row, &mut gray[y * width_px..][..width_px]);
                    }
                })?;
                Deep::LAYOUT.write_gray(deep.into_full_range(), gray);
            }
            (gray.as_slice(), width_px)
        }
    };
    GrayView::new(data, width_px, height_px, stride_bytes)
        .map_err(|why| ServiceError::Invalid(format!("the {side} image: {why}")))
}

/// What [`gray`] made of `image`: a view of `scratch`, or of the image itself. Nothing is decoded.
///
/// # Errors
/// As [`gray`]; [`ServiceError::Internal`] if `scratch` doesn't hold this image.
pub fn decoded<'a>(
    side: Side,
    image: &'a ImageData,
    scratch: &'a GrayScratch,
) -> Result<GrayView<'a>, ServiceError> {
    let (width_px, height_px) = checked_size(side, image)?;
    let (data, stride_bytes) = match image.encoding {
        ImageEncoding::Raw(PixelFormat::Mono8) => (image.data.as_ref(), image.step_bytes as usize),
        _ => (scratch.gray.as_slice(), width_px),
    };
    GrayView::new(data, width_px, height_px, stride_bytes)
        .map_err(|why| ServiceError::Internal(format!("the {side} image was not decoded: {why}")))
}

/// `image` in colour, for textures; gray is repeated. Allocates three bytes a pixel.
///
/// # Errors
/// As [`gray`].
pub fn color(side: Side, image: &ImageData) -> Result<ColorImage, ServiceError> {
    let (width_px, height_px) = checked_size(side, image)?;
    let mut rgb = vec![0; width_px * height_px * 3];
    if image.encoding == ImageEncoding::Jpeg {
        jpeg::read_rgb(&image.data, (image.width_px, image.height_px), &mut rgb)
            .map_err(|why| damaged(side, image.encoding, &why))?;
    } else {
        let row_bytes = width_px * 3;
        let mut memory = Vec::new();
        let mut deep = Deep::in_memory(&mut memory);
        for_each_row(side, image, |y, layout, row| {
            if layout == Deep::LAYOUT {
                deep.push(&row[..2 * width_px]);
            } else {
                layout.write_rgb(row, &mut rgb[y * row_bytes..][..row_bytes]);
            }
        })?;
        Deep::LAYOUT.write_rgb(deep.into_full_range(), &mut rgb);
    }
    Ok(ColorImage {
        width_px,
        height_px,
        rgb,
    })
}

/// Rows of a raw image or a PNG file, from the top.
fn for_each_row(
    side: Side,
    image: &ImageData,
    mut each: impl FnMut(usize, Layout, &[u8]),
) -> Result<(), ServiceError> {
    let ImageEncoding::Raw(format) = image.encoding else {
        return png::for_each_row(&image.data, (image.width_px, image.height_px), each)
            .map_err(|why| damaged(side, image.encoding, &why));
    };
    let layout = Layout::Raw(format);
    let row_bytes = check_raw(side, image, layout)?;
    for y in 0..image.height_px as usize {
        each(
            y,
            layout,
            &image.data[y * image.step_bytes as usize..][..row_bytes],
        );
    }
    Ok(())
}

/// Width and height, which must be those of a shape the core knows: they bound every allocation here.
fn checked_size(side: Side, image: &ImageData) -> Result<(usize, usize), ServiceError> {
    let size = (image.width_px as usize, image.height_px as usize);
    Shape::new(size.0, size.1)
        .map(|_| size)
        .map_err(|why| ServiceError::Unmatchable(format!("the {side} image can't be matched: {why}")))
}

/// Bytes of a row, if step and length of the data hold all rows. Transports have said more precisely what is wrong.
fn check_raw(side: Side, image: &ImageData, layout: Layout) -> Result<usize, ServiceError> {
    let &ImageData {
        width_px,
        height_px,
        step_bytes,
        ..
    } = image;
    let row_bytes = width_px as usize * layout.bytes_per_px();
    let last_row_at = (height_px as usize).saturating_sub(1) * step_bytes as usize;
    let in_pairs = layout != Layout::Raw(PixelFormat::Yuyv) || width_px.is_multiple_of(2);
    if in_pairs && step_bytes as usize >= row_bytes && image.data.len() >= last_row_at + row_bytes {
        return Ok(row_bytes);
    }
    Err(ServiceError::Invalid(format!(
        "the {side} image's {} bytes with a step of {step_bytes} can't be {width_px} x {height_px} px of {:?}: correct \
         its size, step and encoding, and send all rows",
        image.data.len(),
        image.encoding
    )))
}

fn damaged(side: Side, encoding: ImageEncoding, why: &str) -> ServiceError {
    let kind = if encoding == ImageEncoding::Png {
        "PNG"
    } else {
        "JPEG"
    };
    ServiceError::Invalid(format!(
        "the {side} {kind} file can't be decoded ({why}): send it whole and undamaged"
    ))
}

/// The whole number nearest to `at` in `0..len`.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "rounded and clamped to the image first"
)]
fn nearest_index(at: f32, len: usize) -> usize {
    (at.round().max(0.0) as usize).min(len - 1)
}

#[cfg(test)]
mod tests;
