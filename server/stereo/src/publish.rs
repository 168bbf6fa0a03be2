//! Writes a rung's result: disparities of the pixels asked for, their confidence, and what is known about the whole.

use std::sync::Mutex;

use crate::confidence::CostScale;
use crate::disparity::{DisparityMap, FIXED_PER_PX};
use crate::fork_join::{self, ForkJoin};
use crate::frame::Window;
use crate::image::{Roi, Shape};
use crate::params::{Density, Params};
use crate::simd::{Kernel, Lanes, Level};

/// The window's maps.
#[derive(Debug)]
pub(crate) struct Maps<'a> {
    pub(crate) window: Window,
    pub(crate) mask: &'a [u8],
    pub(crate) interpolated: &'a [u16],
    pub(crate) disparity: &'a [u16],
    pub(crate) confidence: Confidence<'a>,
}

/// The confidence of every pixel; 0 where its disparity is not validated.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Confidence<'a> {
    Known(&'a [u8]),
    /// What these costs are worth.
    OfCosts(CostScale, &'a [u8]),
}

/// What was published.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Published {
    /// Pixels asked for.
    pub(crate) asked: u32,
    /// Share of the pixels asked for that have a disparity.
    pub(crate) density: f32,
    /// Mean confidence of the mask's pixels, 0..=254, whatever was asked for.
    pub(crate) mean_confidence: f32,
    /// Share of the pixels asked for that are not what they were; 1 where that was not looked at, 0 if none was asked for.
    pub(crate) changed: f32,
}

/// A disparity that moves by this much (1/64 px), or comes or goes, has changed.
const CHANGED_FROM: u16 = FIXED_PER_PX / 4;

/// Fills `out`: in the region of interest, pixels that are validated get their disparity; dense output gets the mesh's
/// plane, with confidence 0, where there is none. If it `replaces` the frame's result before, it is compared with that.
pub(crate) fn publish(
    level: Level,
    maps: &Maps<'_>,
    (shape, params): (Shape, &Params),
    (out, replaces): (&mut DisparityMap, bool),
    join: &dyn ForkJoin,
) -> Published {
    let roi = params.roi.unwrap_or(Roi::full(shape));
    if (roi != Roi::full(shape) && !replaces) || out.shape() != shape {
        out.reset(shape);
    }
    let width = shape.width_px();
    let rows = roi.height.div_ceil(fork_join::pieces(join));
    let all = Mutex::new(Counts::default());
    let (fixed, confidence) = out.parts_mut();
    let asked = roi.y * width..(roi.y + roi.height) * width;
    let parts = fixed[asked.clone()].chunks_mut(rows * width);
    let parts = parts.zip(confidence[asked].chunks_mut(rows * width));
    fork_join::for_each(join, parts, |piece, (fixed, confidence)| {
        let counts = level.run(Publish {
            maps,
            roi,
            params,
            replaces,
            first_row: roi.y + piece * rows,
            width,
            fixed,
            confidence,
        });
        if let Ok(mut all) = all.lock() {
            all.add(&counts);
        }
    });
    let all = all.into_inner().unwrap_or_default();
    Published {
        asked: all.asked,
        density: share(all.answered, all.asked),
        mean_confidence: share(all.confidence, all.textured),
        changed: if replaces || all.asked == 0 {
            share(all.changed, all.asked)
        } else {
            1.0
        },
    }
}

struct Publish<'a> {
    maps: &'a Maps<'a>,
    roi: Roi,
    params: &'a Params,
    /// Whether the output holds the frame's result before.
    replaces: bool,
    /// Whole rows of the output.
    first_row: usize,
    width: usize,
    fixed: &'a mut [u16],
    confidence: &'a mut [u8],
}

impl Kernel for Publish<'_> {
    type Output = Counts;

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> Counts {
        let Self {
            maps,
            roi,
            params,
            replaces,
            first_row,
            width,
            fixed,
            confidence,
        } = self;
        let window = maps.window.roi;
        #[expect(clippy::cast_possible_truncation, reason = "between 0 and 255")]
        #[expect(clippy::cast_sign_loss, reason = "between 0 and 255")]
        let rule = Rule {
            everything: u8::from(params.density == Density::Dense),
            least_confidence: (255.0 * params.min_confidence).ceil() as u8,
            offset: params.range.min_px * FIXED_PER_PX,
        };
        let mut all = Counts::default();
        let rows = fixed
            .chunks_exact_mut(width)
            .zip(confidence.chunks_exact_mut(width));
        for (y, (fixed, confidence)) in (first_row..).zip(rows) {
            let from = (y - window.y) * window.width + roi.x - window.x;
            let span = from..from + roi.width;
            let target = roi.x..roi.x + roi.width;
            let row = Row {
                mask: &maps.mask[span.clone()],
                interpolated: &maps.interpolated[span.clone()],
                disparity: &maps.disparity[span.clone()],
                confidence: match maps.confidence {
                    Confidence::Known(map) => Confidence::Known(&map[span]),
                    Confidence::OfCosts(scale, map) => Confidence::OfCosts(scale, &map[span]),
                },
            };
            let out = (&mut fixed[target.clone()], &mut confidence[target]);
            let counts = if replaces {
                rule.write_row::<true>(&row, out)
            } else {
                rule.write_row::<false>(&row, out)
            };
            all.add(&counts);
        }
        all
    }
}

struct Row<'a> {
    mask: &'a [u8],
    interpolated: &'a [u16],
    disparity: &'a [u16],
    confidence: Confidence<'a>,
}

#[derive(Default)]
struct Counts {
    asked: u32,
    answered: u32,
    changed: u32,
    textured: u32,
    /// Sum over the mask; below 2^32 for 4096 x 4096 pixels.
    confidence: u32,
}

impl Counts {
    fn add(&mut self, others: &Self) {
        self.asked += others.asked;
        self.answered += others.answered;
        self.changed += others.changed;
        self.textured += others.textured;
        self.confidence += others.confidence;
    }
}

struct Rule {
    /// 1 if pixels outside the mask and without validation are wanted too.
    everything: u8,
    least_confidence: u8,
    offset: u16,
}

/// Pixels of one block: plain loops over arrays of this length become vector code. Their words fill the longest vector: what one
/// loop stores, the next one loads as it was stored.
const BLOCK: usize = 32;

/// Counts of a row, one for each place in a block. No row has more than 128 blocks.
struct Tally {
    asked: [u8; BLOCK],
    answered: [u8; BLOCK],
    changed: [u16; BLOCK],
    textured: [u8; BLOCK],
    confidence: [u16; BLOCK],
}

impl Rule {
    #[inline(always)]
    fn write_row<const COMPARES: bool>(
        &self,
        row: &Row<'_>,
        (fixed, confidence): (&mut [u16], &mut [u8]),
    ) -> Counts {
        let mut tally = Tally {
            asked: [0; BLOCK],
            answered: [0; BLOCK],
            changed: [0; BLOCK],
            textured: [0; BLOCK],
            confidence: [0; BLOCK],
        };
        let n = fixed.len();
        if n < BLOCK {
            for x in 0..n {
                self.write::<1, COMPARES>(row, (x, x), (fixed, confidence), &mut tally);
            }
        } else {
            // The last block overlaps the one before where the row is no multiple: single pixels are many times slower.
            for counted in (0..n).step_by(BLOCK) {
                let at = (counted.min(n - BLOCK), counted);
                self.write::<BLOCK, COMPARES>(row, at, (fixed, confidence), &mut tally);
            }
        }
        let sum = |counts: &[u8]| counts.iter().copied().map(u32::from).sum();
        Counts {
            asked: sum(&tally.asked),
            answered: sum(&tally.answered),
            changed: tally.changed.iter().copied().map(u32::from).sum(),
            textured: sum(&tally.textured),
            confidence: tally.confidence.iter().copied().map(u32::from).sum(),
        }
    }

    /// `N` pixels from column `x` on, of which those from column `counted` on are counted.
    #[inline(always)]
    fn write<const N: usize, const COMPARES: bool>(
        &self,
        row: &Row<'_>,
        (x, counted): (usize, usize),
        (fixed, confidence): (&mut [u16], &mut [u8]),
        tally: &mut Tally,
    ) {
        let span = x..x + N;
        let (fixed, confidence) = (&mut fixed[span.clone()], &mut confidence[span.clone()]);
        match row.confidence {
            Confidence::Known(map) => confidence.copy_from_slice(&map[span.clone()]),
            Confidence::OfCosts(scale, costs) => scale.rate(&costs[span.clone()], confidence),
        }
        let mask = &row.mask[span.clone()];
        let (interpolated, disparity) = (&row.interpolated[span.clone()], &row.disparity[span]);
        #[expect(clippy::cast_possible_truncation, reason = "less than a block")]
        let skipped = (counted - x) as u8;
        // Bytes and words by themselves: mixed, vectors would be taken apart and put together again and again.
        let (mut valid, mut kept, mut counted) = ([0; N], [0; N], [0; N]);
        for (x, place) in (0..N).zip(0u8..) {
            let sure = confidence[x];
            valid[x] = u8::from(sure > 0);
            let wanted = mask[x] | self.everything;
            kept[x] = wanted & (valid[x] | self.everything) & u8::from(sure >= self.least_confidence);
            confidence[x] = sure & kept[x].wrapping_neg();
            let counts = u8::from(place >= skipped);
            tally.asked[x] += wanted & counts;
            tally.answered[x] += kept[x] & counts;
            let textured = mask[x] & counts;
            tally.textured[x] += textured;
            counted[x] = sure & textured.wrapping_neg();
        }
        for (all, counted) in tally.confidence.iter_mut().zip(counted) {
            *all += u16::from(counted);
        }
        let mut moved = [0; N];
        for x in 0..N {
            let valid = u16::from(valid[x]).wrapping_neg();
            let value = (disparity[x] & valid) | (interpolated[x] & !valid);
            let value = (value + self.offset).max(1) & u16::from(kept[x]).wrapping_neg();
            if COMPARES {
                let before = fixed[x];
                let is_moved = before.abs_diff(value) >= CHANGED_FROM;
                moved[x] = u16::from(is_moved | ((before > 0) != (value > 0)));
            }
            fixed[x] = value;
        }
        if COMPARES {
            for (all, moved) in tally.changed.iter_mut().zip(moved) {
                *all += moved;
            }
        }
    }
}

fn share(part: u32, whole: u32) -> f32 {
    if whole == 0 {
        0.0
    } else {
        part as f32 / whole as f32
    }
}

#[cfg(test)]
mod tests;
