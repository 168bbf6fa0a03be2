//! Where scenes come from and where figures go: the options that all commands share.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;
use stereo_tests::dataset::{SceneFiles, find_scenes};
use stereo_tests::{machine, readme};

use crate::method::{Contestant, Views};

/// Options that all commands share.
#[derive(Debug, Clone, Args)]
pub(crate) struct Source {
    /// Folder of scenes: prepared ones, KITTI 2012 or 2015, Middlebury 2014 or ETH3D as downloaded.
    #[arg(long, default_value = "../shared/data")]
    pub(crate) data: PathBuf,
    /// Python with opencv-python-headless, for the peers (`make target/venv/ready` makes this one).
    #[arg(long, default_value = "target/venv/bin/python")]
    pub(crate) python: PathBuf,
    /// Replaces the figures in README.md and tests/eval/FIGURES.md, instead of only printing them.
    #[arg(long)]
    write: bool,
}

/// The documents that hold figures between markers.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Document {
    Readme,
    Figures,
}

/// A set of scenes, by how their names begin.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DataSet {
    pub(crate) title: &'static str,
    start: &'static str,
}

pub(crate) const KITTI: DataSet = DataSet {
    title: "KITTI 2012",
    start: "kitti2012",
};
pub(crate) const MIDDLEBURY: DataSet = DataSet {
    title: "Middlebury",
    start: "middlebury",
};
pub(crate) const ETH3D: DataSet = DataSet {
    title: "ETH3D",
    start: "eth3d",
};

/// One scene of Middlebury.
pub(crate) const MOTORCYCLE: DataSet = DataSet {
    title: "Middlebury's motorcycle",
    start: "middlebury2014/motorcycle",
};

/// Disparities searched where nothing else is said.
pub(crate) const DISPARITIES: u16 = 128;

impl Source {
    /// The scenes of `set`, read.
    pub(crate) fn views(&self, set: DataSet) -> Result<Vec<Views>> {
        let scenes = self.scenes(&[set.start])?;
        scenes.iter().map(Views::load).collect()
    }

    /// The scenes whose names begin with one of `only`; all for none.
    pub(crate) fn scenes<S: AsRef<str>>(&self, only: &[S]) -> Result<Vec<SceneFiles>> {
        let mut scenes = find_scenes(&self.data)?;
        let begins = |scene: &SceneFiles| only.iter().any(|start| scene.name.starts_with(start.as_ref()));
        scenes.retain(|scene| only.is_empty() || begins(scene));
        ensure!(
            !scenes.is_empty(),
            "no scene with ground truth in {}{}: give a folder that has some with --data",
            self.data.display(),
            if only.is_empty() {
                String::new()
            } else {
                let names: Vec<&str> = only.iter().map(AsRef::as_ref).collect();
                format!(" whose name begins with {}", names.join(" or "))
            }
        );
        Ok(scenes)
    }

    /// OpenCV's matchers of these names.
    pub(crate) fn peers(&self, names: &[&str]) -> Result<Vec<Contestant>> {
        Contestant::peers(&self.python, names)
    }

    /// Prints `text` below a line on what made it, and with `--write` puts both between the markers of `name`.
    #[expect(clippy::print_stdout, reason = "the figures are what this program is for")]
    pub(crate) fn publish(&self, document: Document, name: &str, text: &str) -> Result<()> {
        let text = format!("*{}.*\n\n{text}", machine::describe());
        println!("## {name}\n\n{text}");
        if self.write {
            let path = match document {
                Document::Readme => "README.md",
                Document::Figures => "tests/eval/FIGURES.md",
            };
            readme::write_table(path.as_ref(), name, &text)?;
        }
        Ok(())
    }

    /// With `--write`, writes a picture into `tests/data`.
    pub(crate) fn publish_picture(&self, name: &str, svg: &str) -> Result<()> {
        if self.write {
            let path = PathBuf::from("tests/data").join(name);
            std::fs::write(&path, svg).with_context(|| format!("can't write {}", path.display()))?;
        }
        Ok(())
    }
}
