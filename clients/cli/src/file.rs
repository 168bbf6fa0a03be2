//! Results as files.

mod map;
mod surface;

use std::path::{Path, PathBuf};

use stereo_client::v1::{Image, Output as Part, StereoResult};

use crate::args::{FilesArgs, Format};
use crate::failure::Failure;

/// Where results go.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Target {
    /// Nowhere.
    Nothing,
    /// One file.
    File(PathBuf, Format),
    /// A folder, with these files of each pair.
    Folder(PathBuf, Vec<Format>),
}

impl Target {
    /// What the command line asks for, for so many pairs; a folder is there when this returns.
    pub(crate) fn new(args: &FilesArgs, pairs: usize) -> Result<Self, Failure> {
        let Some(path) = &args.output else {
            return match args.format.is_empty() {
                true => Ok(Self::Nothing),
                false => Err(Failure::usage(
                    "--format says how to write, but not where: add --output FILE or DIR",
                )),
            };
        };
        let by_ending = by_ending(path).filter(|_| !path.is_dir());
        match (by_ending, args.format.as_slice()) {
            (Some(_), _) if pairs > 1 => Err(Failure::usage(format!(
                "{} is one file, but there are {pairs} pairs: give a folder",
                path.display()
            ))),
            (Some(format), []) => Ok(Self::File(path.clone(), format)),
            (Some(_), &[format]) => Ok(Self::File(path.clone(), format)),
            (Some(_), _) => Err(Failure::usage(format!(
                "{} is one file, but --format names several kinds: give a folder",
                path.display()
            ))),
            (None, formats) => {
                std::fs::create_dir_all(path).map_err(|why| unwritable(path, &why))?;
                let formats = match formats {
                    [] => vec![Format::Png, Format::Color],
                    formats => formats.to_vec(),
                };
                Ok(Self::Folder(path.clone(), formats))
            }
        }
    }

    /// The parts of a result that are needed.
    pub(crate) fn parts(&self) -> Vec<Part> {
        let formats = match self {
            Self::Nothing => &[],
            Self::File(_, format) => std::slice::from_ref(format),
            Self::Folder(_, formats) => formats.as_slice(),
        };
        let mut parts = vec![Part::Disparity];
        if formats
            .iter()
            .any(|format| matches!(format, Format::Ply | Format::Glb))
        {
            parts.push(Part::Mesh);
        }
        parts
    }

    /// Writes what is wanted of the pair called `name`: the files. `left` is its left image.
    pub(crate) fn write(
        &self,
        name: &str,
        left: &Image,
        result: &StereoResult,
    ) -> Result<Vec<PathBuf>, Failure> {
        match self {
            Self::Nothing => Ok(Vec::new()),
            Self::File(path, format) => {
                write(path, &encode(*format, left, result)?)?;
                Ok(vec![path.clone()])
            }
            Self::Folder(folder, formats) => formats
                .iter()
                .map(|&format| {
                    let path = folder.join(format!("{name}{}", ending(format)));
                    write(&path, &encode(format, left, result)?)?;
                    Ok(path)
                })
                .collect(),
        }
    }
}

fn by_ending(path: &Path) -> Option<Format> {
    match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "png" => Some(Format::Png),
        "pfm" => Some(Format::Pfm),
        "npy" => Some(Format::Npy),
        "ply" => Some(Format::Ply),
        "glb" => Some(Format::Glb),
        _ => None,
    }
}

/// What follows a pair's name in a folder.
fn ending(format: Format) -> &'static str {
    match format {
        Format::Png => "_disparity.png",
        Format::Color => "_color.png",
        Format::Pfm => "_disparity.pfm",
        Format::Npy => "_disparity.npy",
        Format::Ply => "_mesh.ply",
        Format::Glb => "_mesh.glb",
    }
}

fn encode(format: Format, left: &Image, result: &StereoResult) -> Result<Vec<u8>, Failure> {
    match format {
        Format::Png => map::Map::of(result)?.png(),
        Format::Color => map::Map::of(result)?.color_png(),
        Format::Pfm => Ok(map::Map::of(result)?.pfm()),
        Format::Npy => Ok(map::Map::of(result)?.npy()),
        Format::Ply => Ok(surface::Surface::of(result)?.ply(left)),
        Format::Glb => surface::Surface::of(result)?.glb(left),
    }
}

/// Renamed into place, so that nobody ever finds half a file.
fn write(path: &Path, data: &[u8]) -> Result<(), Failure> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".part");
    std::fs::write(&partial, data)
        .and_then(|()| std::fs::rename(&partial, path))
        .map_err(|why| unwritable(path, &why))
}

fn unwritable(path: &Path, why: &std::io::Error) -> Failure {
    Failure::failed(format!(
        "{} can't be written ({why}): give another place with --output",
        path.display()
    ))
}

/// A part of a result that was asked for and is not there.
fn missing(part: &str, result: &StereoResult) -> Failure {
    let why = result
        .report
        .as_ref()
        .map_or("", |report| report.degradation.as_str());
    let why = if why.is_empty() {
        String::new()
    } else {
        format!(" ({why})")
    };
    Failure::failed(format!(
        "the result has no {part}{why}: give more budget, or leave `outputs` out of --options"
    ))
}
