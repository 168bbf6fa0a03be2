//! Small real files, made here or by libjpeg (`testdata`), whole and damaged.

mod files;
mod hostile;

use bytes::Bytes;

use super::{GrayScratch, Side, color, gray, inspect};
use crate::job::{ImageData, ImageEncoding, PixelFormat};
use crate::status::ServiceError;

/// An image file as a transport hands it on.
fn file(data: &[u8]) -> Result<ImageData, ServiceError> {
    let (encoding, width_px, height_px) = inspect(Side::Left, data)?;
    let data = Bytes::copy_from_slice(data);
    Ok(ImageData {
        encoding,
        width_px,
        height_px,
        step_bytes: 0,
        frame_id: String::new(),
        data,
    })
}

fn raw(format: PixelFormat, width_px: u32, height_px: u32, step_bytes: u32, data: &[u8]) -> ImageData {
    ImageData {
        encoding: ImageEncoding::Raw(format),
        width_px,
        height_px,
        step_bytes,
        frame_id: String::new(),
        data: Bytes::copy_from_slice(data),
    }
}

/// All gray pixels without padding.
fn gray_pixels(image: &ImageData) -> Result<Vec<u8>, ServiceError> {
    let mut scratch = GrayScratch::default();
    let view = gray(Side::Left, image, &mut scratch)?;
    assert_eq!(
        (view.width_px(), view.height_px()),
        (image.width_px as usize, image.height_px as usize)
    );
    Ok((0..view.height_px()).flat_map(|y| view.row(y).to_vec()).collect())
}

#[test]
fn raw_mono8_is_viewed_in_place_with_its_stride() {
    let data: Vec<u8> = (0..33 * 40 + 32)
        .map(|i| u8::try_from(i % 251).unwrap())
        .collect();
    let image = raw(PixelFormat::Mono8, 32, 34, 40, &data);
    let mut scratch = GrayScratch::default();
    let view = gray(Side::Left, &image, &mut scratch).unwrap();
    assert_eq!(view.row(0).as_ptr(), image.data.as_ptr(), "not a byte is copied");
    assert_eq!(view.row(33), &data[33 * 40..][..32]);
    assert_eq!(scratch.gray.capacity(), 0);
}

#[test]
fn the_other_raw_formats_honour_their_stride() {
    let bytes_per_px = [
        (PixelFormat::Mono16, 2),
        (PixelFormat::Rgb8, 3),
        (PixelFormat::Bgr8, 3),
        (PixelFormat::Rgba8, 4),
        (PixelFormat::Bgra8, 4),
    ];
    for (format, bytes) in bytes_per_px {
        let step = 34 * bytes + 5;
        let mut data = vec![0xee; step * 31 + 34 * bytes];
        for y in 0..32 {
            data[y * step..][..34 * bytes].fill(u8::try_from(y * 8).unwrap());
        }
        let image = raw(format, 34, 32, u32::try_from(step).unwrap(), &data);
        let expected: Vec<u8> = (0..32).flat_map(|y| [y * 8; 34]).collect();
        assert_eq!(gray_pixels(&image).unwrap(), expected, "{format:?}");
        let colours = color(Side::Left, &image).unwrap();
        assert_eq!((colours.width_px, colours.height_px), (34, 32));
        assert_eq!(colours.nearest(33.4, 31.0), [248; 3], "{format:?}");
        assert_eq!(colours.nearest(-1.0, f32::NAN), [0; 3], "outside is the border");
    }
}

#[test]
fn sixteen_bit_words_count_from_the_highest_bit_in_use() {
    let values: Vec<u16> = (0..32 * 32).map(|i| i * 61 % 256).collect();
    let expected: Vec<u8> = values.iter().map(|v| u8::try_from(*v).unwrap()).collect();
    for bits in [8, 10, 12, 14, 16] {
        let noise = (1 << (bits - 8)) / 2;
        let words = values.iter().map(|value| (value << (bits - 8)) + noise);
        let data: Vec<u8> = words.flat_map(u16::to_le_bytes).collect();
        let image = raw(PixelFormat::Mono16, 32, 32, 64, &data);
        assert_eq!(gray_pixels(&image).unwrap(), expected, "{bits} bits");
        let colours = color(Side::Left, &image).unwrap().rgb;
        assert!(
            colours
                .as_chunks::<3>()
                .0
                .iter()
                .zip(&expected)
                .all(|(rgb, gray)| rgb == &[*gray; 3])
        );
    }
}

#[test]
fn raw_images_that_are_too_short_or_contradict_themselves_are_refused_by_name() {
    let cases = [
        raw(PixelFormat::Mono8, 32, 32, 32, &[0; 32 * 32 - 1]),
        raw(PixelFormat::Rgb8, 32, 32, 96, &[0; 32 * 96 - 1]),
        raw(PixelFormat::Mono8, 32, 32, 31, &[0; 32 * 32]),
        raw(PixelFormat::Rgba8, 32, 32, 96, &[0; 32 * 128]),
        raw(PixelFormat::Yuyv, 33, 32, 66, &[0; 32 * 66]),
        raw(PixelFormat::Bgr8, 4096, 4096, u32::MAX, &[0; 100]),
    ];
    for image in cases {
        let mut scratch = GrayScratch::default();
        let error = gray(Side::Right, &image, &mut scratch).unwrap_err();
        assert!(matches!(error, ServiceError::Invalid(_)), "{error}");
        assert!(error.to_string().contains("the right image"), "{error}");
        assert!(color(Side::Right, &image).is_err());
    }
}

#[test]
fn shapes_that_cannot_be_matched_are_refused_before_memory_is_taken() {
    for (width, height) in [
        (0, 32),
        (32, 0),
        (5000, 32),
        (u32::MAX, u32::MAX),
        (100_000, 100_000),
    ] {
        for format in [PixelFormat::Mono8, PixelFormat::Rgb8] {
            let image = raw(format, width, height, u32::MAX, &[0; 64]);
            let mut scratch = GrayScratch::default();
            let error = gray(Side::Left, &image, &mut scratch).unwrap_err();
            assert!(matches!(error, ServiceError::Unmatchable(_)), "{error}");
            assert_eq!(scratch.gray.capacity(), 0);
        }
    }
}

#[test]
fn a_smaller_image_after_a_larger_one_is_its_own() {
    let mut scratch = GrayScratch::default();
    let large = raw(PixelFormat::Rgb8, 64, 64, 192, &[200; 64 * 192]);
    gray(Side::Left, &large, &mut scratch).unwrap();
    let small = raw(PixelFormat::Rgb8, 32, 32, 96, &[10; 32 * 96]);
    let memory = scratch.gray.as_ptr();
    let view = gray(Side::Left, &small, &mut scratch).unwrap();
    assert!((0..32).all(|y| view.row(y) == [10; 32]));
    assert_eq!(
        view.row(0).as_ptr(),
        memory,
        "the memory is kept from frame to frame"
    );
}
