//! numpy's `.npz`: a zip archive of `.npy` files. Read here: the first one, a C-ordered matrix of little-endian floats.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};

use crate::truth::TruthMap;

/// Reads a disparity map; infinity and NaN mean unknown.
pub(super) fn read(path: &Path) -> Result<TruthMap> {
    let file = File::open(path).with_context(|| format!("can't open {}", path.display()))?;
    let mut archive =
        zip::ZipArchive::new(file).with_context(|| format!("{} is no archive", path.display()))?;
    let mut bytes = Vec::new();
    archive
        .by_index(0)
        .context("it is empty")?
        .read_to_end(&mut bytes)?;
    parse(&bytes).with_context(|| format!("{} holds no matrix of 32-bit floats", path.display()))
}

fn parse(npy: &[u8]) -> Result<TruthMap> {
    // Magic, version 1.0, header length, header: a Python dictionary.
    let Some((b"\x93NUMPY\x01\x00", rest)) = npy.split_at_checked(8) else {
        bail!("it doesn't begin as a version 1 .npy file does");
    };
    let (length, rest) = rest.split_at_checked(2).context("it is cut")?;
    let length = usize::from(u16::from_le_bytes([length[0], length[1]]));
    let (header, data) = rest.split_at_checked(length).context("it is cut")?;
    let header = std::str::from_utf8(header)?;
    ensure!(
        header.contains("'descr': '<f4'") && header.contains("'fortran_order': False"),
        "unexpected header {header}"
    );
    let shape = header
        .split_once("'shape': (")
        .and_then(|(_, s)| s.split_once(')'))
        .context("no shape")?
        .0;
    let (height, width) = shape.split_once(',').context("no matrix")?;
    let (height, width): (usize, usize) = (height.trim().parse()?, width.trim().parse()?);
    let values = data
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .collect();
    TruthMap::new(width, height, values)
}

#[cfg(test)]
mod tests {
    use super::parse;

    fn npy(header: &str, values: &[f32]) -> Vec<u8> {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend(u16::try_from(header.len()).expect("short").to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        bytes
    }

    #[test]
    fn a_matrix_is_read_row_by_row_and_infinity_is_unknown() {
        let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }\n";
        let map = parse(&npy(header, &[1.0, 2.0, f32::INFINITY, 4.0, 5.0, 6.0])).expect("a good file");
        assert_eq!((map.width_px, map.height_px), (3, 2));
        assert_eq!(map.disparity_px, [1.0, 2.0, 0.0, 4.0, 5.0, 6.0]);
    }

    #[test]
    fn other_types_and_cut_files_are_refused() {
        let double = "{'descr': '<f8', 'fortran_order': False, 'shape': (1, 1), }\n";
        let single = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 2), }\n";
        assert!(parse(&npy(double, &[1.0, 2.0])).is_err());
        assert!(parse(&npy(single, &[1.0])).is_err());
        assert!(parse(b"\x93NUMPY").is_err());
    }
}
