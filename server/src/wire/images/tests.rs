use bytes::Bytes;
use stereo_proto::v1::{Image, ImageEncoding as Wire};

use super::*;

const ANY_SIZE: u64 = 1 << 24;

fn raw(encoding: Wire, (width, height): (u32, u32), step: u32, bytes: usize) -> Image {
    Image {
        width,
        height,
        encoding: encoding.into(),
        step,
        data: Bytes::from(vec![7; bytes]),
        ..Image::default()
    }
}

fn file(format: image::ImageFormat, (width, height): (u32, u32)) -> Bytes {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::GrayImage::new(width, height)
        .write_to(&mut bytes, format)
        .unwrap();
    Bytes::from(bytes.into_inner())
}

fn png(size: (u32, u32)) -> Image {
    Image {
        encoding: Wire::Png.into(),
        data: file(image::ImageFormat::Png, size),
        ..Image::default()
    }
}

/// Code and sentence of the refusal of a pair with this left image and a right one that is well.
fn refusal(left: Image) -> (u16, String) {
    let error = pair(Some(left), Some(png((64, 32))), ANY_SIZE).unwrap_err();
    (error.http_code(), error.to_string())
}

#[test]
fn every_encoding_has_its_bytes_per_pixel() {
    let sizes = [
        (Wire::Mono8, 1),
        (Wire::Mono16, 2),
        (Wire::Yuyv, 2),
        (Wire::Rgb8, 3),
        (Wire::Bgr8, 3),
        (Wire::Rgba8, 4),
        (Wire::Bgra8, 4),
    ];
    for (encoding, bytes) in sizes {
        let good = raw(encoding, (64, 32), 0, 64 * 32 * bytes);
        let (left, right, shape) = pair(Some(good.clone()), Some(good), ANY_SIZE).unwrap();
        assert_eq!(left.step_bytes as usize, 64 * bytes, "{encoding:?}");
        assert_eq!(left.encoding, right.encoding);
        assert_eq!((shape.width_px(), shape.height_px()), (64, 32));
        let (code, text) = refusal(raw(encoding, (64, 32), 0, 64 * 32 * bytes - 1));
        assert_eq!(code, 400);
        assert!(
            text.contains(&format!("{} bytes of data, got", 64 * 32 * bytes)),
            "{text}"
        );
    }
}

#[test]
fn rows_may_be_padded_and_the_last_one_may_end_without() {
    for bytes in [31 * 80 + 64, 32 * 80, 32 * 80 - 3] {
        let image = raw(Wire::Mono8, (64, 32), 80, bytes);
        assert_eq!(super::image(Side::Left, Some(image)).unwrap().step_bytes, 80);
    }
    for bytes in [31 * 80 + 63, 32 * 80 + 1] {
        assert_eq!(refusal(raw(Wire::Mono8, (64, 32), 80, bytes)).0, 400);
    }
    let (code, text) = refusal(raw(Wire::Mono8, (64, 32), 63, 64 * 32));
    assert!(
        code == 400 && text.contains("step is 63 bytes but a row of 64 px needs 64"),
        "{text}"
    );
}

#[test]
fn mixed_encodings_of_one_size_are_a_pair() {
    let jpeg = Image {
        encoding: Wire::Jpeg.into(),
        data: file(image::ImageFormat::Jpeg, (64, 32)),
        width: 64,
        height: 32,
        ..Image::default()
    };
    let (left, right, _) = pair(Some(png((64, 32))), Some(jpeg), ANY_SIZE).unwrap();
    assert_eq!(
        (left.encoding, left.width_px, left.height_px, left.step_bytes),
        (ImageEncoding::Png, 64, 32, 0)
    );
    assert_eq!(right.encoding, ImageEncoding::Jpeg);
}

#[test]
fn missing_images_are_named() {
    for left in [None, Some(Image::default())] {
        let error = pair(left, Some(png((64, 32))), ANY_SIZE).unwrap_err();
        assert_eq!(error.http_code(), 400);
        assert!(error.to_string().contains("left image is missing"), "{error}");
    }
    let error = pair(Some(png((64, 32))), None, ANY_SIZE).unwrap_err();
    assert!(error.to_string().contains("right image is missing"), "{error}");
}

#[test]
fn sizes_that_differ_are_422_naming_both() {
    let (code, text) = refusal(png((65, 32)));
    assert_eq!(code, 422);
    assert!(text.contains("65 x 32") && text.contains("64 x 32"), "{text}");
}

#[test]
fn sides_out_of_range_are_422_naming_the_range() {
    for size in [(31, 40), (40, 31), (5000, 40), (0, 0)] {
        let (code, text) = refusal(raw(Wire::Mono8, size, 0, (size.0 * size.1) as usize));
        assert_eq!(code, 422, "{text}");
        assert!(text.contains("32 to 4096"), "{text}");
    }
}

#[test]
fn too_many_pixels_are_413_naming_the_limit() {
    let error = pair(Some(png((64, 64))), Some(png((64, 64))), 4095).unwrap_err();
    assert_eq!(error.http_code(), 413);
    assert!(error.to_string().contains("4095"), "{error}");
}

#[test]
fn file_that_is_not_what_was_said_is_refused() {
    let (code, text) = refusal(Image {
        encoding: Wire::Jpeg.into(),
        ..png((64, 32))
    });
    assert!(
        code == 400 && text.contains("Jpeg") && text.contains("Png"),
        "{text}"
    );
    let (code, text) = refusal(Image {
        width: 63,
        ..png((64, 32))
    });
    assert!(
        code == 400 && text.contains("63 x 0") && text.contains("64 x 32"),
        "{text}"
    );
    let (code, text) = refusal(Image {
        step: 64,
        ..png((64, 32))
    });
    assert!(code == 400 && text.contains("step of 64"), "{text}");
}

#[test]
fn unknown_encodings_are_refused_naming_those_there_are() {
    for value in [0, 17, -1] {
        let (code, text) = refusal(Image {
            encoding: value,
            ..png((64, 32))
        });
        assert!(
            code == 400 && text.contains("mono8, mono16") && text.contains("left"),
            "{text}"
        );
    }
}

#[test]
fn yuyv_of_odd_width_and_sizes_beyond_any_memory_are_refused() {
    assert!(
        refusal(raw(Wire::Yuyv, (63, 32), 0, 63 * 32 * 2))
            .1
            .contains("must be even")
    );
    assert_eq!(
        refusal(raw(Wire::Rgba8, (u32::MAX, u32::MAX), u32::MAX, 100)).0,
        400
    );
    assert_eq!(refusal(raw(Wire::Rgba8, (u32::MAX, u32::MAX), 0, 100)).0, 400);
    assert_eq!(refusal(raw(Wire::Rgba8, (u32::MAX, 0), 0, 0)).0, 400);
}

#[test]
fn long_frame_id_is_refused() {
    assert!(
        refusal(Image {
            frame_id: "x".repeat(129),
            ..png((64, 32))
        })
        .1
        .contains("128 bytes, got 129")
    );
}
