//! Recovery: what half the resolution lost. A thing of a few pixels' width is often gone there, and no correction by a pixel
//! brings it back; so the paper's last step is taken once more, with the dense result in the mesh's place: where it explains
//! the images badly, pixels are searched for over the whole range.
//!
//! ```text
//! in every cell of 4x4 px, of the badly explained pixels the one with the strongest gradient is searched for, as a support is:
//!     it must look like its match, like nothing else, and be found again from the right view
//! a match is dropped if it is the match of a well explained pixel already    (uniqueness; Marr and Poggio 1976)
//! the pixels within 8 px of a match try its disparity, and take it where it saves a sixth of all bits
//! ```

use crate::changes::Changes;
use crate::disparity::FIXED_PER_PX;
use crate::support::Support;

/// Side of a cell in px, a power of two.
pub(crate) const CELL_PX: usize = 4;
/// Largest cost (of 250) of a well explained pixel.
pub(crate) const EXPLAINED_UP_TO: u8 = 85;
/// A disparity that is tried must save more than this (of 250).
pub(crate) const LEAST_GAIN: u8 = 40;
/// Columns and rows to each side of a match that try its disparity.
const REACH_PX: usize = 8;
/// At most one pixel of so many is searched for, whatever the images: about twice as many as real scenes ask for.
pub(crate) const PX_A_SEARCH: usize = 64;
/// At most one of so many lends its disparity: about four times as many as in real scenes.
pub(crate) const PX_A_MATCH: usize = 256;

/// Leaves `most` of the `pixels`, evenly spread, if there are more.
pub(crate) fn spare<T>(pixels: &mut Vec<T>, most: usize) {
    let all = pixels.len();
    if all <= most {
        return;
    }
    let mut number = 0;
    pixels.retain(|_| {
        number += 1;
        number * most / all > (number - 1) * most / all
    });
}

/// Drops the `matches` whose place in the right view is within a pixel of the match of a well explained pixel. `disparity` and
/// `cost` are the map's (rows of `width`, below `disparities` px).
pub(crate) fn drop_taken(
    matches: &mut Vec<Support>,
    (disparity, cost): (&[u16], &[u8]),
    width: usize,
    disparities: usize,
) {
    matches.retain(|found| {
        let fixed = fixed(found);
        // In 1/64 px, and so far to the right that it is not negative.
        let place = |x: usize, fixed: u16| (x + disparities) * usize::from(FIXED_PER_PX) - usize::from(fixed);
        let wanted = place(found.x, fixed);
        // Pixels with disparities from the smallest to the largest that show the same place.
        let first = found.x.saturating_sub(usize::from(fixed / FIXED_PER_PX));
        let mut columns = first..(first + disparities).min(width);
        let row = found.y * width;
        !columns.any(|x| {
            let is_explained = cost[row + x] <= EXPLAINED_UP_TO;
            is_explained && place(x, disparity[row + x]).abs_diff(wanted) <= usize::from(FIXED_PER_PX)
        })
    });
}

/// Writes the disparities of `matches` over those of the pixels in their reach in `candidates` (rows of `width`, 1/64 px, at
/// most `max_fixed`), the nearest match's where there are several, and marks these pixels in `changes`.
pub(crate) fn lend(
    matches: &[Support],
    (candidates, width): (&mut [u16], usize),
    max_fixed: u16,
    changes: &mut Changes,
) {
    let height = candidates.len() / width;
    // Squares from the largest to the match itself: what is nearer comes later and stays.
    for reach in (0..=REACH_PX).rev().step_by(2) {
        for found in matches {
            let columns = found.x.saturating_sub(reach)..(found.x + reach + 1).min(width);
            for y in found.y.saturating_sub(reach)..(found.y + reach + 1).min(height) {
                candidates[y * width..][columns.clone()].fill(fixed(found).min(max_fixed));
                changes.mark(y, columns.start, columns.end - 1);
            }
        }
    }
}

/// The disparity in 1/64 px.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "0 to 255 px"
)]
fn fixed(found: &Support) -> u16 {
    (found.disparity_px * f32::from(FIXED_PER_PX) + 0.5) as u16
}

#[cfg(test)]
mod tests;
