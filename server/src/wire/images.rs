//! Images of a request: whether what is said about them can be true, before any pixel is read.

use stereo::Shape;
use stereo_proto::v1;

use crate::decode::{self, Side};
use crate::job::{ImageData, ImageEncoding, PixelFormat};
use crate::status::ServiceError;

/// Longest frame of reference in bytes.
const MAX_FRAME_ID_BYTES: usize = 128;

/// Both images, of one size that can be matched. `max_image_px` bounds the pixels of each.
pub(super) fn pair(
    left: Option<v1::Image>,
    right: Option<v1::Image>,
    max_image_px: u64,
) -> Result<(ImageData, ImageData, Shape), ServiceError> {
    let left = image(Side::Left, left)?;
    let right = image(Side::Right, right)?;
    let shape = shape(Side::Left, &left, max_image_px)?;
    if shape != self::shape(Side::Right, &right, max_image_px)? {
        return Err(ServiceError::Unmatchable(format!(
            "left is {} x {} px but right is {} x {} px: send a rectified pair of one size",
            left.width_px, left.height_px, right.width_px, right.height_px
        )));
    }
    Ok((left, right, shape))
}

/// One image with its true size and step.
fn image(side: Side, image: Option<v1::Image>) -> Result<ImageData, ServiceError> {
    let image = image
        .filter(|image| *image != v1::Image::default())
        .ok_or_else(|| {
            ServiceError::Invalid(format!("the {side} image is missing: send both left and right"))
        })?;
    if image.frame_id.len() > MAX_FRAME_ID_BYTES {
        return Err(ServiceError::Invalid(format!(
            "the {side} image's frame_id must be at most {MAX_FRAME_ID_BYTES} bytes, got {}",
            image.frame_id.len()
        )));
    }
    let encoding = encoding(side, image.encoding)?;
    let (width_px, height_px, step_bytes) = match encoding {
        ImageEncoding::Raw(format) => (image.width, image.height, raw_step(side, &image, format)?),
        ImageEncoding::Png | ImageEncoding::Jpeg => file_size(side, &image, encoding)?,
    };
    Ok(ImageData {
        encoding,
        width_px,
        height_px,
        step_bytes,
        frame_id: image.frame_id,
        data: image.data,
    })
}

fn encoding(side: Side, value: i32) -> Result<ImageEncoding, ServiceError> {
    use v1::ImageEncoding as Wire;
    Ok(match Wire::try_from(value) {
        Ok(Wire::Mono8) => ImageEncoding::Raw(PixelFormat::Mono8),
        Ok(Wire::Mono16) => ImageEncoding::Raw(PixelFormat::Mono16),
        Ok(Wire::Rgb8) => ImageEncoding::Raw(PixelFormat::Rgb8),
        Ok(Wire::Bgr8) => ImageEncoding::Raw(PixelFormat::Bgr8),
        Ok(Wire::Rgba8) => ImageEncoding::Raw(PixelFormat::Rgba8),
        Ok(Wire::Bgra8) => ImageEncoding::Raw(PixelFormat::Bgra8),
        Ok(Wire::Yuyv) => ImageEncoding::Raw(PixelFormat::Yuyv),
        Ok(Wire::Png) => ImageEncoding::Png,
        Ok(Wire::Jpeg) => ImageEncoding::Jpeg,
        Ok(Wire::Unspecified) | Err(_) => {
            return Err(ServiceError::Invalid(format!(
                "the {side} image's encoding must be mono8, mono16, rgb8, bgr8, rgba8, bgra8, yuyv, png or jpeg, got \
                 {}",
                if value == 0 {
                    "none".to_owned()
                } else {
                    format!("the unknown value {value}")
                }
            )));
        }
    })
}

/// Bytes from one row to the next, if width, height, step and the length of the data agree.
fn raw_step(side: Side, image: &v1::Image, format: PixelFormat) -> Result<u32, ServiceError> {
    let refuse = |problem: String| {
        Err(ServiceError::Invalid(format!(
            "the {side} image can't be read: {problem}"
        )))
    };
    if format == PixelFormat::Yuyv && !image.width.is_multiple_of(2) {
        return refuse(format!(
            "yuyv holds pixels in pairs, so its width must be even, got {} px",
            image.width
        ));
    }
    let row_bytes = u64::from(image.width) * bytes_per_px(format);
    let step = if image.step == 0 {
        row_bytes
    } else {
        u64::from(image.step)
    };
    if step < row_bytes {
        return refuse(format!(
            "its step is {step} bytes but a row of {} px needs {row_bytes}",
            image.width
        ));
    }
    let rows = u64::from(image.height);
    let most = step.saturating_mul(rows);
    let least = if rows == 0 {
        0
    } else {
        most.saturating_sub(step - row_bytes)
    };
    let got = image.data.len() as u64;
    if !(least..=most).contains(&got) {
        return refuse(format!(
            "{} x {rows} px with a step of {step} bytes are {least} bytes of data, got {got}: send all rows and correct \
             width, height, step and encoding",
            image.width
        ));
    }
    match u32::try_from(step) {
        Ok(step) => Ok(step),
        Err(_) => refuse(format!("rows of {step} bytes are too long")),
    }
}

fn bytes_per_px(format: PixelFormat) -> u64 {
    match format {
        PixelFormat::Mono8 => 1,
        PixelFormat::Mono16 | PixelFormat::Yuyv => 2,
        PixelFormat::Rgb8 | PixelFormat::Bgr8 => 3,
        PixelFormat::Rgba8 | PixelFormat::Bgra8 => 4,
    }
}

/// Width and height by the file's header, and a step of 0, if nothing else was said.
fn file_size(side: Side, image: &v1::Image, said: ImageEncoding) -> Result<(u32, u32, u32), ServiceError> {
    let (found, width, height) = decode::inspect(side, &image.data)?;
    if found != said {
        return Err(ServiceError::Invalid(format!(
            "the {side} image is said to be {said:?} but is a {found:?} file: correct its encoding"
        )));
    }
    let agrees = |said: u32, is: u32| said == 0 || said == is;
    if !agrees(image.width, width) || !agrees(image.height, height) || image.step != 0 {
        return Err(ServiceError::Invalid(format!(
            "the {side} image is said to be {} x {} px with a step of {}, but its file is {width} x {height} px: leave \
             width, height and step at 0 for PNG and JPEG",
            image.width, image.height, image.step
        )));
    }
    Ok((width, height, 0))
}

fn shape(side: Side, image: &ImageData, max_image_px: u64) -> Result<Shape, ServiceError> {
    let (width_px, height_px) = (image.width_px, image.height_px);
    if u64::from(width_px) * u64::from(height_px) > max_image_px {
        return Err(ServiceError::TooLarge(format!(
            "the {side} image is {width_px} x {height_px} px but this server takes at most {max_image_px} pixels: send \
             it smaller"
        )));
    }
    Shape::new(width_px as usize, height_px as usize)
        .map_err(|why| ServiceError::Unmatchable(format!("the {side} image can't be matched: {why}")))
}

#[cfg(test)]
mod tests;
