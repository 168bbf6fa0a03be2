//! Real data sets in a folder, as their makers ship them.
//!
//! | layout | folders |
//! | --- | --- |
//! | prepared scenes | `[<dataset>/]<scene>/{left,right,gt_noc}.png`, optional `meta.json` |
//! | KITTI 2012 | `training/{colored_0,colored_1}` or `{image_0,image_1}`, `training/disp_noc` |
//! | KITTI 2015 | `training/{image_2,image_3}`, `training/disp_noc_0` |
//! | Middlebury 2014, ETH3D | `<scene>/{im0,im1}.png`, `disp0.pfm` or `disp0GT.pfm`, `mask0nocc.png`, `calib.txt` |
//!
//! Data sets have licences of their own; nothing of them is part of this repository.

mod pfm;
mod served;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use stereod::decode::Side;

pub use self::served::decoded;

use crate::gray::GrayImage;
use crate::truth::TruthMap;

/// Where a scene's files are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SceneFiles {
    /// Name: the path below the folder that was searched.
    pub name: String,
    /// Left image.
    pub left: PathBuf,
    /// Right image.
    pub right: PathBuf,
    truth: TruthFiles,
    disparities: Disparities,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum TruthFiles {
    Png16(PathBuf),
    Pfm { disparity: PathBuf, visible: PathBuf },
}

/// What says how many disparities a scene needs.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Disparities {
    Meta(PathBuf),
    Calib(PathBuf),
    Unsaid,
}

/// A scene in memory.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadedScene {
    /// Left view.
    pub left: GrayImage,
    /// Right view.
    pub right: GrayImage,
    /// Disparity of the non-occluded pixels.
    pub truth: TruthMap,
}

impl SceneFiles {
    /// Reads the images and the ground truth.
    ///
    /// # Errors
    /// If a file can't be read, or the sizes differ.
    pub fn load(&self) -> Result<LoadedScene> {
        let (left, right) = (GrayImage::read(&self.left)?, GrayImage::read(&self.right)?);
        let truth = match &self.truth {
            TruthFiles::Png16(path) => TruthMap::read_png16(path)?,
            TruthFiles::Pfm { disparity, visible } => {
                let mut truth = pfm::read(disparity)?;
                let mask = GrayImage::read(visible)?;
                let keep: Vec<bool> = mask.pixels().iter().map(|&m| m == 255).collect();
                truth.retain(&keep)?;
                truth
            }
        };
        let size = (left.width_px(), left.height_px());
        ensure!(
            size == (right.width_px(), right.height_px()) && size == (truth.width_px, truth.height_px),
            "{}: left is {size:?}, right {:?}, ground truth {:?}",
            self.name,
            (right.width_px(), right.height_px()),
            (truth.width_px, truth.height_px)
        );
        Ok(LoadedScene { left, right, truth })
    }

    /// Reads both images as the server does: its gray of a colour may differ by one from OpenCV's.
    ///
    /// # Errors
    /// If a file can't be read or decoded.
    pub fn load_as_served(&self) -> Result<(GrayImage, GrayImage)> {
        Ok((
            served::read(Side::Left, &self.left)?,
            served::read(Side::Right, &self.right)?,
        ))
    }

    /// The number of disparities the scene's own files ask for: a multiple of 16, at least 128.
    ///
    /// # Errors
    /// If `meta.json` or `calib.txt` is there but can't be understood.
    pub fn disparities(&self) -> Result<u16> {
        let said = match &self.disparities {
            Disparities::Meta(path) => {
                let meta: serde_json::Value = serde_json::from_slice(&read(path)?)
                    .with_context(|| format!("{} isn't JSON", path.display()))?;
                meta.get("ndisp").and_then(serde_json::Value::as_u64)
            }
            Disparities::Calib(path) => String::from_utf8_lossy(&read(path)?)
                .lines()
                .find_map(|line| line.strip_prefix("ndisp=")?.trim().parse().ok()),
            Disparities::Unsaid => None,
        };
        let count = said.unwrap_or(128).next_multiple_of(16).max(128);
        u16::try_from(count).with_context(|| format!("{}: {count} disparities", self.name))
    }
}

fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).with_context(|| format!("can't read {}", path.display()))
}

/// Every scene with ground truth below `root`, in order of name; an empty list if there is none.
///
/// # Errors
/// If `root` isn't a folder that can be read, or a scene lacks one of its files.
pub fn find_scenes(root: &Path) -> Result<Vec<SceneFiles>> {
    let mut found = Vec::new();
    for folder in [root.to_owned(), root.join("training")] {
        if folder.join("disp_noc_0").is_dir() {
            found.extend(kitti(root, &folder, "disp_noc_0", &[("image_2", "image_3")])?);
        } else if folder.join("disp_noc").is_dir() {
            let views = [("colored_0", "colored_1"), ("image_0", "image_1")];
            found.extend(kitti(root, &folder, "disp_noc", &views)?);
        }
    }
    for folder in subfolders(root)? {
        found.extend(scene_folder(root, &folder)?);
        for inner in subfolders(&folder)? {
            found.extend(scene_folder(root, &inner)?);
        }
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(found)
}

/// A folder that is one scene, if it is.
fn scene_folder(root: &Path, folder: &Path) -> Result<Option<SceneFiles>> {
    let at = |name: &str| folder.join(name);
    let or_unsaid = |path: PathBuf, said: fn(PathBuf) -> Disparities| {
        if path.is_file() {
            said(path)
        } else {
            Disparities::Unsaid
        }
    };
    if at("gt_noc.png").is_file() {
        return Ok(Some(SceneFiles {
            name: name_below(root, folder),
            left: at("left.png"),
            right: at("right.png"),
            truth: TruthFiles::Png16(at("gt_noc.png")),
            disparities: or_unsaid(at("meta.json"), Disparities::Meta),
        }));
    }
    let Some(disparity) = ["disp0.pfm", "disp0GT.pfm"]
        .into_iter()
        .map(at)
        .find(|p| p.is_file())
    else {
        return Ok(None);
    };
    let visible = at("mask0nocc.png");
    if !visible.is_file() {
        bail!(
            "{} has {} but no mask0nocc.png",
            folder.display(),
            disparity.display()
        );
    }
    Ok(Some(SceneFiles {
        name: name_below(root, folder),
        left: at("im0.png"),
        right: at("im1.png"),
        truth: TruthFiles::Pfm { disparity, visible },
        disparities: or_unsaid(at("calib.txt"), Disparities::Calib),
    }))
}

fn kitti(root: &Path, folder: &Path, truth: &str, views: &[(&str, &str)]) -> Result<Vec<SceneFiles>> {
    let Some((left, right)) = views.iter().find(|(left, _)| folder.join(left).is_dir()) else {
        bail!(
            "{} has {truth} but none of the image folders {views:?}",
            folder.display()
        );
    };
    let mut scenes = Vec::new();
    for entry in entries(&folder.join(truth))? {
        let Some(file) = entry
            .file_name()
            .filter(|_| entry.extension().is_some_and(|e| e == "png"))
        else {
            continue;
        };
        scenes.push(SceneFiles {
            name: name_below(root, &entry.with_extension("")),
            left: folder.join(left).join(file),
            right: folder.join(right).join(file),
            truth: TruthFiles::Png16(entry.clone()),
            disparities: Disparities::Unsaid,
        });
    }
    Ok(scenes)
}

fn name_below(root: &Path, path: &Path) -> String {
    path.strip_prefix(root).unwrap_or(path).display().to_string()
}

fn subfolders(folder: &Path) -> Result<Vec<PathBuf>> {
    Ok(entries(folder)?
        .into_iter()
        .filter(|path| path.is_dir())
        .collect())
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let list = std::fs::read_dir(folder).with_context(|| format!("can't list {}", folder.display()))?;
    let mut paths = list.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    paths.sort();
    Ok(paths)
}

#[cfg(test)]
mod tests;
