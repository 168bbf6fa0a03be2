//! PNG and JPEG files, and raw pixels, as gray and in colour.

use bytes::Bytes;
use stereod::decode::{GrayScratch, Side, color, gray, inspect};
use stereod::job::{ImageData, ImageEncoding};

use super::request::MOST_PX;
use crate::refusal::is_accepted;

pub(crate) fn png(bytes: &[u8]) -> bool {
    file(bytes, ImageEncoding::Png)
}

pub(crate) fn jpeg(bytes: &[u8]) -> bool {
    file(bytes, ImageEncoding::Jpeg)
}

fn file(bytes: &[u8], wanted: ImageEncoding) -> bool {
    let inspected = inspect(Side::Left, bytes);
    if !is_accepted(&inspected) {
        return false;
    }
    let Ok((encoding, width_px, height_px)) = inspected else {
        return false;
    };
    if encoding != wanted || u64::from(width_px) * u64::from(height_px) > MOST_PX {
        return false;
    }
    let image = ImageData {
        encoding,
        width_px,
        height_px,
        step_bytes: 0,
        frame_id: String::new(),
        data: Bytes::copy_from_slice(bytes),
    };
    is_decoded(Side::Left, &image)
}

/// Whether the image can be decoded: the same into fresh memory and into a worker's, which has held other images.
pub(crate) fn is_decoded(side: Side, image: &ImageData) -> bool {
    let mut scratch = GrayScratch::default();
    let first = rows(side, image, &mut scratch);
    let again = rows(side, image, &mut scratch);
    assert_eq!(first, again, "what was in memory before shows");
    let rgb = color(side, image);
    assert_eq!(
        is_accepted(&rgb),
        first.is_some(),
        "gray and colour don't agree on whether it is whole"
    );
    first.is_some()
}

fn rows(side: Side, image: &ImageData, scratch: &mut GrayScratch) -> Option<Vec<u8>> {
    let view = gray(side, image, scratch);
    if !is_accepted(&view) {
        return None;
    }
    let view = view.ok()?;
    Some(
        (0..view.height_px())
            .flat_map(|y| view.row(y).iter().copied())
            .collect(),
    )
}
