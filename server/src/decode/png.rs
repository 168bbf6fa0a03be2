//! PNG files, row by row: a colour image is never held whole.

use std::io::{Cursor, ErrorKind};

use png::{BitDepth, ColorType, Decoder, DecodingError, Limits, Transformations};

use super::pixels::Layout;
use crate::job::PixelFormat;

/// What the decoder may allocate besides one image: rows and metadata.
const MAX_SIDE_BYTES: usize = 8 << 20;

/// Width and height in px from the header chunk alone; nothing after it is read.
pub(super) fn size_px(file: &[u8]) -> Result<(u32, u32), String> {
    let mut decoder = Decoder::new_with_limits(
        Cursor::new(file),
        Limits {
            bytes: MAX_SIDE_BYTES,
        },
    );
    decoder
        .read_header_info()
        .map(png::Info::size)
        .map_err(|e| reason(&e))
}

/// Hands every row from the top to `each(y, layout, row)`. Palettes and 1 to 4 bits are expanded to 8; 16-bit gray comes
/// as mono16, 16-bit colours keep their upper bytes. The caller has checked the header's size; the file must still have it.
pub(super) fn for_each_row(
    file: &[u8],
    size_px: (u32, u32),
    mut each: impl FnMut(usize, Layout, &[u8]),
) -> Result<(), String> {
    let mut decoder = Decoder::new_with_limits(
        Cursor::new(file),
        Limits {
            bytes: MAX_SIDE_BYTES,
        },
    );
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    let header = decoder.read_header_info().map_err(|e| reason(&e))?;
    if header.size() != size_px {
        return Err("its header changed its size".into());
    }
    let is_deep = (header.color_type, header.bit_depth) == (ColorType::Grayscale, BitDepth::Sixteen);
    decoder.set_transformations(if is_deep {
        Transformations::IDENTITY
    } else {
        Transformations::EXPAND | Transformations::STRIP_16
    });
    let mut reader = decoder.read_info().map_err(|e| reason(&e))?;
    let frame = reader
        .info()
        .frame_control
        .as_ref()
        .map(|frame| (frame.width, frame.height));
    if frame.is_some_and(|frame| frame != size_px) {
        return Err("its first animation frame is smaller than the image".into());
    }
    let layout = match reader.output_color_type() {
        (ColorType::Grayscale, BitDepth::Sixteen) => Layout::Raw(PixelFormat::Mono16),
        (ColorType::Grayscale, BitDepth::Eight) => Layout::Raw(PixelFormat::Mono8),
        (ColorType::GrayscaleAlpha, BitDepth::Eight) => Layout::GrayAlpha8,
        (ColorType::Rgb, BitDepth::Eight) => Layout::Raw(PixelFormat::Rgb8),
        (ColorType::Rgba, BitDepth::Eight) => Layout::Raw(PixelFormat::Rgba8),
        (color, depth) => {
            return Err(format!(
                "its pixels are {color:?} of {depth:?} bits after expansion"
            ));
        }
    };
    let row_bytes = reader
        .output_line_size(size_px.0)
        .ok_or("a row of it does not fit into memory")?;
    if reader.info().interlaced {
        // Rows of an interlaced image are complete only at the end, so this one is held whole.
        let image_bytes = reader.output_buffer_size().ok_or("it does not fit into memory")?;
        let mut image = vec![0; image_bytes];
        reader.next_frame(&mut image).map_err(|e| reason(&e))?;
        if is_deep {
            to_little_endian(&mut image);
        }
        for (y, row) in image.chunks_exact(row_bytes).enumerate() {
            each(y, layout, row);
        }
        return Ok(());
    }
    let mut row = vec![0; row_bytes];
    let mut y = 0;
    // The call after the last row reads what is left of the image data, so that its checksum is verified.
    while reader.read_row(&mut row).map_err(|e| reason(&e))?.is_some() {
        if is_deep {
            to_little_endian(&mut row);
        }
        each(y, layout, &row);
        y += 1;
    }
    Ok(())
}

/// PNG's words are big-endian, mono16's little-endian.
fn to_little_endian(words: &mut [u8]) {
    for word in words.as_chunks_mut::<2>().0 {
        word.swap(0, 1);
    }
}

fn reason(error: &DecodingError) -> String {
    match error {
        DecodingError::IoError(e) if e.kind() == ErrorKind::UnexpectedEof => "it ends too early".into(),
        DecodingError::LimitsExceeded => {
            format!(
                "its size or its metadata need more than {} MB",
                MAX_SIDE_BYTES >> 20
            )
        }
        other => other.to_string(),
    }
}
