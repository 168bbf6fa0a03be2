//! One level of the image pyramid: a band of semi-global matching around a prior, checked, cleaned and filled.

use crate::band::{Band, GROUP, Penalties, Views};
use crate::census::{Census, Pattern};
use crate::disparity::FIXED_PER_PX;
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
    /// Matching costs and paths along rows and from the top, from row `row` on.
    Forwards { row: usize },
    /// Paths from the bottom, winners, and whether both views agree, above row `end`.
    Backwards { end: usize },
    /// Speckles removed, gaps filled.
    Clean,
}

impl Step {
    /// The first one.
    pub(crate) const START: Self = Self::Forwards { row: 0 };
}

/// Rows in one step.
const ROWS_A_STEP: usize = 128;
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

/// Planes, band and result of one level.
#[derive(Debug, Default)]
pub(crate) struct Coarse {
    left: Plane,
    right: Plane,
    left_census: Census,
    right_census: Census,
    band: Band,
    /// Real columns of the right view left of the window.
    columns_before: isize,
    /// Disparities of this level.
    labels: usize,
    /// In 1/64 px of this level.
    disparity: Vec<u16>,
    valid: Vec<u8>,
    speckle: Speckle,
    gaps: fill::Scratch,
    around: certainty::Scratch,
    winners: winner::Scratch,
    row: Vec<u16>,
}

impl Coarse {
    /// The images at half the resolution of `left` and `right`, with `disparities` there; `inside` are the columns of their
    /// padded rows that show real pixels.
    pub(crate) fn begin(
        &mut self,
        level: Level,
        (left, right): (&Plane, &Plane),
        (inside_left, inside_right): (std::ops::Range<usize>, std::ops::Range<usize>),
        disparities: usize,
    ) {
        self.left.halve(level, left);
        self.right.halve(level, right);
        self.labels = (disparities / 2).max(LABELS);
        self.left_census
            .reshape(Pattern::Sparse9x7First, &self.left, false);
        self.right_census
            .reshape(Pattern::Sparse9x7First, &self.right, true);
        let half = |range: std::ops::Range<usize>| range.start.div_ceil(2)..range.end / 2;
        self.left_census
            .compute(level, Pattern::Sparse9x7First, &self.left, half(inside_left));
        self.right_census.compute(
            level,
            Pattern::Sparse9x7First,
            &self.right,
            half(inside_right.clone()),
        );
        let first_real = half(inside_right).start;
        self.columns_before = self.right.margin_left().cast_signed() - first_real.cast_signed();
        let (width, height) = (self.left.width(), self.left.height());
        self.band.reshape(width, height);
        self.disparity.resize(width * height, 0);
        self.valid.resize(width * height, 0);
    }

    pub(crate) fn planes(&self) -> (&Plane, &Plane) {
        (&self.left, &self.right)
    }

    pub(crate) fn width(&self) -> usize {
        self.left.width()
    }

    pub(crate) fn height(&self) -> usize {
        self.left.height()
    }

    /// The result: disparities in 1/64 px of this level, and how certain they are (see `certainty`).
    pub(crate) fn result(&self) -> (&[u16], &[u8]) {
        (&self.disparity, &self.valid)
    }

    /// Centres the bands on a full resolution map (rows of `width`), which is [`CENTRES_APART`] times as fine.
    pub(crate) fn centre_on_map(&mut self, level: Level, map: &[u16], width: usize) {
        let (apart, last) = (usize::from(CENTRES_APART), map.len() / width - 1);
        let inside = self.left.width();
        for y in 0..self.height() {
            let row = &map[(apart * y + apart / 2).min(last) * width..][..width];
            // The last pixel may be cut off before its centre.
            let centre = |group: &[u16]| group[(apart / 2).min(group.len() - 1)] / CENTRES_APART;
            self.row.clear();
            self.row.extend(row.chunks(apart).take(inside).map(centre));
            self.centre_row(level, y);
        }
    }

    /// Centres the bands on the next coarser level's result.
    pub(crate) fn centre_on(&mut self, level: Level, coarser: &Self) {
        self.row.resize(self.left.width(), 0);
        for y in 0..self.height() {
            let (map, width) = (&coarser.disparity, coarser.width());
            upsample::row(level, map, width, y, u16::MAX, &mut self.row);
            self.centre_row(level, y);
        }
    }

    /// Bands around `self.row`, kept within the labels there are.
    fn centre_row(&mut self, level: Level, y: usize) {
        let starts = self.band.first_row_mut(y);
        let (inside, padding) = starts.split_at_mut(self.row.len());
        level.run(Centre {
            centres: &self.row,
            largest: u8::try_from(self.labels - LABELS).unwrap_or(u8::MAX),
            starts: inside,
        });
        padding.fill(inside[inside.len() - 1]);
    }

    /// One step of the way from the bands to the filled result, beginning with [`Step::START`]; the answer is the next one.
    pub(crate) fn solve(&mut self, level: Level, constants: &Constants, step: Step) -> Option<Step> {
        let (width, height) = (self.left.width(), self.left.height());
        let views = Views {
            image: &self.left,
            left: &self.left_census,
            right: &self.right_census,
            penalties: constants.penalties,
        };
        match step {
            Step::Forwards { row } => {
                let end = cut(row, ROWS_A_STEP, height);
                let mut top = row;
                while top < end {
                    let rows = top..cut(top, ROWS_AT_ONCE, end);
                    top = rows.end;
                    self.band.costs(level, &views, rows.clone());
                    self.band.across(level, &views, rows.clone());
                    self.band.along(level, &views, rows, false);
                }
                Some(if end < height {
                    Step::Forwards { row: end }
                } else {
                    Step::Backwards { end: height }
                })
            }
            Step::Backwards { end } => {
                let start = end.saturating_sub(ROWS_A_STEP);
                for y in (start..end).rev() {
                    self.band.along(level, &views, y..y + 1, true);
                    let pixels = y * width..(y + 1) * width;
                    let maps = (&mut self.disparity[pixels.clone()], &mut self.valid[pixels]);
                    winner::row(
                        level,
                        (&self.band, self.columns_before),
                        y,
                        &mut self.winners,
                        maps,
                    );
                }
                Some(if start > 0 {
                    Step::Backwards { end: start }
                } else {
                    Step::Clean
                })
            }
            Step::Clean => {
                self.speckle.remove(
                    level,
                    width,
                    &self.disparity,
                    &mut self.valid,
                    constants.speckle_px,
                );
                fill::fill(level, width, &mut self.disparity, &self.valid, &mut self.gaps);
                certainty::rate(level, width, &self.disparity, &mut self.valid, &mut self.around);
                None
            }
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
