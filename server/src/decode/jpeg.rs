//! JPEG files. Gray comes from the file's own luma plane, which is BT.601 luma already: no colour is computed.
//!
//! Damage is an error here, not a picture with gray patches: a patch that looks the same in both views would be
//! matched.

use std::borrow::Cow;

use zune_jpeg::JpegDecoder;
use zune_jpeg::errors::DecodeErrors;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::pixels::Layout;
use crate::job::PixelFormat;

/// Scans a file may have. Real progressive files have about ten; each costs a pass over the whole image.
const MAX_SCANS: usize = 64;

/// Width and height in px from the header.
pub(super) fn size_px(file: &[u8]) -> Result<(u32, u32), String> {
    let mut decoder = decoder(file, (u16::MAX.into(), u16::MAX.into()));
    decoder.decode_headers().map_err(|e| reason(&e))?;
    let info = decoder.info().ok_or("it has no header")?;
    Ok((info.width.into(), info.height.into()))
}

/// Decodes to `gray`, which is zeroed first: the decoder leaves out what damaged files don't have. `scratch` is used
/// only for the rare files that hold RGB instead of luma and chroma.
pub(super) fn read_gray(
    file: &[u8],
    size_px: (u32, u32),
    gray: &mut [u8],
    scratch: &mut Vec<u8>,
) -> Result<(), String> {
    let stream = stream_of(file, size_px)?;
    let mut decoder = checked_decoder(&stream, size_px)?;
    if decoder.input_colorspace() == Some(ColorSpace::RGB) {
        scratch.clear();
        scratch.resize(gray.len() * 3, 0);
        decoder.decode_into(scratch).map_err(|e| reason(&e))?;
        Layout::Raw(PixelFormat::Rgb8).write_gray(scratch, gray);
        return Ok(());
    }
    gray.fill(0);
    let options = decoder.options().jpeg_set_out_colorspace(ColorSpace::Luma);
    decoder.set_options(options);
    decoder.decode_into(gray).map_err(|e| reason(&e))
}

/// Decodes to RGB, three bytes a pixel.
pub(super) fn read_rgb(file: &[u8], size_px: (u32, u32), rgb: &mut [u8]) -> Result<(), String> {
    let stream = stream_of(file, size_px)?;
    checked_decoder(&stream, size_px)?
        .decode_into(rgb)
        .map_err(|e| reason(&e))
}

fn decoder(file: &[u8], max_px: (usize, usize)) -> JpegDecoder<ZCursor<&[u8]>> {
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(max_px.0)
        .set_max_height(max_px.1)
        .jpeg_set_max_scans(MAX_SCANS)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    JpegDecoder::new_with_options(ZCursor::new(file), options)
}

/// A decoder past the header of `stream` for an image of `size_px` with colours we know.
fn checked_decoder(stream: &[u8], size_px: (u32, u32)) -> Result<JpegDecoder<ZCursor<&[u8]>>, String> {
    let mut decoder = decoder(stream, (size_px.0 as usize, size_px.1 as usize));
    decoder.decode_headers().map_err(|e| reason(&e))?;
    if decoder.info().map(|info| (info.width.into(), info.height.into())) != Some(size_px) {
        return Err("its header changed its size".into());
    }
    match decoder.input_colorspace() {
        Some(ColorSpace::Luma | ColorSpace::YCbCr | ColorSpace::RGB) => Ok(decoder),
        other => Err(format!(
            "its colours are {other:?}; gray, YCbCr and RGB are understood"
        )),
    }
}

/// The part of `file` to decode, after checking that it is whole as far as its markers tell.
///
/// The decoder takes an end marker for the end of the image, however much is missing, and paints the rest gray. Where
/// all pixels are in one scan, it gets the scan without the marker instead: when it then runs out of data, it says
/// so. The zeros are for its look-ahead. Of a cut progressive scan only the gross cases are seen, as a block takes at
/// least a bit.
fn stream_of(file: &[u8], size_px: (u32, u32)) -> Result<Cow<'_, [u8]>, String> {
    const LOOK_AHEAD: [u8; 16] = [0; 16];
    let Markers {
        progressive,
        scans,
        first_scan_end,
    } = Markers::read(file).ok_or("it ends too early")?;
    if scans > MAX_SCANS {
        return Err(format!("it has {scans} scans, at most {MAX_SCANS} are accepted"));
    }
    let blocks = u64::from(size_px.0.div_ceil(8)) * u64::from(size_px.1.div_ceil(8));
    if blocks > file.len() as u64 * 8 {
        return Err(format!(
            "{} bytes are too few for {} x {} px",
            file.len(),
            size_px.0,
            size_px.1
        ));
    }
    if progressive || scans > 1 {
        return Ok(Cow::Borrowed(file));
    }
    Ok(Cow::Owned([&file[..first_scan_end], &LOOK_AHEAD].concat()))
}

/// What the markers of a file say.
struct Markers {
    progressive: bool,
    scans: usize,
    /// Where the first scan's data end.
    first_scan_end: usize,
}

impl Markers {
    /// Walks from the start to the end marker; `None` if there is none.
    fn read(file: &[u8]) -> Option<Self> {
        let mut markers = Self {
            progressive: false,
            scans: 0,
            first_scan_end: 0,
        };
        let mut at = 2;
        loop {
            at += file.get(at..)?.iter().position(|&byte| byte == 0xff)?;
            let code = *file.get(at + 1)?;
            match code {
                0xd9 => return (markers.scans > 0).then_some(markers),
                // Fill bytes, stuffed data bytes, and markers without a length.
                0xff => at += 1,
                0x00 | 0x01 | 0xd0..=0xd8 => at += 2,
                _ => {
                    at += 2 + usize::from(u16::from_be_bytes([*file.get(at + 2)?, *file.get(at + 3)?]));
                    markers.progressive |= code == 0xc2;
                    if code == 0xda {
                        at = scan_end(file, at)?;
                        markers.scans += 1;
                        if markers.scans == 1 {
                            markers.first_scan_end = at;
                        }
                    }
                }
            }
        }
    }
}

/// Where the data that begin at `at` end: at the next marker that is not a restart. Data bytes of 255 are stuffed.
fn scan_end(file: &[u8], mut at: usize) -> Option<usize> {
    loop {
        at += file.get(at..)?.iter().position(|&byte| byte == 0xff)?;
        match file.get(at + 1)? {
            0x00 | 0xd0..=0xd7 => at += 2,
            0xff => at += 1,
            _ => return Some(at),
        }
    }
}

fn reason(error: &DecodeErrors) -> String {
    match error {
        DecodeErrors::ExhaustedData | DecodeErrors::IoErrors(_) => "it ends too early".into(),
        other => other.to_string(),
    }
}
