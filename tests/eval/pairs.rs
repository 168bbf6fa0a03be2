//! Pairs to time: any scene of a data folder, or the registry's motorcycle, in any size.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use image::imageops::{FilterType, resize};
use image::{ImageBuffer, Luma};
use stereo_tests::dataset::{LoadedScene, find_scenes};
use stereo_tests::gray::GrayImage;
use stereo_tests::registry_pair::RegistryPair;
use stereo_tests::truth::TruthMap;

use crate::method::Views;

/// Name of the registry's pair.
pub(crate) const MOTORCYCLE: &str = "motorcycle";

/// The sizes of the paper's table IV, and KITTI's.
pub(crate) const SIZES: [Size; 5] = [
    Size::new(320, 240),
    VGA,
    Size::new(800, 600),
    HD,
    Size::new(1920, 1080),
];
pub(crate) const VGA: Size = Size::new(640, 480);
pub(crate) const HD: Size = Size::new(1280, 720);

/// A KITTI pair of 1241x376 px.
const KITTI_SCENE: &str = "kitti2012/000002";

/// Gray views, as the server reads them.
pub(crate) struct Pair {
    pub(crate) left: GrayImage,
    pub(crate) right: GrayImage,
}

/// Width and height in px, written `640x480`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Size {
    pub(crate) width_px: usize,
    pub(crate) height_px: usize,
}

impl Size {
    const fn new(width_px: usize, height_px: usize) -> Self {
        Self { width_px, height_px }
    }
}

impl std::str::FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let sides = text.split_once('x').and_then(|(width, height)| {
            Some(Self {
                width_px: width.parse().ok()?,
                height_px: height.parse().ok()?,
            })
        });
        sides.ok_or_else(|| format!("a size is WIDTHxHEIGHT in px, such as 640x480, got {text}"))
    }
}

impl std::fmt::Display for Size {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.width_px, self.height_px)
    }
}

impl Pair {
    /// The scene `name` below `data`; `motorcycle` is fetched from the registry if it isn't on this machine yet.
    pub(crate) fn load(data: &Path, name: &str) -> Result<Self> {
        if name == MOTORCYCLE {
            let target = PathBuf::from("target");
            let scene = RegistryPair::fetch(&target)?.load()?;
            return Ok(Self {
                left: scene.left,
                right: scene.right,
            });
        }
        let scenes = find_scenes(data)?;
        let Some(scene) = scenes.iter().find(|scene| scene.name.ends_with(name)) else {
            bail!(
                "there is no scene {name} in {}: give one of its folders, or {MOTORCYCLE}",
                data.display()
            );
        };
        let (left, right) = scene.load_as_served()?;
        Ok(Self { left, right })
    }

    /// The motorcycle in the sizes asked for, then a KITTI pair in its own, each with a name.
    pub(crate) fn standard(data: &Path, sizes: &[Size]) -> Result<Vec<(String, Self)>> {
        let motorcycle = Self::load(data, MOTORCYCLE)?;
        let mut pairs = Vec::new();
        for &size in sizes {
            pairs.push((size.to_string(), motorcycle.resized(size)?));
        }
        let kitti = Self::load(data, KITTI_SCENE)?;
        pairs.push((format!("{} (KITTI)", kitti.size()), kitti));
        Ok(pairs)
    }

    /// The pair for contestants: without ground truth.
    pub(crate) fn views(self, name: &str) -> Result<Views> {
        let Size { width_px, height_px } = self.size();
        let truth = TruthMap::new(width_px, height_px, vec![0.0; width_px * height_px])?;
        Ok(Views {
            name: name.to_owned(),
            served: (self.left.clone(), self.right.clone()),
            scored: LoadedScene {
                left: self.left,
                right: self.right,
                truth,
            },
        })
    }

    pub(crate) fn size(&self) -> Size {
        Size {
            width_px: self.left.width_px(),
            height_px: self.left.height_px(),
        }
    }

    /// The same pair in another size: disparities change with the width, rows stay rows.
    pub(crate) fn resized(&self, size: Size) -> Result<Self> {
        Ok(Self {
            left: resized(&self.left, size)?,
            right: resized(&self.right, size)?,
        })
    }
}

/// A gray image in another size.
pub(crate) fn resized(gray: &GrayImage, size: Size) -> Result<GrayImage> {
    let side = |px: usize| u32::try_from(px).context("an image of over 4 billion columns");
    let (width, height) = (side(gray.width_px())?, side(gray.height_px())?);
    let image: ImageBuffer<Luma<u8>, &[u8]> =
        ImageBuffer::from_raw(width, height, gray.pixels()).context("the pixels fill the image")?;
    let image = resize(
        &image,
        side(size.width_px)?,
        side(size.height_px)?,
        FilterType::CatmullRom,
    );
    GrayImage::new(size.width_px, size.height_px, image.into_raw())
}

#[cfg(test)]
mod tests {
    use super::{Pair, Size};
    use stereo_tests::gray::GrayImage;

    #[test]
    fn sizes_are_read_as_they_are_written() {
        let size: Size = "1241x376".parse().expect("a size");
        assert_eq!(size.to_string(), "1241x376");
        assert!("640".parse::<Size>().is_err());
        assert!("640xhigh".parse::<Size>().is_err());
    }

    #[test]
    fn a_ramp_keeps_its_slope_per_width() {
        let ramp: Vec<u8> = (0..20).flat_map(|_| (0..40).map(|x| 5 * x)).collect();
        let ramp = GrayImage::new(40, 20, ramp).expect("40 x 20");
        let pair = Pair {
            left: ramp.clone(),
            right: ramp,
        };
        let half = pair.resized("20x10".parse().expect("a size")).expect("resized");
        assert_eq!(half.size().to_string(), "20x10");
        let row = &half.left.pixels()[5 * 20..][..20];
        for x in 3..16 {
            let step = i32::from(row[x + 1]) - i32::from(row[x]);
            assert!((9..=11).contains(&step), "{row:?}");
        }
    }
}
