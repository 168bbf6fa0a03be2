//! One level of the image pyramid: a band of semi-global matching around a prior, checked, cleaned and filled.

use crate::band::{Band, Penalties, Views};
use crate::census::{Census, Pattern};
use crate::disparity::FIXED_PER_PX;
use crate::plane::Plane;
use crate::simd::{LABELS, Level};
use crate::speckle::Speckle;
use crate::{certainty, fill, upsample, winner};

/// What differs between levels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Constants {
    pub(crate) penalties: Penalties,
    /// Islands of up to this many pixels are removed.
    pub(crate) speckle_px: u32,
}

/// The parts of a level's work, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Part {
    /// Matching costs.
    Costs,
    /// Paths along rows.
    Across,
    /// Paths from the top.
    Down,
    /// Paths from the bottom.
    Up,
    /// Winners, and whether both views agree.
    Choose,
    /// Speckles removed, gaps filled.
    Clean,
}

impl Part {
    pub(crate) const ALL: [Self; 6] = [
        Self::Costs,
        Self::Across,
        Self::Down,
        Self::Up,
        Self::Choose,
        Self::Clean,
    ];
}

/// Labels of the band below its centre.
const BELOW_CENTRE: usize = LABELS / 2 - 1;

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

    /// Centres the bands on a full resolution map (rows of `width`), which is `scale` times as fine.
    pub(crate) fn centre_on_map(&mut self, map: &[u16], width: usize, scale: usize) {
        let last = map.len() / width - 1;
        for y in 0..self.height() {
            let row = &map[(scale * y + scale / 2).min(last) * width..][..width];
            self.row.clear();
            let columns = (0..self.left.width()).map(|x| (scale * x + scale / 2).min(width - 1));
            self.row
                .extend(columns.map(|x| row[x] / u16::try_from(scale).unwrap_or(u16::MAX)));
            self.centre_row(y);
        }
    }

    /// Centres the bands on the next coarser level's result.
    pub(crate) fn centre_on(&mut self, level: Level, coarser: &Self) {
        for y in 0..self.height() {
            self.row.resize(self.left.width(), 0);
            upsample::row(level, &coarser.disparity, coarser.width(), y, &mut self.row);
            self.centre_row(y);
        }
    }

    /// Bands around `self.row`, kept within the labels there are.
    fn centre_row(&mut self, y: usize) {
        let largest = self.labels - LABELS;
        let starts = self.band.first_row_mut(y);
        let (inside, padding) = starts.split_at_mut(self.row.len());
        for (start, centre) in inside.iter_mut().zip(&self.row) {
            let nearest = usize::from((centre + FIXED_PER_PX / 2) / FIXED_PER_PX);
            *start = u8::try_from(nearest.saturating_sub(BELOW_CENTRE).min(largest)).unwrap_or(u8::MAX);
        }
        padding.fill(inside[inside.len() - 1]);
    }

    /// One part of the way from the bands to the filled result; the parts are to be done in order.
    pub(crate) fn solve(&mut self, level: Level, constants: &Constants, part: Part) {
        let views = Views {
            image: &self.left,
            left: &self.left_census,
            right: &self.right_census,
            penalties: constants.penalties,
        };
        let rows = 0..self.left.height();
        let width = self.left.width();
        match part {
            Part::Costs => self.band.costs(level, &views, rows),
            Part::Across => self.band.across(level, &views, rows),
            Part::Down => self.band.along(level, &views, rows, false),
            Part::Up => self.band.along(level, &views, rows, true),
            Part::Choose => {
                let maps = self
                    .disparity
                    .chunks_exact_mut(width)
                    .zip(self.valid.chunks_exact_mut(width));
                for (y, (disparity, valid)) in maps.enumerate() {
                    let band = (&self.band, self.columns_before);
                    winner::row(level, band, y, &mut self.winners, disparity, valid);
                }
            }
            Part::Clean => {
                self.speckle
                    .remove(width, &self.disparity, &mut self.valid, constants.speckle_px);
                fill::fill(width, &mut self.disparity, &self.valid);
                certainty::rate(level, width, &self.disparity, &mut self.valid);
            }
        }
    }
}
