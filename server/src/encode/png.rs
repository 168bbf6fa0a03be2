//! Writing PNG files at the speed of a frame rate. The default compression takes 30 times as long; of the filters,
//! Paeth alone is near the smallest for sparse and dense maps alike, and choosing one for each row takes longer than
//! it saves.

use png::{BitDepth, ColorType, Compression, Encoder, Filter};

use super::internal;
use crate::status::ServiceError;

/// Width and height in px, and what a pixel is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Picture {
    pub(super) width_px: usize,
    pub(super) height_px: usize,
    pub(super) color: ColorType,
    pub(super) depth: BitDepth,
}

/// A PNG file of gray pixels in rows without padding.
pub(crate) fn gray_png(width_px: u32, height_px: u32, pixels: &[u8]) -> Result<Vec<u8>, ServiceError> {
    let picture = Picture {
        width_px: width_px as usize,
        height_px: height_px as usize,
        color: ColorType::Grayscale,
        depth: BitDepth::Eight,
    };
    picture.write(pixels)
}

impl Picture {
    /// A PNG file of `pixels`: rows without padding, 16-bit values big endian.
    pub(super) fn write(self, pixels: &[u8]) -> Result<Vec<u8>, ServiceError> {
        let side = |px: usize| u32::try_from(px).map_err(|_| internal("a picture is too large for PNG"));
        let mut file = Vec::with_capacity(pixels.len() / 2 + 1024);
        let mut encoder = Encoder::new(&mut file, side(self.width_px)?, side(self.height_px)?);
        encoder.set_color(self.color);
        encoder.set_depth(self.depth);
        encoder.set_compression(Compression::Fast);
        encoder.set_filter(Filter::Paeth);
        let written = encoder.write_header().and_then(|mut writer| {
            writer.write_image_data(pixels)?;
            writer.finish()
        });
        written
            .map(|()| file)
            .map_err(|why| internal(&format!("writing a PNG: {why}")))
    }
}
