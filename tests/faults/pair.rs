//! The pairs that are sent.

use std::io::Cursor;
use std::time::Duration;

use anyhow::{Context, Result};
use image::{ExtendedColorType, ImageFormat};
use stereo_client::v1;
use stereo_tests::gray::GrayImage;
use stereo_tests::render::RenderedPair;
use stereo_tests::scene::Scene;

/// A small pair of raw images with this budget.
pub(crate) fn small(budget: Duration) -> Result<v1::StereoRequest> {
    request((320, 240), budget, raw)
}

/// A pair of raw images in VGA.
pub(crate) fn vga(budget: Duration) -> Result<v1::StereoRequest> {
    request((640, 480), budget, raw)
}

/// The small one as JPEG files.
pub(crate) fn small_jpeg(budget: Duration) -> Result<v1::StereoRequest> {
    request((320, 240), budget, jpeg)
}

/// A pair of 4 megapixels each, raw, of which one rung is wanted.
pub(crate) fn large(budget: Duration) -> Result<v1::StereoRequest> {
    let mut pair = request((256, 256), budget, raw)?;
    for image in [&mut pair.left, &mut pair.right].into_iter().flatten() {
        (image.width, image.height) = (2048, 2048);
        image.data = image.data.repeat(64).into();
    }
    let options = pair.options.get_or_insert_default();
    options.max_iterations = Some(1);
    options.outputs = vec![v1::Output::Disparity.into()];
    Ok(pair)
}

fn request(
    (width, height): (usize, usize),
    budget: Duration,
    encode: fn(&GrayImage) -> Result<v1::Image>,
) -> Result<v1::StereoRequest> {
    let mut scene = Scene::road();
    (scene.rig.width_px, scene.rig.height_px) = (width, height);
    let RenderedPair { left, right, .. } = RenderedPair::clean(&scene);
    Ok(v1::StereoRequest {
        left: Some(encode(&left)?),
        right: Some(encode(&right)?),
        options: Some(v1::Options {
            latency_budget: Some(budget.try_into()?),
            ..v1::Options::default()
        }),
        ..v1::StereoRequest::default()
    })
}

fn raw(view: &GrayImage) -> Result<v1::Image> {
    image(view, v1::ImageEncoding::Mono8, view.pixels().to_vec())
}

fn jpeg(view: &GrayImage) -> Result<v1::Image> {
    let (width, height) = (view.width_px().try_into()?, view.height_px().try_into()?);
    let mut file = Vec::new();
    image::write_buffer_with_format(
        &mut Cursor::new(&mut file),
        view.pixels(),
        width,
        height,
        ExtendedColorType::L8,
        ImageFormat::Jpeg,
    )
    .context("can't write a JPEG file")?;
    image(view, v1::ImageEncoding::Jpeg, file)
}

fn image(view: &GrayImage, encoding: v1::ImageEncoding, data: Vec<u8>) -> Result<v1::Image> {
    Ok(v1::Image {
        width: view.width_px().try_into()?,
        height: view.height_px().try_into()?,
        encoding: encoding.into(),
        data: data.into(),
        ..v1::Image::default()
    })
}
