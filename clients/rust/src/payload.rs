//! Maps of a result as floats.

use std::io::Cursor;

use stereo_proto::v1::{Depth, Disparity, DisparityEncoding};

use crate::ClientError;

/// Steps of a 16-bit disparity in one pixel.
const U16_PER_PX: f32 = 256.0;

/// Disparities in pixels, row by row without padding; NaN where invalid.
///
/// # Errors
/// [`ClientError::Malformed`] if the map's size, encoding and data don't go together, or it holds none.
pub fn disparity_px(map: &Disparity) -> Result<Vec<f32>, ClientError> {
    let size = (map.width, map.height);
    let from_u16 = |value: u16| {
        if value == 0 {
            f32::NAN
        } else {
            f32::from(value) / U16_PER_PX
        }
    };
    match map.encoding() {
        DisparityEncoding::F32 => rows::<4, _>(&map.data, size, map.step, f32::from_le_bytes),
        DisparityEncoding::U16 => rows::<2, _>(&map.data, size, map.step, |chunk| {
            from_u16(u16::from_le_bytes(chunk))
        }),
        DisparityEncoding::Png16 => {
            let pixels = png16(&map.data, size)?;
            rows::<2, _>(&pixels, size, 0, |chunk| from_u16(u16::from_be_bytes(chunk)))
        }
        DisparityEncoding::Unspecified => Err(malformed("the disparity map has no known encoding")),
    }
}

/// Depths in metres, row by row without padding; NaN where invalid.
///
/// # Errors
/// [`ClientError::Malformed`] if the map's size and data don't go together.
pub fn depth_m(map: &Depth) -> Result<Vec<f32>, ClientError> {
    rows::<4, _>(&map.data, (map.width, map.height), map.step, f32::from_le_bytes)
}

/// The values of `height` rows of `width` values of `N` bytes, one row every `step` bytes (0 = without padding).
fn rows<const N: usize, T>(
    data: &[u8],
    (width, height): (u32, u32),
    step: u32,
    value: impl Fn([u8; N]) -> T,
) -> Result<Vec<T>, ClientError> {
    let row_bytes = u64::from(width) * N as u64;
    let step = if step == 0 { row_bytes } else { u64::from(step) };
    let needed = match u64::from(height) {
        0 => Some(0),
        rows => step
            .checked_mul(rows - 1)
            .and_then(|bytes| bytes.checked_add(row_bytes)),
    };
    if step < row_bytes || step == 0 || needed.is_none_or(|needed| needed > data.len() as u64) {
        let got = data.len();
        return Err(malformed(&format!(
            "{width} x {height} values with a step of {step} in {got} bytes"
        )));
    }
    // Both are at most the length of `data` now.
    let (row_bytes, step) = (usize::try_from(row_bytes), usize::try_from(step));
    let (Ok(row_bytes), Ok(step)) = (row_bytes, step) else {
        return Err(malformed("the map is too large"));
    };
    let rows = data.chunks(step).take(height as usize);
    Ok(rows
        .flat_map(|row| {
            row[..row_bytes]
                .as_chunks::<N>()
                .0
                .iter()
                .map(|&chunk| value(chunk))
        })
        .collect())
}

/// The big-endian pixels of a 16-bit gray PNG of this size.
fn png16(file: &[u8], size: (u32, u32)) -> Result<Vec<u8>, ClientError> {
    let unreadable = |why: &dyn std::fmt::Display| malformed(&format!("the disparity PNG: {why}"));
    let mut reader = png::Decoder::new(Cursor::new(file))
        .read_info()
        .map_err(|why| unreadable(&why))?;
    let header = reader.info();
    let kind = (header.color_type, header.bit_depth);
    if header.size() != size || kind != (png::ColorType::Grayscale, png::BitDepth::Sixteen) {
        return Err(unreadable(&"it is not 16-bit gray of the map's size"));
    }
    let bytes = reader
        .output_buffer_size()
        .ok_or_else(|| unreadable(&"it is too large"))?;
    let mut pixels = vec![0; bytes];
    reader.next_frame(&mut pixels).map_err(|why| unreadable(&why))?;
    Ok(pixels)
}

fn malformed(what: &str) -> ClientError {
    ClientError::Malformed(what.to_owned())
}

#[cfg(test)]
mod tests {
    use bytes::Bytes;

    use super::*;

    fn map(encoding: DisparityEncoding, step: u32, data: Vec<u8>) -> Disparity {
        Disparity {
            width: 2,
            height: 2,
            encoding: encoding.into(),
            step,
            data: Bytes::from(data),
            ..Disparity::default()
        }
    }

    fn assert_is_the_sample(px: &[f32]) {
        assert!(px[0].is_nan());
        assert_eq!(px[1..], [1.0, 1.0 / 256.0, 255.0]);
    }

    const SAMPLE: [u16; 4] = [0, 256, 1, 65_280];

    #[test]
    fn every_encoding_reads_as_pixels() {
        let u16s: Vec<u8> = SAMPLE.iter().flat_map(|value| value.to_le_bytes()).collect();
        assert_is_the_sample(&disparity_px(&map(DisparityEncoding::U16, 4, u16s)).unwrap());
        let f32s = [f32::NAN, 1.0, 1.0 / 256.0, 255.0]
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        assert_is_the_sample(&disparity_px(&map(DisparityEncoding::F32, 8, f32s)).unwrap());
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, 2, 2);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        let pixels: Vec<u8> = SAMPLE.iter().flat_map(|value| value.to_be_bytes()).collect();
        encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
        assert_is_the_sample(&disparity_px(&map(DisparityEncoding::Png16, 0, file)).unwrap());
    }

    #[test]
    fn padding_between_rows_is_skipped() {
        let mut padded = Vec::new();
        for row in SAMPLE.chunks(2) {
            padded.extend(row.iter().flat_map(|value| value.to_le_bytes()));
            padded.extend([9, 9]);
        }
        padded.truncate(10);
        assert_is_the_sample(&disparity_px(&map(DisparityEncoding::U16, 6, padded)).unwrap());
    }

    #[test]
    fn maps_that_contradict_themselves_are_errors() {
        for (encoding, step, bytes) in [
            (DisparityEncoding::U16, 4, 7),
            (DisparityEncoding::U16, 3, 100),
            (DisparityEncoding::F32, 0, 15),
            (DisparityEncoding::F32, u32::MAX, 16),
            (DisparityEncoding::Png16, 0, 16),
            (DisparityEncoding::Unspecified, 0, 16),
        ] {
            assert!(
                disparity_px(&map(encoding, step, vec![0; bytes])).is_err(),
                "{encoding:?} {step} {bytes}"
            );
        }
        let (width, height) = (u32::MAX, u32::MAX);
        assert!(
            depth_m(&Depth {
                width,
                height,
                ..Depth::default()
            })
            .is_err()
        );
        assert!(
            depth_m(&Depth {
                height,
                ..Depth::default()
            })
            .is_err()
        );
    }
}
