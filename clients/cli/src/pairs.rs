//! Which files are pairs: two files, two folders, or one folder laid out in one of the usual ways.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use bytes::Bytes;
use stereo_client::v1::{Image, ImageEncoding};

use crate::failure::Failure;

/// Folders of left and right images inside one folder.
const FOLDERS: [(&str, &str); 5] = [
    ("left", "right"),
    ("image_2", "image_3"),
    ("image_0", "image_1"),
    ("colored_0", "colored_1"),
    ("im0", "im1"),
];
/// Ends, or beginnings, of the names of left and right images in one folder.
const NAMES: [(&str, &str); 3] = [("left", "right"), ("im0", "im1"), ("_l", "_r")];

/// Two image files and a name for what comes of them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Pair {
    pub(crate) name: String,
    pub(crate) left: PathBuf,
    pub(crate) right: PathBuf,
}

impl Pair {
    /// Both images, as the files they are.
    pub(crate) fn read(&self) -> Result<(Image, Image), Failure> {
        Ok((read(&self.left)?, read(&self.right)?))
    }
}

/// The pairs of two files, two folders, or one folder (`right` absent), in natural order.
pub(crate) fn find(left: &Path, right: Option<&Path>) -> Result<Vec<Pair>, Failure> {
    let pairs = match right {
        Some(right) if left.is_file() && right.is_file() => vec![Pair {
            name: stem(left),
            left: left.to_owned(),
            right: right.to_owned(),
        }],
        Some(right) => by_name(&images(left)?, &images(right)?),
        None if left.is_file() => {
            return Err(Failure::usage(format!(
                "{} is a left image alone: give the right one too, or a folder",
                left.display()
            )));
        }
        None => in_folder(left)?,
    };
    if pairs.is_empty() {
        let place = match right {
            Some(right) => format!(
                "files of the same name in {} and {}",
                left.display(),
                right.display()
            ),
            None => format!("pairs in {}", left.display()),
        };
        return Err(Failure::usage(format!(
            "there are no {place}: a folder has left/ and right/ (or image_2/ and image_3/, image_0/ and image_1/) with PNG or \
             JPEG files of the same names, or files such as x_left.png and x_right.png"
        )));
    }
    Ok(pairs)
}

/// The left image of the first pair.
pub(crate) fn first_left(pairs: &[Pair]) -> &Path {
    pairs.first().map_or(Path::new(""), |pair| pair.left.as_path())
}

fn in_folder(folder: &Path) -> Result<Vec<Pair>, Failure> {
    for (left, right) in FOLDERS {
        let (left, right) = (folder.join(left), folder.join(right));
        if left.is_dir() && right.is_dir() {
            return Ok(by_name(&images(&left)?, &images(&right)?));
        }
    }
    let files = images(folder)?;
    for (left, right) in NAMES {
        let of_side = |side: &str| -> BTreeMap<String, PathBuf> {
            let rest = |(name, path): (&String, &PathBuf)| {
                let lower = name.to_ascii_lowercase();
                let rest = lower.strip_suffix(side).or_else(|| lower.strip_prefix(side))?;
                Some((rest.trim_matches(['_', '-', '.']).to_owned(), path.clone()))
            };
            files.iter().filter_map(rest).collect()
        };
        let mut pairs = by_name(&of_side(left), &of_side(right));
        if !pairs.is_empty() {
            for pair in &mut pairs {
                if pair.name.is_empty() {
                    pair.name = stem(folder);
                }
            }
            return Ok(pairs);
        }
    }
    Ok(Vec::new())
}

/// Those that both sides have.
fn by_name(left: &BTreeMap<String, PathBuf>, right: &BTreeMap<String, PathBuf>) -> Vec<Pair> {
    let both = left.iter().filter_map(|(name, left)| {
        Some(Pair {
            name: name.clone(),
            left: left.clone(),
            right: right.get(name)?.clone(),
        })
    });
    let mut pairs: Vec<Pair> = both.collect();
    pairs.sort_by_cached_key(|pair| natural(&pair.name));
    pairs
}

/// The image files of a folder by their names without the type.
fn images(folder: &Path) -> Result<BTreeMap<String, PathBuf>, Failure> {
    let unreadable = |why: std::io::Error| {
        Failure::failed(format!(
            "{} can't be read ({why}): give image files or a folder of them",
            folder.display()
        ))
    };
    let mut files = BTreeMap::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        let kind = path
            .extension()
            .and_then(|kind| kind.to_str())
            .unwrap_or_default();
        if ["png", "jpg", "jpeg"].contains(&kind.to_ascii_lowercase().as_str()) && path.is_file() {
            files.insert(stem(&path), path);
        }
    }
    Ok(files)
}

fn stem(path: &Path) -> String {
    let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
    stem.unwrap_or_else(|| "pair".to_owned())
}

/// A key in whose order `frame2` comes before `frame10`.
fn natural(name: &str) -> Vec<(String, usize, String)> {
    let mut key = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let letters = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let (text, after) = rest.split_at(letters);
        let digits = after.find(|c: char| !c.is_ascii_digit()).unwrap_or(after.len());
        let (number, after) = after.split_at(digits);
        let number = number.trim_start_matches('0');
        key.push((text.to_owned(), number.len(), number.to_owned()));
        rest = after;
    }
    key
}

fn read(path: &Path) -> Result<Image, Failure> {
    let data = std::fs::read(path).map_err(|why| {
        Failure::failed(format!(
            "{} can't be read ({why}): give a PNG or JPEG file",
            path.display()
        ))
    })?;
    let encoding = match data.as_slice() {
        [0x89, b'P', b'N', b'G', ..] => ImageEncoding::Png,
        [0xff, 0xd8, 0xff, ..] => ImageEncoding::Jpeg,
        _ => {
            return Err(Failure::failed(format!(
                "{} is neither a PNG nor a JPEG file: convert it",
                path.display()
            )));
        }
    };
    Ok(Image {
        encoding: encoding.into(),
        data: Bytes::from(data),
        ..Image::default()
    })
}

#[cfg(test)]
mod tests {
    use super::natural;

    #[test]
    fn numbers_in_names_count_as_numbers() {
        let mut names = [
            "frame10",
            "frame2",
            "frame010b",
            "a3",
            "frame2b",
            "000001",
            "000000",
        ];
        names.sort_by_cached_key(|name| natural(name));
        assert_eq!(
            names,
            [
                "000000",
                "000001",
                "a3",
                "frame2",
                "frame2b",
                "frame10",
                "frame010b"
            ]
        );
    }
}
