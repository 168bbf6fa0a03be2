//! The mesh as binary glTF, textured with the left image.

use png::{BitDepth, ColorType};
use stereo_surface::Texture;

use super::internal;
use super::png::Picture;
use super::surface::Surface;
use crate::decode::{self, Side};
use crate::job::{ImageEncoding, MatchedFrame, PixelFormat};
use crate::status::ServiceError;

/// The frame's mesh as a GLB file; an empty mesh is a file with an empty node.
pub(super) fn encode(frame: &MatchedFrame<'_>) -> Result<Vec<u8>, ServiceError> {
    let surface = Surface::new(frame)?;
    let (image, media_type) = match surface.triangles.is_empty() {
        true => (Vec::new(), ""),
        false => texture(frame)?,
    };
    let texture = Texture {
        file: &image,
        media_type,
        uvs: &surface.uvs(frame.map.shape()),
    };
    surface
        .as_file(frame)
        .glb(texture)
        .map_err(|why| internal(&why.to_string()))
}

/// The left image as a file and its type: as it came if it was a file, else as a PNG.
fn texture(frame: &MatchedFrame<'_>) -> Result<(Vec<u8>, &'static str), ServiceError> {
    let left = &frame.request.left;
    let (pixels, color) = match left.encoding {
        ImageEncoding::Png => return Ok((left.data.to_vec(), "image/png")),
        ImageEncoding::Jpeg => return Ok((left.data.to_vec(), "image/jpeg")),
        ImageEncoding::Raw(PixelFormat::Mono8 | PixelFormat::Mono16) => {
            let gray = frame.left_gray;
            let rows: Vec<&[u8]> = (0..gray.height_px()).map(|y| gray.row(y)).collect();
            (rows.concat(), ColorType::Grayscale)
        }
        ImageEncoding::Raw(_) => (decode::color(Side::Left, left)?.rgb, ColorType::Rgb),
    };
    let picture = Picture {
        width_px: frame.left_gray.width_px(),
        height_px: frame.left_gray.height_px(),
        color,
        depth: BitDepth::Eight,
    };
    Ok((picture.write(&pixels)?, "image/png"))
}

#[cfg(test)]
mod tests;
