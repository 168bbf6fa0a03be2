//! Images as the server's own decoder reads them.

use std::path::Path;

use anyhow::{Context, Result};
use stereod::decode::{GrayScratch, Side, gray, inspect};
use stereod::job::ImageData;

use crate::gray::GrayImage;

pub(super) fn read(side: Side, path: &Path) -> Result<GrayImage> {
    decoded(side, super::read(path)?).with_context(|| format!("can't decode {}", path.display()))
}

/// A PNG or JPEG file in memory as the server reads it.
///
/// # Errors
/// If it can't be decoded.
pub fn decoded(side: Side, file: Vec<u8>) -> Result<GrayImage> {
    let (encoding, width_px, height_px) = inspect(side, &file)?;
    let image = ImageData {
        encoding,
        width_px,
        height_px,
        step_bytes: 0,
        frame_id: String::new(),
        data: file.into(),
    };
    let mut scratch = GrayScratch::default();
    let view = gray(side, &image, &mut scratch)?;
    let pixels = (0..view.height_px()).flat_map(|y| view.row(y)).copied().collect();
    GrayImage::new(view.width_px(), view.height_px(), pixels)
}
