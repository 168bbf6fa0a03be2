//! One level of the image pyramid: a band of semi-global matching around a prior, checked, cleaned and filled.

use std::ops::Range;

use crate::band::{Band, GROUP, Grid, Half, Penalties, Sweep, Views};
use crate::census::{Census, Pattern};
use crate::disparity::FIXED_PER_PX;
use crate::fork_join::{self, ForkJoin};
use crate::plane::Plane;
use crate::simd::{Kernel, LABELS, Lanes, Level};
use crate::speckle::Speckle;
use crate::{certainty, fill, upsample, winner};

/// What differs between levels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Constants {
    pub(crate) penalties: Penalties,
    /// Islands of up to this many pixels are removed.
    pub(crate) speckle_px: u32,
}

/// Where a level's work goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Step {
    /// Matching costs, paths along rows, and those from the top and the bottom until they meet; `done` rows of each are.
    Begin { done: usize },
    /// Vertical paths from there on, winners, and whether both views agree.
    Finish { done: usize },
    /// Speckles removed, gaps filled.
    Clean,
}

impl Step {
    /// The first one.
    pub(crate) const START: Self = Self::Begin { done: 0 };
}

/// Rows of each half in one step of one thread.
const ROWS_A_STEP: usize = 64;
/// Rows that are taken from their costs to their sums while both are in the cache.
const ROWS_AT_ONCE: usize = 32;

/// Labels of the band below its centre; there is one more above it.
const BELOW_CENTRE: u16 = 7;

/// Columns and rows of a full resolution map from one centre to the next.
const CENTRES_APART: u16 = 4;

/// Where to cut `from..end` after `rows` rows, or a few more if less than a group of rows were left.
fn cut(from: usize, rows: usize, end: usize) -> usize {
    if from + rows + GROUP > end {
        end
    } else {
        from + rows
    }
}

/// One view of a level.
#[derive(Debug, Default)]
struct Side {
    image: Plane,
    census: Census,
}

impl Side {
    /// Half the resolution of `of`, and its words; `inside` are the columns of its padded rows that show real pixels.
    fn shrink(&mut self, level: Level, of: &Plane, mirrored: bool, inside: Range<usize>) {
        let pattern = Pattern::Sparse9x7First;
        self.image.halve(level, of);
        self.census
            .reshape(pattern, &self.image, self.image.height(), mirrored);
        self.census.compute(level, pattern, &self.image, halved(&inside));
    }
}

/// The columns that show real pixels at half the resolution.
fn halved(inside: &Range<usize>) -> Range<usize> {
    inside.start.div_ceil(2)..inside.end / 2
}

/// Scratch of a piece of the work.
#[derive(Debug, Default)]
struct Scratch {
    winners: winner::Scratch,
    around: certainty::Scratch,
    centres: Vec<u16>,
}

/// Planes, band and result of one level.
#[derive(Debug, Default)]
pub(crate) struct Coarse {
    left: Side,
    right: Side,
    band: Band,
    /// Real columns of the right view left of the window.
    columns_before: isize,
    /// Disparities of this level.
    labels: usize,
    /// In 1/64 px of this level.
    disparity: Vec<u16>,
    valid: Vec<u8>,
    speckle: Speckle,
    gaps: [fill::Scratch; 2],
    scratch: Vec<Scratch>,
}

/// Makes two levels: `half` from `left` and `right`, with `disparities` there, and `quarter` from that. `inside` are the
/// columns of their padded rows that show real pixels.
pub(crate) fn shrink(
    level: Level,
    [half, quarter]: [&mut Coarse; 2],
    (left, right): (&Plane, &Plane),
    (inside_left, inside_right): (Range<usize>, Range<usize>),
    disparities: usize,
    join: &dyn ForkJoin,
) {
    let sides = [
        (&mut half.left, &mut quarter.left, left, inside_left, false),
        (
            &mut half.right,
            &mut quarter.right,
            right,
            inside_right.clone(),
            true,
        ),
    ];
    fork_join::for_each(
        join,
        sides.into_iter(),
        |_, (half, quarter, view, inside, mirrored)| {
            half.shrink(level, view, mirrored, inside.clone());
            quarter.shrink(level, &half.image, mirrored, halved(&inside));
        },
    );
    let inside = halved(&inside_right);
    quarter.begin(halved(&inside).start, disparities / 4);
    half.begin(inside.start, disparities / 2);
}

impl Coarse {
    /// Room for the level of the views, with `labels` disparities; the right one shows real pixels from `first_real` on.
    fn begin(&mut self, first_real: usize, labels: usize) {
        self.labels = labels.max(LABELS);
        self.columns_before = self.right.image.margin_left().cast_signed() - first_real.cast_signed();
        let (width, height) = (self.width(), self.height());
        self.band.reshape(width, height);
        self.disparity.resize(width * height, 0);
        self.valid.resize(width * height, 0);
    }

    pub(crate) fn width(&self) -> usize {
        self.left.image.width()
    }

    pub(crate) fn height(&self) -> usize {
        self.left.image.height()
    }

    /// The result: disparities in 1/64 px of this level, and how certain they are if rated, else ones where they are known.
    pub(crate) fn result(&self) -> (&[u16], &[u8]) {
        (&self.disparity, &self.valid)
    }

    /// Centres the bands on a full resolution map (rows of `width`), which is [`CENTRES_APART`] times as fine.
    pub(crate) fn centre_on_map(&mut self, level: Level, map: &[u16], width: usize, join: &dyn ForkJoin) {
        let (apart, last) = (usize::from(CENTRES_APART), map.len() / width - 1);
        self.centre(level, join, |y, centres| {
            let row = &map[(apart * y + apart / 2).min(last) * width..][..width];
            for (centre, group) in centres.iter_mut().zip(row.chunks(apart)) {
                // The last pixel may be cut off before its centre.
                *centre = group[(apart / 2).min(group.len() - 1)] / CENTRES_APART;
            }
        });
    }

    /// Centres the bands on the next coarser level's result.
    pub(crate) fn centre_on(&mut self, level: Level, coarser: &Self, join: &dyn ForkJoin) {
        let (map, width) = (&coarser.disparity, coarser.width());
        self.centre(level, join, |y, centres| {
            upsample::row(level, map, width, y, u16::MAX, centres);
        });
    }

    /// Bands around the rows that `fill` makes, in 1/64 px, kept within the labels there are.
    fn centre(&mut self, level: Level, join: &dyn ForkJoin, fill: impl Fn(usize, &mut [u16]) + Sync) {
        let (width, height, labels) = (self.width(), self.height(), self.labels);
        let pitch = self.band.grid.pitch();
        let scratch = fork_join::scratch(join, &mut self.scratch);
        let rows = height.div_ceil(scratch.len());
        let parts = self.band.grid.first_mut().chunks_mut(rows * pitch).zip(scratch);
        fork_join::for_each(join, parts, |piece, (first, scratch)| {
            let centres = &mut scratch.centres;
            centres.resize(width, 0);
            for (y, starts) in (piece * rows..).zip(first.chunks_exact_mut(pitch)) {
                fill(y, centres);
                let (inside, padding) = starts.split_at_mut(width);
                level.run(Centre {
                    centres,
                    largest: u8::try_from(labels - LABELS).unwrap_or(u8::MAX),
                    starts: inside,
                });
                padding.fill(inside[width - 1]);
            }
        });
    }

    /// One step of the way from the bands to the filled result, beginning with [`Step::START`]; the answer is the next one.
    pub(crate) fn solve(
        &mut self,
        level: Level,
        constants: &Constants,
        step: Step,
        join: &dyn ForkJoin,
    ) -> Option<Step> {
        match step {
            Step::Begin { done } | Step::Finish { done } => {
                let is_begun = matches!(step, Step::Finish { .. });
                // The upper half is the one that may have a row less.
                let shorter = self.band.halves[0].len();
                let end = cut(done, fork_join::in_a_step(join, ROWS_A_STEP), shorter);
                let is_last = end == shorter;
                self.follow(
                    level,
                    constants,
                    (done, (!is_last).then_some(end)),
                    is_begun,
                    join,
                );
                Some(match (is_begun, is_last) {
                    (false, false) => Step::Begin { done: end },
                    (false, true) => Step::Finish { done: 0 },
                    (true, false) => Step::Finish { done: end },
                    (true, true) => Step::Clean,
                })
            }
            Step::Clean => {
                let width = self.width();
                self.speckle.remove(
                    level,
                    width,
                    &self.disparity,
                    &mut self.valid,
                    constants.speckle_px,
                );
                fill::fill(
                    level,
                    width,
                    &mut self.disparity,
                    &self.valid,
                    &mut self.gaps,
                    join,
                );
                None
            }
        }
    }

    /// Takes both vertical sweeps from row `start` to `end`, or through the rest, of the half where each begins, or
    /// (`is_begun`) of the other one.
    fn follow(
        &mut self,
        level: Level,
        constants: &Constants,
        (start, end): (usize, Option<usize>),
        is_begun: bool,
        join: &dyn ForkJoin,
    ) {
        let width = self.width();
        let views = Views {
            image: &self.left.image,
            left: &self.left.census,
            right: &self.right.census,
            penalties: constants.penalties,
        };
        if self.scratch.len() < 2 {
            self.scratch.resize_with(2, Default::default);
        }
        let Band { grid, halves, sweeps } = &mut self.band;
        let middle = halves[0].len() * width;
        let (upper, lower) = self.disparity.split_at_mut(middle);
        let (valid_upper, valid_lower) = self.valid.split_at_mut(middle);
        if is_begun {
            sweeps.reverse();
        }
        let results = [(upper, valid_upper), (lower, valid_lower)].into_iter();
        let parts = halves
            .iter_mut()
            .zip(&mut *sweeps)
            .zip(results)
            .zip(&mut self.scratch);
        let (grid, columns_before) = (&*grid, self.columns_before);
        fork_join::for_each(
            join,
            parts,
            |_, (((half, sweep), (disparity, valid)), scratch)| {
                let rows = start..end.unwrap_or(half.len());
                if is_begun {
                    let winners = Winners {
                        columns_before,
                        scratch: &mut scratch.winners,
                        disparity,
                        valid,
                    };
                    winners.follow(level, (grid, &views), half, sweep, rows);
                } else {
                    let mut from = rows.start;
                    while from < rows.end {
                        let to = cut(from, ROWS_AT_ONCE, rows.end);
                        let here = sweep.rows(half, from..to);
                        sweep.begin(level, (grid, &views), half, here);
                        from = to;
                    }
                }
            },
        );
        if is_begun {
            sweeps.reverse();
        }
    }

    /// Turns what is known of each pixel of the result into how certain it is (see `certainty`).
    pub(crate) fn rate(&mut self, level: Level, join: &dyn ForkJoin) {
        let (width, height, disparity) = (self.width(), self.height(), &self.disparity);
        let scratch = fork_join::scratch(join, &mut self.scratch);
        let rows = height.div_ceil(scratch.len());
        let parts = self.valid.chunks_mut(rows * width).zip(scratch);
        fork_join::for_each(join, parts, |piece, (valid, scratch)| {
            certainty::rate(
                level,
                (width, disparity),
                piece * rows,
                valid,
                &mut scratch.around,
            );
        });
    }
}

/// Where a half's winners go.
struct Winners<'a> {
    columns_before: isize,
    scratch: &'a mut winner::Scratch,
    disparity: &'a mut [u16],
    valid: &'a mut [u8],
}

impl Winners<'_> {
    /// Follows the last vertical paths through `rows` of `half`, and chooses there.
    fn follow(
        self,
        level: Level,
        (grid, views): (&Grid, &Views<'_>),
        half: &mut Half,
        sweep: &mut Sweep,
        rows: Range<usize>,
    ) {
        let width = views.image.width();
        for row in rows {
            let here = sweep.rows(half, row..row + 1);
            let y = here.start;
            sweep.along(level, (grid, views), half, here);
            let pixels = (y - half.top()) * width..(y + 1 - half.top()) * width;
            winner::row(
                level,
                (grid, half, self.columns_before),
                y,
                self.scratch,
                (&mut self.disparity[pixels.clone()], &mut self.valid[pixels]),
            );
        }
    }
}

struct Centre<'a> {
    /// In 1/64 px.
    centres: &'a [u16],
    largest: u8,
    starts: &'a mut [u8],
}

impl Kernel for Centre<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        for (start, centre) in self.starts.iter_mut().zip(self.centres) {
            let nearest = (centre + FIXED_PER_PX / 2) / FIXED_PER_PX;
            #[expect(clippy::cast_possible_truncation, reason = "at most `largest`")]
            {
                *start = nearest.saturating_sub(BELOW_CENTRE).min(u16::from(self.largest)) as u8;
            }
        }
    }
}
