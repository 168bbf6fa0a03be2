//! Portable float maps, as Middlebury and ETH3D hold disparity: `Pf`, width and height, a scale whose sign tells the byte
//! order, then 32-bit floats from the bottom row to the top one. Unknown is infinity.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};

use crate::truth::TruthMap;

/// Reads a one-channel map.
pub(super) fn read(path: &Path) -> Result<TruthMap> {
    parse(&super::read(path)?).with_context(|| format!("{} isn't a gray PFM file", path.display()))
}

fn parse(bytes: &[u8]) -> Result<TruthMap> {
    let mut rest = bytes;
    let kind = word(&mut rest)?;
    ensure!(kind == "Pf", "it begins with {kind:?} instead of \"Pf\"");
    let width: usize = word(&mut rest)?.parse().context("width")?;
    let height: usize = word(&mut rest)?.parse().context("height")?;
    let scale: f32 = word(&mut rest)?.parse().context("scale")?;
    let needed = width
        .checked_mul(height)
        .and_then(|n| n.checked_mul(4))
        .context("its size overflows")?;
    ensure!(
        width > 0 && rest.len() == needed,
        "{width} x {height} floats need {needed} bytes, got {}",
        rest.len()
    );
    let value = |b: &[u8]| {
        let b = [b[0], b[1], b[2], b[3]];
        if scale < 0.0 {
            f32::from_le_bytes(b)
        } else {
            f32::from_be_bytes(b)
        }
    };
    let rows = rest.chunks_exact(4 * width).rev();
    TruthMap::new(
        width,
        height,
        rows.flat_map(|row| row.chunks_exact(4).map(value)).collect(),
    )
}

/// Takes one word and the one white space after it.
fn word<'a>(rest: &mut &'a [u8]) -> Result<&'a str> {
    let Some(end) = rest.iter().position(u8::is_ascii_whitespace) else {
        bail!("its header ends early");
    };
    let word = std::str::from_utf8(&rest[..end])?;
    *rest = &rest[end + 1..];
    Ok(word)
}

#[cfg(test)]
mod tests {
    use super::parse;

    #[test]
    fn rows_come_bottom_up_in_the_byte_order_of_the_scales_sign() {
        let mut little = b"Pf\n2 2\n-1.0\n".to_vec();
        let mut big = b"Pf\n2 2\n1.0\n".to_vec();
        for value in [1.0_f32, 2.0, f32::INFINITY, 4.0] {
            little.extend(value.to_le_bytes());
            big.extend(value.to_be_bytes());
        }
        for bytes in [little, big] {
            assert_eq!(
                parse(&bytes).expect("a good file").disparity_px,
                [0.0, 4.0, 1.0, 2.0]
            );
        }
    }

    #[test]
    fn a_cut_or_coloured_file_is_refused() {
        for bytes in [&b"PF\n1 1\n-1\n0000"[..], b"Pf\n2 2\n-1\n0000", b"Pf\n2", b""] {
            assert!(parse(bytes).is_err(), "{bytes:?}");
        }
    }
}
