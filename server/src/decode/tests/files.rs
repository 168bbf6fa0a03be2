//! Whole files of every kind.

use std::io::Cursor;

use image::{DynamicImage, GrayImage, ImageFormat, Rgb, RgbImage};

use super::{color, file, gray_pixels};
use crate::decode::{Side, inspect};
use crate::job::ImageEncoding;
use crate::status::ServiceError;

const BASELINE_420: &[u8] = include_bytes!("../testdata/baseline_420.jpg");
const BASELINE_422_RESTART: &[u8] = include_bytes!("../testdata/baseline_422_restart.jpg");
pub(super) const PROGRESSIVE_420: &[u8] = include_bytes!("../testdata/progressive_420.jpg");
const CMYK: &[u8] = include_bytes!("../testdata/cmyk.jpg");

/// A smooth colour image of an odd size.
pub(super) fn picture() -> RgbImage {
    let byte = |value: u32| u8::try_from(value % 256).unwrap();
    RgbImage::from_fn(45, 37, |x, y| {
        Rgb([byte(x * 4 + 20), byte(y * 6 + 10), byte(x + y * 2)])
    })
}

pub(super) fn written(picture: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    picture.write_to(&mut file, format).unwrap();
    file.into_inner()
}

/// A PNG of 40 x 36 px by the `png` crate, for what the image crate doesn't write.
fn png_40_by_36(color: png::ColorType, depth: png::BitDepth, data: &[u8]) -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, 40, 36);
    encoder.set_color(color);
    encoder.set_depth(depth);
    if color == png::ColorType::Indexed {
        encoder.set_palette(vec![10, 10, 10, 250, 250, 250]);
    }
    encoder.write_header().unwrap().write_image_data(data).unwrap();
    file
}

fn luma(pixel: [u8; 3]) -> f64 {
    0.299 * f64::from(pixel[0]) + 0.587 * f64::from(pixel[1]) + 0.114 * f64::from(pixel[2])
}

fn largest_difference(gray: &[u8], expected: impl Iterator<Item = f64>) -> f64 {
    gray.iter()
        .zip(expected)
        .map(|(&g, e)| (f64::from(g) - e).abs())
        .fold(0.0, f64::max)
}

#[test]
fn the_content_says_what_a_file_is_and_its_header_how_large() {
    let picture = DynamicImage::from(picture());
    let png = written(&picture, ImageFormat::Png);
    assert_eq!(inspect(Side::Left, &png).unwrap(), (ImageEncoding::Png, 45, 37));
    assert_eq!(
        inspect(Side::Left, &png[..33]).unwrap(),
        (ImageEncoding::Png, 45, 37),
        "the header is enough"
    );
    let jpeg = written(&picture, ImageFormat::Jpeg);
    assert_eq!(inspect(Side::Left, &jpeg).unwrap(), (ImageEncoding::Jpeg, 45, 37));
    for other in [&b""[..], b"GIF89a", b"\x89PNG", b"\xff\xd8", b"<html>"] {
        let error = inspect(Side::Right, other).unwrap_err();
        assert!(matches!(error, ServiceError::Invalid(_)));
        assert!(error.to_string().starts_with("the right image"), "{error}");
    }
}

#[test]
fn gray_png_files_come_through_unchanged() {
    let gray = GrayImage::from_fn(45, 37, |x, y| {
        image::Luma([u8::try_from((x * 7 + y * 3) % 256).unwrap()])
    });
    let png = written(&DynamicImage::from(gray.clone()), ImageFormat::Png);
    assert_eq!(gray_pixels(&file(&png).unwrap()).unwrap(), gray.into_raw());
}

#[test]
fn colour_png_files_become_luma_with_or_without_alpha() {
    let picture = picture();
    let opaque = DynamicImage::from(picture.clone());
    for variant in [
        opaque.clone(),
        DynamicImage::from(opaque.to_rgba8()),
        DynamicImage::from(opaque.to_rgb16()),
    ] {
        let image = file(&written(&variant, ImageFormat::Png)).unwrap();
        let gray = gray_pixels(&image).unwrap();
        assert!(largest_difference(&gray, picture.pixels().map(|p| luma(p.0))) <= 1.0);
        assert_eq!(color(Side::Left, &image).unwrap().rgb, *picture.as_raw());
    }
}

#[test]
fn sixteen_bit_png_files_count_from_the_highest_bit_in_use() {
    for bits in [12, 16] {
        let words = (0..40 * 36_u16).map(|i| (i * 45) >> (16 - bits));
        let data: Vec<u8> = words.clone().flat_map(u16::to_be_bytes).collect();
        let png = png_40_by_36(png::ColorType::Grayscale, png::BitDepth::Sixteen, &data);
        let expected: Vec<u8> = words
            .map(|word| u8::try_from(word >> (bits - 8)).unwrap())
            .collect();
        assert_eq!(
            gray_pixels(&file(&png).unwrap()).unwrap(),
            expected,
            "{bits} bits"
        );
    }
}

#[test]
fn one_bit_palette_and_gray_alpha_png_files_are_expanded() {
    let bits = vec![0b1010_1010; 5 * 36];
    let gray = png_40_by_36(png::ColorType::Grayscale, png::BitDepth::One, &bits);
    assert_eq!(gray_pixels(&file(&gray).unwrap()).unwrap()[..4], [255, 0, 255, 0]);
    let palette = png_40_by_36(png::ColorType::Indexed, png::BitDepth::One, &bits);
    assert_eq!(
        gray_pixels(&file(&palette).unwrap()).unwrap()[..4],
        [250, 10, 250, 10]
    );
    let pairs: Vec<u8> = (0..40 * 36)
        .flat_map(|i| [u8::try_from(i % 256).unwrap(), 3])
        .collect();
    let alpha = file(&png_40_by_36(
        png::ColorType::GrayscaleAlpha,
        png::BitDepth::Eight,
        &pairs,
    ))
    .unwrap();
    assert_eq!(gray_pixels(&alpha).unwrap()[..4], [0, 1, 2, 3]);
    assert_eq!(color(Side::Left, &alpha).unwrap().nearest(7.0, 0.0), [7; 3]);
}

#[test]
fn interlaced_png_files_are_put_in_order() {
    let interlaced: &[u8] = include_bytes!("../testdata/interlaced.png");
    let gray = gray_pixels(&file(interlaced).unwrap()).unwrap();
    let expected = (0..37).flat_map(|y| (0..45).map(move |x| (x * 3 + y * 4) % 256));
    assert!(gray.iter().map(|&g| u32::from(g)).eq(expected));
}

#[test]
fn jpeg_files_give_the_luma_that_their_colours_have() {
    let ours = written(&DynamicImage::from(picture()), ImageFormat::Jpeg);
    for jpeg in [
        ours.as_slice(),
        BASELINE_420,
        BASELINE_422_RESTART,
        PROGRESSIVE_420,
    ] {
        let image = file(jpeg).unwrap();
        let gray = gray_pixels(&image).unwrap();
        let reference = image::load_from_memory_with_format(jpeg, ImageFormat::Jpeg)
            .unwrap()
            .into_rgb8();
        assert_eq!((image.width_px, image.height_px), reference.dimensions());
        // Strong colours are clipped on the way through RGB, so a few of the reference's pixels are off.
        let far = gray
            .iter()
            .zip(reference.pixels())
            .filter(|(g, p)| (f64::from(**g) - luma(p.0)).abs() > 2.0);
        assert!(far.count() * 50 < gray.len());
        assert_eq!(color(Side::Left, &image).unwrap().rgb, reference.into_raw());
    }
}

#[test]
fn gray_jpeg_files_are_gray_in_both_ways() {
    let gray = DynamicImage::from(picture()).into_luma8();
    let jpeg = written(&DynamicImage::from(gray.clone()), ImageFormat::Jpeg);
    let image = file(&jpeg).unwrap();
    let got = gray_pixels(&image).unwrap();
    assert!(largest_difference(&got, gray.as_raw().iter().map(|&g| f64::from(g))) <= 6.0);
    let rgb = color(Side::Left, &image).unwrap().rgb;
    assert!(
        rgb.as_chunks::<3>()
            .0
            .iter()
            .zip(&got)
            .all(|(p, g)| *p == [*g; 3])
    );
}

#[test]
fn jpeg_files_that_hold_rgb_become_luma() {
    // The same planes named R, G and B instead of 1, 2 and 3 are read as colours without conversion.
    let gray = DynamicImage::from(picture()).into_luma8();
    let mut jpeg = written(
        &DynamicImage::from(DynamicImage::from(gray).into_rgb8()),
        ImageFormat::Jpeg,
    );
    let frame = jpeg.windows(2).position(|m| m == [0xff, 0xc0]).unwrap();
    let scan = jpeg.windows(2).position(|m| m == [0xff, 0xda]).unwrap();
    for (i, name) in b"RGB".iter().enumerate() {
        jpeg[frame + 10 + 3 * i] = *name;
        jpeg[scan + 5 + 2 * i] = *name;
    }
    let image = file(&jpeg).unwrap();
    let got = gray_pixels(&image).unwrap();
    let rgb = color(Side::Left, &image).unwrap().rgb;
    assert!(largest_difference(&got, rgb.as_chunks::<3>().0.iter().map(|p| luma(*p))) <= 1.0);
}

#[test]
fn cmyk_jpeg_files_are_refused_naming_what_is_understood() {
    let error = gray_pixels(&file(CMYK).unwrap()).unwrap_err();
    assert!(matches!(error, ServiceError::Invalid(_)));
    assert!(
        error.to_string().contains("left JPEG") && error.to_string().contains("YCbCr"),
        "{error}"
    );
}
