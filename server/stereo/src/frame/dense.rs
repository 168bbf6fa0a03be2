//! The stages of the dense rungs: coarse levels around the mesh, and their result at full resolution.

use super::{Columns, Frame, Stage};
use crate::band::Penalties;
use crate::coarse::{self, Constants};
use crate::confidence::{CostScale, rate_dense};
use crate::ladder::{Rung, Work};
use crate::{smooth, upsample};

/// A part of the dense rungs' work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Part {
    /// Make the coarse levels' images and words.
    Shrink,
    /// Solve part `next` of a quarter of the resolution.
    Quarter { next: usize },
    /// The same at half of it.
    Half { next: usize },
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
            Self::Quarter { .. } => "quarter band",
            Self::Half { .. } => "half band",
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
    pub(super) fn dense_step(&mut self, part: Part) -> Stage {
        let parts = coarse::Part::ALL;
        match part {
            Part::Shrink => {
                self.shrink();
                Stage::Dense(Part::Quarter { next: 0 })
            }
            Part::Quarter { next } => {
                self.quarter.solve(self.level, &QUARTER, parts[next]);
                if next + 1 < parts.len() {
                    return Stage::Dense(Part::Quarter { next: next + 1 });
                }
                self.half.centre_on(self.level, &self.quarter);
                Stage::Dense(Part::Half { next: 0 })
            }
            Part::Half { next } => {
                self.half.solve(self.level, &HALF, parts[next]);
                Stage::Dense(if next + 1 < parts.len() {
                    Part::Half { next: next + 1 }
                } else {
                    Part::Enlarge
                })
            }
            Part::Enlarge => {
                self.enlarge();
                Stage::Publish
            }
            Part::Smooth => {
                let (width, height) = (self.width(), self.height());
                smooth::median(self.level, width, &self.disparity, 0..height, &mut self.proposed);
                smooth::mean(self.level, width, &self.proposed, 0..height, &mut self.disparity);
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
        self.quarter.centre_on_map(&self.interpolated, width, 4);
    }

    fn enlarge(&mut self) {
        let (width, max_fixed) = (self.width(), self.window.max_fixed());
        let (coarse, _) = self.half.result();
        for (y, row) in self.disparity.chunks_exact_mut(width).enumerate() {
            upsample::row(self.level, coarse, self.half.width(), y, row);
            for fixed in row {
                *fixed = (*fixed).min(max_fixed);
            }
        }
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
