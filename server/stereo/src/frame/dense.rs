//! The stages of the dense rungs: coarse levels around the mesh, and their result at full resolution.

use super::{Frame, Stage};
use crate::band::Penalties;
use crate::coarse::{self, Constants};
use crate::confidence::{CostScale, rate_dense};
use crate::fork_join::{self, ForkJoin};
use crate::ladder::{Rung, Work};
use crate::{smooth, upsample};

/// Pixels smoothed in one step.
const SMOOTHED_A_STEP: usize = 262_144;

/// A part of the dense rungs' work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Part {
    /// Make the coarse levels' images and words.
    Shrink,
    /// Solve a quarter of the resolution.
    Quarter(coarse::Step),
    /// Solve half of it.
    Half(coarse::Step),
    /// Bring the half resolution result to full resolution.
    Enlarge,
    /// Smooth the full resolution result from row `row` on.
    Smooth { row: usize },
}

impl Part {
    /// For people.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Shrink => "shrink",
            Self::Quarter(_) => "quarter band",
            Self::Half(_) => "half band",
            Self::Enlarge => "enlarge",
            Self::Smooth { .. } => "smooth",
        }
    }
}

/// Penalties and speckles of the coarse levels, from an earlier study on KITTI 2012, which found
/// accuracy flat around them.
const QUARTER: Constants = Constants {
    penalties: Penalties {
        small: 12,
        large: 60,
        least: 24,
    },
    speckle_px: 40,
};
const HALF: Constants = Constants {
    penalties: Penalties {
        small: 18,
        large: 60,
        least: 27,
    },
    speckle_px: 100,
};

/// A dense rung's scale from that of the mesh rungs: what is known besides the cost allows a dearer match to be believed.
pub(super) fn scale(of_mesh: CostScale) -> CostScale {
    of_mesh.milder(40)
}

impl Frame {
    /// Does `part`; the answer is what comes next.
    pub(super) fn dense_step(&mut self, part: Part, join: &dyn ForkJoin) -> Stage {
        match part {
            Part::Shrink => {
                self.shrink(join);
                Stage::Dense(Part::Quarter(coarse::Step::START))
            }
            Part::Quarter(step) => {
                if let Some(next) = self.quarter.solve(self.level, &QUARTER, step, join) {
                    return Stage::Dense(Part::Quarter(next));
                }
                self.half.centre_on(self.level, &self.quarter, join);
                Stage::Dense(Part::Half(coarse::Step::START))
            }
            Part::Half(step) => {
                if let Some(next) = self.half.solve(self.level, &HALF, step, join) {
                    return Stage::Dense(Part::Half(next));
                }
                self.half.rate(self.level, join);
                Stage::Dense(Part::Enlarge)
            }
            Part::Enlarge => {
                self.enlarge(join);
                Stage::Publish
            }
            Part::Smooth { row } => match self.smooth(row, join) {
                Some(row) => Stage::Dense(Part::Smooth { row }),
                None => Stage::Publish,
            },
        }
    }

    /// Starts the coarse levels around the mesh.
    fn shrink(&mut self, join: &dyn ForkJoin) {
        let (width, disparities) = (self.width(), self.window.disparities);
        coarse::shrink(
            self.level,
            [&mut self.half, &mut self.quarter],
            (&self.left, &self.right),
            self.real_columns.clone(),
            disparities,
            join,
        );
        self.quarter
            .centre_on_map(self.level, &self.interpolated, width, join);
    }

    fn enlarge(&mut self, join: &dyn ForkJoin) {
        let (level, width, max_fixed) = (self.level, self.width(), self.window.max_fixed());
        let (coarse, coarse_width) = (self.half.result().0, self.half.width());
        let rows = self.height().div_ceil(fork_join::pieces(join));
        let parts = self.disparity.chunks_mut(rows * width);
        fork_join::for_each(join, parts, |piece, part| {
            for (y, row) in (piece * rows..).zip(part.chunks_exact_mut(width)) {
                upsample::row(level, coarse, coarse_width, y, max_fixed, row);
            }
        });
    }

    /// Smooths a band of rows; the answer is the next one's first row. With the last one, the result is replaced as a whole.
    fn smooth(&mut self, row: usize, join: &dyn ForkJoin) -> Option<usize> {
        let end = self.band_end(row, fork_join::in_a_step(join, SMOOTHED_A_STEP));
        let (level, width, from) = (self.level, self.width(), &self.proposed);
        let rows = (end - row).div_ceil(fork_join::pieces(join));
        let scratch = fork_join::scratch(join, &mut self.smoothing);
        // What was tried is not needed any more.
        let parts = self.lent[row * width..end * width].chunks_mut(rows * width);
        fork_join::for_each(join, parts.zip(scratch), |piece, (to, scratch)| {
            let first = row + piece * rows;
            smooth::smooth(level, width, from, first..first + to.len() / width, to, scratch);
        });
        if end < self.height() {
            return Some(end);
        }
        std::mem::swap(&mut self.disparity, &mut self.lent);
        None
    }

    /// Confidences after a dense rung.
    pub(super) fn rate_dense(&mut self, rung: &Rung, scale: CostScale, join: &dyn ForkJoin) {
        let scale = self::scale(scale);
        let (_, certainty) = self.half.result();
        let (level, width, half_width) = (self.level, self.width(), self.half.width());
        let rows_a_piece = self.height().div_ceil(fork_join::pieces(join));
        let parts = self.confidence.chunks_mut(rows_a_piece * width);
        let parts = parts.zip(self.cost.chunks(rows_a_piece * width));
        fork_join::for_each(join, parts, |piece, (confidence, costs)| {
            let rows = confidence.chunks_exact_mut(width).zip(costs.chunks_exact(width));
            for (y, (confidence, costs)) in (piece * rows_a_piece..).zip(rows) {
                let certainty = &certainty[y / 2 * half_width..][..half_width];
                let costs = (rung.work == Work::Full).then_some(costs);
                rate_dense(level, scale, certainty, costs, confidence);
            }
        });
    }
}
