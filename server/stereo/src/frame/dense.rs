//! The stages of the dense rungs: coarse levels around the mesh, and their result at full resolution.

use super::{Columns, Frame, Stage};
use crate::band::Penalties;
use crate::coarse::{self, Constants};
use crate::confidence::{CostScale, rate_dense};
use crate::fork_join::{self, ForkJoin};
use crate::ladder::{Rung, Work};
use crate::{smooth, upsample};

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
    /// Smooth the full resolution result.
    Smooth,
}

impl Part {
    /// For people.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Shrink => "shrink",
            Self::Quarter(_) => "quarter band",
            Self::Half(_) => "half band",
            Self::Enlarge => "enlarge",
            Self::Smooth => "smooth",
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

impl Frame {
    /// Does `part`; the answer is what comes next.
    pub(super) fn dense_step(&mut self, part: Part, join: &dyn ForkJoin) -> Stage {
        match part {
            Part::Shrink => {
                self.shrink();
                Stage::Dense(Part::Quarter(coarse::Step::START))
            }
            Part::Quarter(step) => {
                if let Some(next) = self.quarter.solve(self.level, &QUARTER, step) {
                    return Stage::Dense(Part::Quarter(next));
                }
                self.half.centre_on(self.level, &self.quarter);
                Stage::Dense(Part::Half(coarse::Step::START))
            }
            Part::Half(step) => Stage::Dense(
                self.half
                    .solve(self.level, &HALF, step)
                    .map_or(Part::Enlarge, Part::Half),
            ),
            Part::Enlarge => {
                self.enlarge(join);
                Stage::Publish
            }
            Part::Smooth => {
                self.smooth(join);
                Stage::Publish
            }
        }
    }

    /// Starts the coarse levels around the mesh.
    fn shrink(&mut self) {
        let (width, disparities) = (self.width(), self.window.disparities);
        let half = |columns: &Columns| columns.start.div_ceil(2)..columns.end / 2;
        let (left, right) = &self.real_columns;
        self.half.begin(
            self.level,
            (&self.left, &self.right),
            (left.clone(), right.clone()),
            disparities,
        );
        self.quarter.begin(
            self.level,
            self.half.planes(),
            (half(left), half(right)),
            disparities / 2,
        );
        self.quarter.centre_on_map(self.level, &self.interpolated, width);
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

    fn smooth(&mut self, join: &dyn ForkJoin) {
        let (level, width, from) = (self.level, self.width(), &self.proposed);
        let pieces = fork_join::pieces(join);
        if self.smoothing.len() < pieces {
            self.smoothing.resize_with(pieces, Default::default);
        }
        let rows = self.height().div_ceil(pieces);
        let parts = self.disparity.chunks_mut(rows * width);
        fork_join::for_each(join, parts.zip(&mut self.smoothing), |piece, (to, scratch)| {
            let first = piece * rows;
            smooth::smooth(level, width, from, first..first + to.len() / width, to, scratch);
        });
    }

    /// Confidences after a dense rung.
    pub(super) fn rate_dense(&mut self, rung: &Rung, scale: CostScale) {
        // What is known besides the cost allows a dearer match to be believed.
        let scale = CostScale {
            half_at: scale.half_at + 40,
            ..scale
        };
        let (_, certainty) = self.half.result();
        let (width, half_width) = (self.width(), self.half.width());
        let rows = self
            .confidence
            .chunks_exact_mut(width)
            .zip(self.cost.chunks_exact(width));
        for (y, (confidence, costs)) in rows.enumerate() {
            let certainty = &certainty[y / 2 * half_width..][..half_width];
            let costs = (rung.work == Work::Full).then_some(costs);
            rate_dense(self.level, scale, certainty, costs, confidence);
        }
    }
}
