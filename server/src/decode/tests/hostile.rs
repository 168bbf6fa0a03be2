//! Files that are damaged or lie. Nothing here may panic, take memory for what is only claimed, or pass for an image.

use image::{DynamicImage, ImageFormat};
use stereo::GrayView;

use super::files::{PROGRESSIVE_420, picture, written};
use super::{color, file, gray_pixels};
use crate::decode::{GrayScratch, Side, gray, inspect};
use crate::job::ImageData;
use crate::status::ServiceError;

const IEND_BYTES: usize = 12;

fn jpeg() -> Vec<u8> {
    written(&DynamicImage::from(picture()), ImageFormat::Jpeg)
}

/// A PNG of `width` x `height` gray pixels whose image data are `zlib`.
fn png_with(width: u32, height: u32, zlib: &[u8]) -> Vec<u8> {
    let mut file = Vec::new();
    let mut writer = png::Encoder::new(&mut file, width, height)
        .write_header()
        .unwrap();
    writer.write_chunk(png::chunk::IDAT, zlib).unwrap();
    drop(writer);
    file
}

/// The file with its frame header's size replaced.
fn jpeg_claiming(jpeg: &[u8], width: u16, height: u16) -> Vec<u8> {
    let mut file = jpeg.to_vec();
    let frame = file
        .windows(2)
        .position(|m| m == [0xff, 0xc0] || m == [0xff, 0xc2])
        .unwrap();
    file[frame + 5..frame + 7].copy_from_slice(&height.to_be_bytes());
    file[frame + 7..frame + 9].copy_from_slice(&width.to_be_bytes());
    file
}

/// Whether both ways of decoding succeed.
fn decodes(data: &[u8]) -> bool {
    file(data).is_ok_and(|image| {
        let (gray, color) = (gray_pixels(&image), color(Side::Left, &image));
        gray.is_ok() && color.is_ok()
    })
}

/// The most memory the process has ever mapped, in bytes.
#[cfg(target_os = "linux")]
fn peak_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmPeak:"))
        .unwrap();
    line.trim().trim_end_matches(" kB").parse::<u64>().unwrap() * 1024
}

#[test]
fn headers_that_claim_huge_images_are_too_large() {
    let claims = [
        (png_with(100_000, 100_000, b""), "100000 x 100000"),
        (
            png_with(i32::MAX.unsigned_abs(), i32::MAX.unsigned_abs(), b""),
            "2147483647 x 2147483647",
        ),
        (jpeg_claiming(&jpeg(), 65_535, 65_535), "65535 x 65535"),
        (jpeg_claiming(PROGRESSIVE_420, 65_535, 65_535), "65535 x 65535"),
    ];
    for (data, size) in claims {
        let error = inspect(Side::Left, &data).unwrap_err();
        assert!(matches!(error, ServiceError::TooLarge(_)), "{error}");
        assert!(
            error.to_string().contains(size) && error.to_string().contains("4096 x 4096"),
            "{error}"
        );
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_claimed_size_takes_no_memory() {
    let before = peak_bytes();
    for _ in 0..4 {
        assert!(inspect(Side::Left, &png_with(100_000, 100_000, b"")).is_err());
        assert!(inspect(Side::Left, &png_with(i32::MAX.unsigned_abs(), 4, b"")).is_err());
        assert!(inspect(Side::Left, &jpeg_claiming(PROGRESSIVE_420, 65_535, 65_535)).is_err());
    }
    // The smallest of them would be 4 GB in gray; tests that run beside this one take far less.
    assert!(peak_bytes() - before < 1 << 30);
}

#[test]
fn the_largest_claim_with_no_pixels_behind_it_is_refused() {
    for data in [
        png_with(4096, 4096, b""),
        jpeg_claiming(&jpeg(), 4096, 4096),
        jpeg_claiming(PROGRESSIVE_420, 4096, 4096),
    ] {
        let image = file(&data).unwrap();
        assert_eq!((image.width_px, image.height_px), (4096, 4096));
        let Err(error) = gray_pixels(&image) else {
            panic!("{:?} passed", image.encoding)
        };
        assert!(
            error.to_string().contains("the left") && error.to_string().contains("send it whole"),
            "{error}"
        );
    }
}

#[test]
fn sizes_of_zero_and_sides_that_are_too_long_are_refused() {
    assert!(inspect(Side::Left, &jpeg_claiming(&jpeg(), 0, 37)).is_err());
    assert!(inspect(Side::Left, &jpeg_claiming(&jpeg(), 45, 0)).is_err());
    let long = file(&png_with(100_000, 100, b"")).unwrap();
    assert!(matches!(gray_pixels(&long), Err(ServiceError::Unmatchable(_))));
}

#[test]
fn a_file_of_another_size_than_was_said_is_refused() {
    for data in [jpeg(), written(&DynamicImage::from(picture()), ImageFormat::Png)] {
        let image = ImageData {
            width_px: 400,
            ..file(&data).unwrap()
        };
        assert!(matches!(gray_pixels(&image), Err(ServiceError::Invalid(_))));
        assert!(matches!(color(Side::Left, &image), Err(ServiceError::Invalid(_))));
    }
}

#[test]
fn a_png_file_cut_anywhere_before_its_last_chunk_is_refused() {
    for variant in [
        DynamicImage::from(picture()),
        DynamicImage::from(DynamicImage::from(picture()).into_luma8()),
    ] {
        let png = written(&variant, ImageFormat::Png);
        for length in 0..=png.len() {
            // The image data are known to be whole once the next chunk has begun.
            let whole = length >= png.len() - 4;
            assert_eq!(decodes(&png[..length]), whole, "cut at {length} of {}", png.len());
        }
    }
    let interlaced: &[u8] = include_bytes!("../testdata/interlaced.png");
    for length in 0..interlaced.len() - IEND_BYTES {
        assert!(!decodes(&interlaced[..length]), "cut at {length}");
    }
}

#[test]
fn a_jpeg_file_cut_anywhere_is_refused() {
    for jpeg in [jpeg().as_slice(), PROGRESSIVE_420] {
        for length in 0..=jpeg.len() {
            assert_eq!(
                decodes(&jpeg[..length]),
                length == jpeg.len(),
                "cut at {length} of {}",
                jpeg.len()
            );
        }
    }
}

#[test]
fn a_jpeg_file_with_a_part_missing_before_its_end_marker_is_refused() {
    // As a camera leaves it that has lost a packet.
    let jpeg = jpeg();
    let data_at = jpeg.windows(2).position(|m| m == [0xff, 0xda]).unwrap() + 14;
    let end = jpeg.len() - 2;
    for keep in [0, 1, 2, 3].map(|quarter| data_at + (end - data_at) * quarter / 4) {
        let cut = [&jpeg[..keep], &[0xff, 0xd9]].concat();
        assert!(!decodes(&cut), "the first {keep} bytes of {}", jpeg.len());
        let comment = [&jpeg[..keep], &[0xff, 0xfe, 0, 2, 0xff, 0xd9]].concat();
        assert!(
            !decodes(&comment),
            "a comment after {keep} bytes of {}",
            jpeg.len()
        );
    }
}

#[test]
fn nothing_of_an_earlier_image_shows_in_a_damaged_one() {
    let end = PROGRESSIVE_420
        .windows(2)
        .position(|m| m == [0xff, 0xda])
        .unwrap()
        + 40;
    let cut = [&PROGRESSIVE_420[..end], &[0xff, 0xd9]].concat();
    let cut = file(&cut).unwrap();
    let mut used = GrayScratch {
        gray: vec![0xaa; 45 * 37],
        ..GrayScratch::default()
    };
    let (mut fresh, rows) = (GrayScratch::default(), |view: GrayView<'_>| {
        (0..37).map(|y| view.row(y).to_vec()).collect()
    });
    let after: Result<Vec<_>, _> = gray(Side::Left, &cut, &mut used).map(rows);
    let alone: Result<Vec<_>, _> = gray(Side::Left, &cut, &mut fresh).map(rows);
    assert_eq!(after, alone);
}

#[test]
fn flipped_bytes_never_panic_and_a_png_file_never_hides_them() {
    let png = written(&DynamicImage::from(picture()), ImageFormat::Png);
    let expected = gray_pixels(&file(&png).unwrap()).unwrap();
    for at in 0..png.len() - IEND_BYTES {
        for mask in [0x01, 0x80, 0xff] {
            let mut data = png.clone();
            data[at] ^= mask;
            if let Ok(gray) = file(&data).and_then(|image| gray_pixels(&image)) {
                assert_eq!(gray, expected, "byte {at} of {} with {mask:#x}", png.len());
            }
        }
    }
    for jpeg in [jpeg().as_slice(), PROGRESSIVE_420] {
        for at in 0..jpeg.len() {
            for mask in [0x01, 0x10, 0x80, 0xff] {
                let mut data = jpeg.to_vec();
                data[at] ^= mask;
                decodes(&data);
            }
        }
    }
}

#[test]
fn image_data_beyond_the_image_are_not_inflated() {
    // 64 MB of zeros for an image of 45 x 37 px.
    let mut zeros = Vec::new();
    let mut encoder = png::Encoder::new(&mut zeros, 8192, 8191);
    encoder.set_compression(png::Compression::Fast);
    encoder
        .write_header()
        .unwrap()
        .write_image_data(&vec![0; 8192 * 8191])
        .unwrap();
    let zlib = &zeros[8 + 25 + 8..zeros.len() - IEND_BYTES - 4];
    let image = file(&png_with(45, 37, zlib)).unwrap();
    assert_eq!(gray_pixels(&image).unwrap(), vec![0; 45 * 37]);
}

#[test]
fn a_jpeg_file_with_hundreds_of_scans_is_refused_before_decoding() {
    let last_scan = PROGRESSIVE_420
        .windows(2)
        .rposition(|m| m == [0xff, 0xda])
        .unwrap();
    let end = PROGRESSIVE_420.len() - 2;
    let mut data = PROGRESSIVE_420[..end].to_vec();
    for _ in 0..500 {
        data.extend_from_slice(&PROGRESSIVE_420[last_scan..end]);
    }
    data.extend_from_slice(&PROGRESSIVE_420[end..]);
    let error = gray_pixels(&file(&data).unwrap()).unwrap_err();
    assert!(error.to_string().contains("scans, at most 64"), "{error}");
}
