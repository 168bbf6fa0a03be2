//! Image files that are not what they should be.

/// The checksum of PNG chunks (ISO 3309).
fn crc(bytes: &[u8]) -> u32 {
    let step = |crc: u32| {
        if crc & 1 == 1 {
            (crc >> 1) ^ 0xedb8_8320
        } else {
            crc >> 1
        }
    };
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| step(crc))
    })
}

fn chunk(kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let body = [kind.as_slice(), data].concat();
    let length = u32::try_from(data.len()).expect("short");
    [&length.to_be_bytes(), body.as_slice(), &crc(&body).to_be_bytes()].concat()
}

/// An 8-bit gray PNG whose header claims any size, with `data` where its pixels should be.
pub(crate) fn png_that_claims(width: u32, height: u32, data: &[u8]) -> Vec<u8> {
    let mut header = [width.to_be_bytes(), height.to_be_bytes()].concat();
    header.extend([8, 0, 0, 0, 0]);
    let signature = b"\x89PNG\r\n\x1a\n".to_vec();
    [
        signature,
        chunk(b"IHDR", &header),
        chunk(b"IDAT", data),
        chunk(b"IEND", &[]),
    ]
    .concat()
}

/// `file`, a JPEG, with another size in its frame header.
pub(crate) fn jpeg_that_claims(width: u16, height: u16, file: &[u8]) -> Vec<u8> {
    let mut file = file.to_vec();
    let start = file
        .windows(2)
        .position(|w| w == [0xff, 0xc0] || w == [0xff, 0xc2])
        .expect("a frame header");
    // Marker, length and precision come before height and width.
    file[start + 5..start + 7].copy_from_slice(&height.to_be_bytes());
    file[start + 7..start + 9].copy_from_slice(&width.to_be_bytes());
    file
}

/// An image as a JPEG file of high quality.
pub(crate) fn jpeg(image: &stereo_tests::gray::GrayImage) -> Vec<u8> {
    let mut file = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut file, 98)
        .encode(
            image.pixels(),
            u32::try_from(image.width_px()).expect("small"),
            u32::try_from(image.height_px()).expect("small"),
            image::ExtendedColorType::L8,
        )
        .expect("a small image");
    file
}
