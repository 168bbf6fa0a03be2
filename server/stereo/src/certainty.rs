//! How certain a coarse result is of each pixel.

use crate::disparity::FIXED_PER_PX;
use crate::simd::{Kernel, Lanes, Level};

/// Certainties are the most confidence a pixel can have. Filled in from the neighbours:
const FILLED: u8 = 60;
/// Confidences from here on are of confirmed pixels.
pub(crate) const CONFIRMED_FROM: u8 = FILLED + 1;
/// Confirmed by the right view, but near a jump.
const CONFIRMED: u8 = 110;
/// Confirmed, and the surroundings are one surface.
const STEADY: u8 = 254;

/// Half the surroundings' width and height: 5x3 pixels.
const REACH: (usize, usize) = (2, 1);
/// Surroundings within this many 1/64 px of the level are one surface.
const ONE_SURFACE: u16 = FIXED_PER_PX * 5 / 2;

/// Scratch of a row: least and largest disparities of the rows around, with margins that repeat the border.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    least: Vec<u16>,
    most: Vec<u16>,
}

/// Turns `valid` (1 where confirmed) of the rows from `first_row` on, of a map of rows of `width`, into certainties.
pub(crate) fn rate(
    level: Level,
    (width, disparity): (usize, &[u16]),
    first_row: usize,
    valid: &mut [u8],
    scratch: &mut Scratch,
) {
    level.run(Rate {
        width,
        disparity,
        first_row,
        valid,
        scratch,
    });
}

struct Rate<'a> {
    width: usize,
    disparity: &'a [u16],
    first_row: usize,
    valid: &'a mut [u8],
    scratch: &'a mut Scratch,
}

impl Kernel for Rate<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self {
            width,
            disparity,
            first_row,
            valid,
            scratch,
        } = self;
        let last = disparity.len() / width - 1;
        let Scratch { least, most } = scratch;
        for row in [&mut *least, &mut *most] {
            row.resize(width + 2 * REACH.0, 0);
        }
        for (y, valid) in (first_row..).zip(valid.chunks_exact_mut(width)) {
            let [above, here, below] = [y.saturating_sub(REACH.1), y, (y + REACH.1).min(last)]
                .map(|y| &disparity[y * width..][..width]);
            let inner = REACH.0..REACH.0 + width;
            let columns = least[inner.clone()].iter_mut().zip(&mut most[inner]);
            for (x, (least, most)) in columns.enumerate() {
                *least = above[x].min(here[x]).min(below[x]);
                *most = above[x].max(here[x]).max(below[x]);
            }
            for row in [&mut *least, &mut *most] {
                let (first, last) = (row[REACH.0], row[REACH.0 + width - 1]);
                row[..REACH.0].fill(first);
                row[REACH.0 + width..].fill(last);
            }
            // One slice for each column of the surroundings, so that the loop needs no bounds checks.
            let lows: [&[u16]; 2 * REACH.0 + 1] = std::array::from_fn(|k| &least[k..k + width]);
            let highs: [&[u16]; 2 * REACH.0 + 1] = std::array::from_fn(|k| &most[k..k + width]);
            let valid = &mut valid[..width];
            for x in 0..width {
                let low = lows[0][x]
                    .min(lows[1][x])
                    .min(lows[2][x])
                    .min(lows[3][x])
                    .min(lows[4][x]);
                let high = highs[0][x]
                    .max(highs[1][x])
                    .max(highs[2][x])
                    .max(highs[3][x])
                    .max(highs[4][x]);
                let steady = u8::from(high - low < ONE_SURFACE) & valid[x];
                valid[x] = FILLED + (CONFIRMED - FILLED) * valid[x] + (STEADY - CONFIRMED) * steady;
            }
        }
    }
}
