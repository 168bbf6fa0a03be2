//! The pair that is sent: a rendered scene with texture, in the size and form asked for.

use anyhow::{Context, Result};
use bytes::Bytes;
use image::{ExtendedColorType, ImageFormat};
use prost::Message;
use stereo_client::v1;
use stereo_tests::gray::GrayImage;
use stereo_tests::render::RenderedPair;
use stereo_tests::scene::Scene;

use crate::args::{Codec, Size};

/// Both views of a scene.
pub(crate) struct Frames {
    left: GrayImage,
    right: GrayImage,
}

impl Frames {
    /// Renders the scene, a road with boxes and poles, for pairs of `size`; at most in VGA, as rendering takes time.
    pub(crate) fn render(size: Size) -> Self {
        let mut scene = Scene::road();
        scene.rig.width_px = size.width_px.min(Size::VGA.width_px);
        scene.rig.height_px = size.height_px.min(Size::VGA.height_px);
        let RenderedPair { left, right, .. } = RenderedPair::clean(&scene);
        Self { left, right }
    }

    /// The fields `left` and `right` of a `StereoRequest`, as bytes.
    ///
    /// Fields of a protobuf message may come in any order and in pieces, so that a request is what is particular to it,
    /// followed by these bytes, which all requests share.
    ///
    /// # Errors
    /// If an image can't be encoded.
    pub(crate) fn pair(&self, size: Size, codec: Codec) -> Result<Bytes> {
        let image = |view: &GrayImage| encoded(&repeated(view, size)?, codec);
        let request = v1::StereoRequest {
            left: Some(image(&self.left)?),
            right: Some(image(&self.right)?),
            ..v1::StereoRequest::default()
        };
        Ok(request.encode_to_vec().into())
    }
}

/// The view in another size: cut, or repeated to the right and below.
fn repeated(view: &GrayImage, size: Size) -> Result<GrayImage> {
    let pixels = (0..size.height_px)
        .flat_map(|y| {
            let start = y % view.height_px() * view.width_px();
            let row = &view.pixels()[start..start + view.width_px()];
            row.iter().copied().cycle().take(size.width_px)
        })
        .collect();
    GrayImage::new(size.width_px, size.height_px, pixels)
}

fn encoded(view: &GrayImage, codec: Codec) -> Result<v1::Image> {
    let (width, height) = (u32::try_from(view.width_px())?, u32::try_from(view.height_px())?);
    let (encoding, data) = match codec {
        Codec::Raw => (v1::ImageEncoding::Mono8, view.pixels().to_vec()),
        Codec::Png => (v1::ImageEncoding::Png, view.to_png()?),
        Codec::Jpeg => {
            let mut file = Vec::new();
            image::write_buffer_with_format(
                &mut std::io::Cursor::new(&mut file),
                view.pixels(),
                width,
                height,
                ExtendedColorType::L8,
                ImageFormat::Jpeg,
            )
            .context("can't write a JPEG file")?;
            (v1::ImageEncoding::Jpeg, file)
        }
    };
    Ok(v1::Image {
        width,
        height,
        encoding: encoding.into(),
        data: data.into(),
        ..v1::Image::default()
    })
}

#[cfg(test)]
mod tests {
    use prost::Message;
    use stereo_client::v1;

    use super::Frames;
    use crate::args::{Codec, Size};

    #[test]
    fn a_pair_has_the_size_and_form_asked_for_and_is_not_constant() {
        let frames = Frames::render(Size::VGA);
        for (width_px, height_px) in [(64, 48), (1000, 600)] {
            let size = Size { width_px, height_px };
            for (codec, encoding) in [
                (Codec::Raw, v1::ImageEncoding::Mono8),
                (Codec::Png, v1::ImageEncoding::Png),
                (Codec::Jpeg, v1::ImageEncoding::Jpeg),
            ] {
                let bytes = frames.pair(size, codec).expect("a pair");
                let request = v1::StereoRequest::decode(bytes).expect("a request");
                let (left, right) = (request.left.expect("left"), request.right.expect("right"));
                assert_ne!(left.data, right.data);
                assert_eq!(left.encoding(), encoding);
                assert_eq!(right.width as usize, width_px);
                if codec == Codec::Raw {
                    assert_eq!(left.data.len(), width_px * height_px);
                    let (least, most) = (left.data.iter().min(), left.data.iter().max());
                    assert!(most > least);
                }
            }
        }
    }
}
