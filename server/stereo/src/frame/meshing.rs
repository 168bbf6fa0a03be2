//! The stages of the mesh rungs: choose, search, insert, interpolate, propagate, evaluate.

use std::sync::Mutex;

use super::{Frame, Stage, dense};
use crate::cost::{Best, Evaluation};
use crate::epipolar::Views;
use crate::fork_join::ForkJoin;
use crate::ladder::{Detector, Recipe, Rung, Work};
use crate::paper::Iteration;
use crate::propagate::{self, From};
use crate::support::{self, Unexplained};
use crate::{fast, interpolate};

/// Candidates searched in one step.
const SEARCHES_A_STEP: usize = 256;
/// Vertices inserted in one step.
const INSERTIONS_A_STEP: usize = 512;
/// Pixels evaluated in one step.
const PIXELS_A_STEP: usize = 65_536;
/// Propagation passes of a rung.
const PASSES: [From; 4] = [From::Left, From::Right, From::Above, From::Below];

impl Frame {
    /// Fills `candidates`.
    pub(super) fn choose(&mut self, rung: &Rung, recipe: &Recipe) -> Stage {
        let is_first = self.supports.is_empty() && self.rasterised_vertices == 0;
        self.fresh.clear();
        match rung.work {
            Work::Propagate => return Stage::Propagate { pass: 0 },
            Work::HalfBand => return Stage::Dense(dense::Part::Shrink),
            Work::Full => {
                self.proposed.copy_from_slice(&self.disparity);
                return Stage::Evaluate { row: 0, pass: 0 };
            }
            Work::Mesh { cell_px } => {
                let size = (self.width(), self.height());
                let unexplained = Unexplained {
                    cost: &self.cost,
                    explained_up_to: recipe.confident_below,
                };
                let unexplained = (!is_first).then_some(unexplained);
                support::strongest_per_cell(
                    self.level,
                    &self.gradient,
                    size,
                    cell_px,
                    unexplained,
                    &mut self.candidates,
                );
            }
            Work::Paper { .. } if is_first => match recipe.detector {
                Detector::FastInBins => fast::corners_in_bins(&self.left, &mut self.candidates),
                Detector::StrongestPerCell => {}
            },
            Work::Paper { .. } => {
                // SupportResampling: the confident pixels join as they are, the invalid ones are searched for.
                self.candidates.clear();
                self.candidates.extend(self.occupancy.invalid());
                self.fresh.extend(self.occupancy.confident());
            }
        }
        Stage::Search { next: 0 }
    }

    /// Searches some candidates; after the last one, drops what nothing supports.
    pub(super) fn search(&mut self, next: usize, recipe: &Recipe) -> Stage {
        let views = Views {
            pattern: recipe.pattern,
            left: &self.left_census,
            right: &self.right_census,
            width: self.window.roi.width,
            disparities: self.window.disparities,
            columns_before: self.window.roi.x.cast_signed() - self.window.min_disparity_px.cast_signed(),
        };
        let end = (next + SEARCHES_A_STEP).min(self.candidates.len());
        recipe
            .search
            .search(self.level, &views, &self.candidates[next..end], &mut self.fresh);
        if end < self.candidates.len() {
            return Stage::Search { next: end };
        }
        if let Some(consistency) = recipe.consistency {
            consistency.retain(&mut self.fresh, &self.supports, &mut self.buckets);
        }
        Stage::Insert { next: 0 }
    }

    /// Brings matched supports into the mesh; the first ones all at once.
    pub(super) fn insert(&mut self, next: usize) -> Stage {
        if self.rasterised_vertices == 0 {
            let (width, height) = (self.width(), self.height());
            self.triangulation.rebuild(&self.fresh, width, height);
            self.supports.append(&mut self.fresh);
            return Stage::Interpolate;
        }
        let end = (next + INSERTIONS_A_STEP).min(self.fresh.len());
        self.triangulation.insert(&self.fresh[next..end]);
        if end < self.fresh.len() {
            return Stage::Insert { next: end };
        }
        self.supports.append(&mut self.fresh);
        Stage::Interpolate
    }

    /// Rasterises the triangles that changed.
    pub(super) fn interpolate(&mut self, rung: &Rung) -> Stage {
        let (width, max_fixed) = (self.width(), self.window.max_fixed());
        let changed = self.triangulation.triangles_from(self.rasterised_vertices);
        let changed = changed.map(|triangle| triangle.vertices);
        interpolate::fill(self.level, &mut self.interpolated, width, changed, max_fixed);
        self.rasterised_vertices = self.triangulation.vertices();
        if let Work::Paper { occupancy_px } = rung.work {
            self.occupancy.reset(occupancy_px, self.width(), self.height());
        }
        Stage::Evaluate { row: 0, pass: 0 }
    }

    /// Makes the candidates of a propagation pass.
    pub(super) fn propagate(&mut self, pass: usize) -> Stage {
        let width = self.width();
        propagate::candidates(
            PASSES[pass],
            width,
            &self.disparity,
            &self.cost,
            &mut self.proposed,
        );
        // The evaluation may end one above what it tries: lent from pass to pass, that would leave the range.
        let max_fixed = self.window.max_fixed();
        for fixed in &mut self.proposed {
            *fixed = max_fixed.min(*fixed);
        }
        Stage::Evaluate { row: 0, pass }
    }

    /// Evaluates a band of rows, split over the threads there are.
    pub(super) fn evaluate(
        &mut self,
        row: usize,
        pass: usize,
        rung: &Rung,
        recipe: &Recipe,
        join: &dyn ForkJoin,
    ) -> Option<Stage> {
        let (width, height) = (self.width(), self.height());
        let end = (row + (PIXELS_A_STEP / width).max(16)).min(height);
        let band = row * width..end * width;
        let (disparity, cost) = (&mut self.disparity[band.clone()], &mut self.cost[band]);
        match rung.work {
            Work::Paper { .. } => {
                let iteration = Iteration {
                    left: &self.left_census,
                    right_image: &self.right,
                    mask: &self.gradient.mask,
                    interpolated: &self.interpolated,
                    width,
                    confident_below: recipe.confident_below,
                    invalid_above: recipe.valid_up_to,
                };
                iteration.refine(row..end, &mut Best { disparity, cost }, &mut self.occupancy);
            }
            Work::Mesh { .. } | Work::Propagate | Work::Full | Work::HalfBand => {
                let is_mesh = matches!(rung.work, Work::Mesh { .. });
                let evaluation = Evaluation {
                    level: self.level,
                    left: &self.left_census,
                    right: &self.right_census,
                    candidates: if is_mesh {
                        &self.interpolated
                    } else {
                        &self.proposed
                    },
                    width,
                    height,
                    window: rung.window,
                };
                let pieces = join.threads().clamp(1, end - row);
                if self.scratch.len() < pieces {
                    self.scratch.resize_with(pieces, Mutex::default);
                }
                let rows = (end - row).div_ceil(pieces);
                let parts = disparity
                    .chunks_mut(rows * width)
                    .zip(cost.chunks_mut(rows * width));
                let parts: Vec<_> = parts.map(|part| Mutex::new(Some(part))).collect();
                join.run(parts.len(), &|piece| {
                    let part = parts[piece].lock().ok().and_then(|mut part| part.take());
                    if let (Some((disparity, cost)), Ok(mut scratch)) = (part, self.scratch[piece].lock()) {
                        let (first, mut best) = (row + piece * rows, Best { disparity, cost });
                        if rung.work == Work::Full {
                            evaluation.correct(first, &mut best, &mut scratch);
                        } else {
                            evaluation.update(first, &mut best, &mut scratch);
                        }
                    }
                });
            }
        }
        if end < height {
            Some(Stage::Evaluate { row: end, pass })
        } else if rung.work == Work::Propagate && pass + 1 < PASSES.len() {
            Some(Stage::Propagate { pass: pass + 1 })
        } else if rung.work == Work::Full {
            Some(Stage::Dense(dense::Part::Smooth))
        } else {
            Some(Stage::Publish)
        }
    }
}
