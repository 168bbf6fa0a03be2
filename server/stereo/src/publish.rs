//! Writes a rung's result: disparities of the pixels asked for, their confidence, and what is known about the whole.

use std::sync::Mutex;

use block::{BLOCK, Block, Row, Rule};

use crate::changes::{Blocks, Changes};
use crate::confidence::{CostScale, Dense};
use crate::disparity::DisparityMap;
use crate::fork_join::{self, ForkJoin};
use crate::frame::Window;
use crate::image::{Roi, Shape};
use crate::params::Params;
use crate::simd::{Kernel, Lanes, Level};

mod block;

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
    /// What is known of a dense rung (see `confidence::rate_dense`).
    OfCertainties {
        scale: CostScale,
        /// Half resolution rows of `width`.
        certainties: &'a [u8],
        width: usize,
        costs: Option<&'a [u8]>,
    },
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

/// What the output holds.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Before<'a> {
    /// Another frame's result, or none.
    Nothing,
    /// The frame's result before.
    Result,
    /// The same for the whole image, which is the window; only these blocks, within this reach, are not what they were then.
    ResultBut(&'a Changes, usize),
}

/// What was counted in the last result, by blocks, so that those that stay need no look.
#[derive(Debug, Default)]
pub(crate) struct Record {
    blocks: Vec<Block>,
    all: Counts,
}

/// Fills `out`: in the region of interest, pixels that are validated get their disparity; dense output gets the mesh's
/// plane, with confidence 0, where there is none. The frame's result `before` is compared with this one. What `record` keeps
/// belongs to `out`.
pub(crate) fn publish(
    level: Level,
    maps: &Maps<'_>,
    (shape, params): (Shape, &Params),
    (out, before, record): (&mut DisparityMap, Before<'_>, &mut Record),
    join: &dyn ForkJoin,
) -> Published {
    let roi = params.roi.unwrap_or(Roi::full(shape));
    let replaces = !matches!(before, Before::Nothing);
    if (roi != Roi::full(shape) && !replaces) || out.shape() != shape {
        out.reset(shape);
    }
    let width = shape.width_px();
    let rows = roi.height.div_ceil(fork_join::pieces(join));
    let across = roi.width.div_ceil(BLOCK);
    if !matches!(before, Before::ResultBut(..)) {
        record.blocks.clear();
        record.blocks.resize(roi.height * across, Block::default());
        record.all = Counts::default();
    }
    let news = Mutex::new(Counts::default());
    let (fixed, confidence) = out.parts_mut();
    let asked = roi.y * width..(roi.y + roi.height) * width;
    let parts = fixed[asked.clone()].chunks_mut(rows * width);
    let parts = parts.zip(confidence[asked].chunks_mut(rows * width));
    let parts = parts.zip(record.blocks.chunks_mut(rows * across));
    fork_join::for_each(join, parts, |piece, ((fixed, confidence), blocks)| {
        let counts = level.run(Publish {
            maps,
            roi,
            params,
            before,
            first_row: roi.y + piece * rows,
            width,
            fixed,
            confidence,
            blocks,
        });
        if let Ok(mut news) = news.lock() {
            news.add(&counts);
        }
    });
    let news = news.into_inner().unwrap_or_default();
    record.all.add(&news);
    let all = &record.all;
    Published {
        asked: all.asked,
        density: share(all.answered, all.asked),
        mean_confidence: share(all.confidence, all.textured),
        changed: if replaces || all.asked == 0 {
            share(news.changed, all.asked)
        } else {
            1.0
        },
    }
}

struct Publish<'a> {
    maps: &'a Maps<'a>,
    roi: Roi,
    params: &'a Params,
    before: Before<'a>,
    /// Whole rows of the output.
    first_row: usize,
    width: usize,
    fixed: &'a mut [u16],
    confidence: &'a mut [u8],
    blocks: &'a mut [Block],
}

impl Kernel for Publish<'_> {
    type Output = Counts;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Counts {
        let Self {
            maps,
            roi,
            params,
            before,
            first_row,
            width,
            fixed,
            confidence,
            blocks,
        } = self;
        let window = maps.window.roi;
        let scale = match maps.confidence {
            Confidence::Known(_) | Confidence::OfCertainties { .. } => None,
            Confidence::OfCosts(scale, _) => Some(scale),
        };
        let rule = Rule::new(params, scale);
        let mut all = Counts::default();
        let mut rated = [0; Shape::MAX_SIDE_PX];
        let rows = fixed
            .chunks_exact_mut(width)
            .zip(confidence.chunks_exact_mut(width))
            .zip(blocks.chunks_exact_mut(roi.width.div_ceil(BLOCK)));
        for (y, ((fixed, confidence), blocks)) in (first_row..).zip(rows) {
            let from = (y - window.y) * window.width + roi.x - window.x;
            let span = from..from + roi.width;
            let target = roi.x..roi.x + roi.width;
            let rated = match maps.confidence {
                Confidence::Known(map) | Confidence::OfCosts(_, map) => &map[span.clone()],
                Confidence::OfCertainties {
                    scale,
                    certainties,
                    width,
                    costs,
                } => {
                    let row = y - window.y;
                    let dense = Dense {
                        scale,
                        certainties: &certainties[row / 2 * width..][..width],
                        costs: costs.map(|costs| &costs[row * window.width..][..window.width]),
                        confidence: &mut rated[..window.width],
                    };
                    dense.run(lanes);
                    &rated[roi.x - window.x..][..roi.width]
                }
            };
            let mut row = Row {
                mask: &maps.mask[span.clone()],
                interpolated: &maps.interpolated[span.clone()],
                disparity: &maps.disparity[span],
                rated,
                fixed: &mut fixed[target.clone()],
                confidence: &mut confidence[target],
                changed: &mut [0; BLOCK],
            };
            let wanted = match before {
                Before::Nothing | Before::Result => Blocks::ALL,
                Before::ResultBut(changes, reach) => changes.blocks(y, reach),
            };
            for run in wanted.runs(roi.width) {
                let numbers = run.start / BLOCK..run.end.div_ceil(BLOCK);
                for (number, known) in numbers.clone().zip(&mut blocks[numbers]) {
                    let counted = rule.write(lanes, &mut row, number);
                    all.replace(known, &counted);
                    *known = counted;
                }
            }
            all.changed += row.changed.iter().copied().map(u32::from).sum::<u32>();
        }
        all
    }
}

/// Sums of blocks, or how much they grew, wrapping.
#[derive(Debug, Default)]
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
        self.asked = self.asked.wrapping_add(others.asked);
        self.answered = self.answered.wrapping_add(others.answered);
        self.changed = self.changed.wrapping_add(others.changed);
        self.textured = self.textured.wrapping_add(others.textured);
        self.confidence = self.confidence.wrapping_add(others.confidence);
    }

    /// Counts `new` in the place of `old`.
    #[inline(always)]
    fn replace(&mut self, old: &Block, new: &Block) {
        let grow = |sum: &mut u32, old: u16, new: u16| {
            *sum = sum.wrapping_add(u32::from(new)).wrapping_sub(u32::from(old));
        };
        grow(&mut self.asked, old.asked.into(), new.asked.into());
        grow(&mut self.answered, old.answered.into(), new.answered.into());
        grow(&mut self.textured, old.textured.into(), new.textured.into());
        grow(&mut self.confidence, old.confidence, new.confidence);
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
