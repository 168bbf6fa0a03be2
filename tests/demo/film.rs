//! What the demo's cameras show: the pair again and again, and a drive where there is one.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use serde_json::Value;
use stereo_client::v1;
use stereo_tests::dataset::LoadedScene;
use stereo_tests::gray::GrayImage;
use stereo_tests::registry_pair::calibration;

/// Of each frame.
pub(crate) const BUDGET: Duration = Duration::from_millis(100);
/// A drive of the KITTI data set, beside the project where it is present.
const DRIVE: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../shared/data/sequences/kitti_odo_1"
);

/// Frames in turn, at least one, and whose they are.
pub(crate) struct Film {
    /// The camera's name.
    pub(crate) name: &'static str,
    pub(crate) rate_hz: u32,
    pub(crate) frames: Vec<v1::StereoRequest>,
}

impl Film {
    /// The pair alone, 30 times a second.
    pub(crate) fn pair(scene: &LoadedScene) -> Self {
        let calibration = v1::Calibration {
            focal_px: calibration::FOCAL_PX,
            cx_px: calibration::CX_PX,
            cy_px: calibration::CY_PX,
            baseline_m: calibration::BASELINE_M,
            doffs_px: calibration::DOFFS_PX,
        };
        Self {
            name: "demo",
            rate_hz: 30,
            frames: vec![frame(raw(&scene.left), raw(&scene.right), calibration)],
        }
    }

    /// The drive, as fast as it was taken; `None` if it isn't there.
    pub(crate) fn drive() -> Result<Option<Self>> {
        let folder = Path::new(DRIVE);
        if !folder.is_dir() {
            return Ok(None);
        }
        let described: Value = serde_json::from_slice(&read(&folder.join("calib.json"))?)?;
        let number = |name: &str| {
            described[name]
                .as_f64()
                .with_context(|| format!("calib.json has no {name}"))
        };
        let calibration = v1::Calibration {
            focal_px: number("focal_px")?,
            cx_px: number("cx")?,
            cy_px: number("cy")?,
            baseline_m: number("baseline_m")?,
            doffs_px: 0.0,
        };
        let mut names: Vec<PathBuf> = std::fs::read_dir(folder.join("left"))?
            .map(|entry| Ok(entry?.file_name().into()))
            .collect::<Result<_>>()?;
        names.sort();
        ensure!(!names.is_empty(), "{DRIVE} has no frames");
        let frames = names.iter().map(|name| {
            let [left, right] = ["left", "right"].map(|side| png(&folder.join(side).join(name)));
            Ok(frame(left?, right?, calibration))
        });
        Ok(Some(Self {
            name: "drive",
            rate_hz: u32::try_from(described["fps"].as_u64().context("calib.json has no fps")?)?,
            frames: frames.collect::<Result<_>>()?,
        }))
    }
}

fn frame(left: v1::Image, right: v1::Image, calibration: v1::Calibration) -> v1::StereoRequest {
    v1::StereoRequest {
        left: Some(left),
        right: Some(right),
        calibration: Some(calibration),
        options: Some(v1::Options {
            latency_budget: BUDGET.try_into().ok(),
            outputs: vec![v1::Output::Disparity.into()],
            ..v1::Options::default()
        }),
        ..v1::StereoRequest::default()
    }
}

fn raw(image: &GrayImage) -> v1::Image {
    v1::Image {
        width: u32::try_from(image.width_px()).unwrap_or_default(),
        height: u32::try_from(image.height_px()).unwrap_or_default(),
        encoding: v1::ImageEncoding::Mono8.into(),
        data: image.pixels().to_vec().into(),
        ..v1::Image::default()
    }
}

fn png(path: &Path) -> Result<v1::Image> {
    Ok(v1::Image {
        encoding: v1::ImageEncoding::Png.into(),
        data: read(path)?.into(),
        ..v1::Image::default()
    })
}

fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).with_context(|| format!("can't read {}", path.display()))
}
