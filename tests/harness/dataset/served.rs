//! Images as the server's own decoder reads them.

use std::path::Path;

use anyhow::{Context, Result};
use stereod::decode::{GrayScratch, Side, gray, inspect};
use stereod::job::ImageData;

use crate::gray::GrayImage;

pub(super) fn read(side: Side, path: &Path) -> Result<GrayImage> {
    let file = super::read(path)?;
    let (encoding, width_px, height_px) =
        inspect(side, &file).with_context(|| format!("can't decode {}", path.display()))?;
    let image = ImageData {
        encoding,
        width_px,
        height_px,
        step_bytes: 0,
        frame_id: String::new(),
        data: file.into(),
    };
    let mut scratch = GrayScratch::default();
    let view =
        gray(side, &image, &mut scratch).with_context(|| format!("can't decode {}", path.display()))?;
    let pixels = (0..view.height_px()).flat_map(|y| view.row(y)).copied().collect();
    GrayImage::new(view.width_px(), view.height_px(), pixels)
}
