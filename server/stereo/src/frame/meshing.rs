//! The stages of the mesh rungs: choose, search, insert, interpolate, propagate, evaluate.

use super::{Frame, Stage, dense, recovery};
use crate::cost::{Best, Evaluation, Scratch};
use crate::disparity::FIXED_PER_PX;
use crate::epipolar::Views;
use crate::fork_join::{self, ForkJoin};
use crate::interpolate;
use crate::ladder::{Detector, Recipe, Rung, Work};
use crate::paper::Iteration;
use crate::propagate;
use crate::support::{self, Unexplained};

/// Candidates searched in one step.
const SEARCHES_A_STEP: usize = 256;
/// Vertices inserted in one step.
const INSERTIONS_A_STEP: usize = 512;
/// New vertices whose triangles are rasterised in one step.
const RASTERISED_A_STEP: usize = 1024;
/// Pixels evaluated in one step.
pub(super) const PIXELS_A_STEP: usize = 65_536;
/// Supports this far from the mesh, in px, are news to it.
const NEWS_PX: f32 = 2.0;

impl Frame {
    /// Fills `candidates`.
    pub(super) fn choose(&mut self, rung: &Rung, recipe: &Recipe) -> Stage {
        let is_first = self.supports.is_empty() && self.rasterised_vertices == 0;
        self.fresh.clear();
        match rung.work {
            Work::Propagate => return Stage::Propagate,
            Work::HalfBand => return Stage::Dense(dense::Part::Shrink),
            Work::Full => return Stage::Evaluate { row: 0 },
            Work::Mesh {
                cell_px,
                unexplained_px,
            } => {
                let size = (self.width(), self.height());
                let unexplained = Unexplained {
                    cost: &self.cost,
                    explained_up_to: recipe.confident_below,
                    enough: unexplained_px,
                };
                let unexplained = (!is_first).then_some(unexplained);
                support::strongest_per_cell(
                    self.level,
                    &self.gradient,
                    size,
                    cell_px,
                    unexplained,
                    (&mut self.choosing, &mut self.candidates),
                );
            }
            Work::Paper { .. } if is_first => match recipe.detector {
                Detector::FastInBins => {
                    self.corners.begin(&self.left);
                    return Stage::Corners { row: 0 };
                }
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

    /// Looks for corners in some rows; after the last one, the best become the candidates.
    pub(super) fn find_corners(&mut self, row: usize) -> Stage {
        let rows = (PIXELS_A_STEP / self.width()).max(1);
        if let Some(row) = self.corners.find(self.level, &self.left, row, rows) {
            return Stage::Corners { row };
        }
        self.corners.best(&mut self.candidates);
        Stage::Search { next: 0 }
    }

    /// Searches some candidates, near the mesh's disparities or over the whole range, and adds what is matched to `fresh`; the
    /// answer is which comes next.
    pub(super) fn search_some(
        &mut self,
        next: usize,
        is_near: bool,
        recipe: &Recipe,
        join: &dyn ForkJoin,
    ) -> Option<usize> {
        let views = Views {
            pattern: recipe.pattern,
            left: &self.left_census,
            right: &self.right_census,
            width: self.window.roi.width,
            disparities: self.window.disparities,
            columns_before: self.window.roi.x.cast_signed() - self.window.min_disparity_px.cast_signed(),
            near: is_near.then_some(&self.interpolated[..]),
        };
        let end = (next + fork_join::in_a_step(join, SEARCHES_A_STEP)).min(self.candidates.len());
        let (level, candidates) = (self.level, &self.candidates[next..end]);
        let found = fork_join::scratch(join, &mut self.found);
        let share = candidates.len().div_ceil(found.len()).max(1);
        let parts = candidates.chunks(share).zip(&mut *found);
        fork_join::for_each(join, parts, |_, (candidates, found)| {
            recipe.search.search(level, &views, candidates, found);
        });
        for found in found {
            self.fresh.append(found);
        }
        (end < self.candidates.len()).then_some(end)
    }

    /// Searches some candidates; after the last one, drops what nothing supports.
    pub(super) fn search(&mut self, next: usize, rung: &Rung, recipe: &Recipe, join: &dyn ForkJoin) -> Stage {
        let is_near = self.rasterised_vertices > 0 && recipe.consistency.is_some();
        if let Some(next) = self.search_some(next, is_near, recipe, join) {
            return Stage::Search { next };
        }
        if let Some(consistency) = recipe.consistency {
            consistency.retain(&mut self.fresh, &self.supports, &mut self.buckets);
            // What was tried need not be tried again, and what the mesh says already changes nothing.
            self.gradient.forget(&self.candidates);
            if self.rasterised_vertices > 0 {
                let (map, width) = (&self.interpolated, self.window.roi.width);
                self.fresh.retain(|support| {
                    let expected = f32::from(map[support.y * width + support.x]) / f32::from(FIXED_PER_PX);
                    (support.disparity_px - expected).abs() >= NEWS_PX
                });
            }
        }
        if let (Work::Mesh { cell_px, .. }, 0) = (rung.work, self.rasterised_vertices) {
            let size = (self.width(), self.height());
            support::thin(&mut self.fresh, size, cell_px, &mut self.cells);
        }
        Stage::Insert { next: 0 }
    }

    /// Brings matched supports into the mesh; the first ones all at once.
    pub(super) fn insert(&mut self, next: usize) -> Stage {
        if self.rasterised_vertices == 0 {
            let (width, height) = (self.width(), self.height());
            self.triangulation.rebuild(&self.fresh, width, height);
            self.supports.append(&mut self.fresh);
            return Stage::Interpolate { next: 0 };
        }
        let end = (next + INSERTIONS_A_STEP).min(self.fresh.len());
        self.triangulation.insert(&self.fresh[next..end]);
        if end < self.fresh.len() {
            return Stage::Insert { next: end };
        }
        self.supports.append(&mut self.fresh);
        Stage::Interpolate {
            next: self.rasterised_vertices,
        }
    }

    /// Rasterises some of the triangles that changed, those of vertex `next` and the following ones; the first mesh all at once.
    pub(super) fn interpolate(&mut self, next: usize, rung: &Rung, join: &dyn ForkJoin) -> Stage {
        let (width, max_fixed) = (self.width(), self.window.max_fixed());
        let (height, changes) = (self.window.roi.height, &mut self.changes);
        let (level, triangulation) = (self.level, &self.triangulation);
        let is_first = self.rasterised_vertices == 0;
        let first_new = self.rasterised_vertices;
        if next == first_new {
            changes.reset(height);
        }
        let vertices = triangulation.vertices();
        let end = if is_first {
            vertices
        } else {
            (next + fork_join::in_a_step(join, RASTERISED_A_STEP)).min(vertices)
        };
        let (rows, reach) = (height.div_ceil(fork_join::pieces(join)), rung.window.radius());
        let parts = self
            .interpolated
            .chunks_mut(rows * width)
            .zip(changes.parts_mut(rows));
        fork_join::for_each(join, parts, |piece, (map, mut changes)| {
            let changed = triangulation.triangles_of(first_new, next..end);
            let changed = changed.map(|triangle| triangle.vertices);
            let strip = interpolate::Strip {
                first_row: piece * rows,
                map,
                width,
            };
            let mark = |y: usize, from: usize, to: usize| {
                let end = (to + reach).min(width - 1);
                changes.mark(y - piece * rows, from.saturating_sub(reach), end);
            };
            if is_first {
                strip.fill(level, changed, max_fixed, |_, _, _| ());
            } else {
                strip.fill(level, changed, max_fixed, mark);
            }
        });
        if end < vertices {
            return Stage::Interpolate { next: end };
        }
        self.rasterised_vertices = vertices;
        if let Work::Paper { occupancy_px } = rung.work {
            if is_first {
                self.cost.fill(u8::MAX);
            }
            self.occupancy.reset(occupancy_px, self.width(), self.height());
        }
        Stage::Evaluate { row: 0 }
    }

    /// Makes the candidates of propagation.
    pub(super) fn propagate(&mut self) -> Stage {
        self.changes.reset(self.height());
        let found = propagate::Found {
            width: self.window.roi.width,
            disparity: &self.disparity,
            cost: &self.cost,
            // The evaluation may end one above what it tries: lent, that would leave the range.
            max_fixed: self.window.max_fixed(),
        };
        propagate::candidates(
            self.level,
            found,
            &mut self.proposed,
            &mut self.changes,
            &mut self.lending,
        );
        Stage::Evaluate { row: 0 }
    }

    /// End of the band of rows from `row` on that has about so many `pixels`.
    pub(super) fn band_end(&self, row: usize, pixels: usize) -> usize {
        (row + (pixels / self.width()).max(1)).min(self.height())
    }

    /// Evaluates a band of rows, split over the threads there are.
    pub(super) fn evaluate(
        &mut self,
        row: usize,
        rung: &Rung,
        recipe: &Recipe,
        join: &dyn ForkJoin,
    ) -> Option<Stage> {
        let (width, height) = (self.width(), self.height());
        let end = match rung.work {
            Work::Paper { .. } => self.band_end(row, PIXELS_A_STEP),
            _ => self.band_end(row, fork_join::in_a_step(join, PIXELS_A_STEP)),
        };
        let band = row * width..end * width;
        // The result of a dense rung is not touched before it is replaced as a whole.
        let (from, to) = match rung.work {
            Work::Mesh { .. } | Work::Paper { .. } => (&self.interpolated, &mut self.disparity),
            Work::Propagate => (&self.proposed, &mut self.disparity),
            Work::HalfBand | Work::Full => (&self.disparity, &mut self.proposed),
        };
        let (disparity, cost) = (&mut to[band.clone()], &mut self.cost[band]);
        match rung.work {
            Work::Paper { .. } => {
                let iteration = Iteration {
                    level: self.level,
                    left: &self.left_census,
                    right_image: &self.right,
                    mask: &self.gradient.mask,
                    interpolated: from,
                    width,
                    confident_below: recipe.confident_below,
                    invalid_above: recipe.valid_up_to,
                };
                iteration.refine(row..end, &mut Best { disparity, cost }, &mut self.occupancy);
            }
            Work::Mesh { .. } | Work::Propagate | Work::Full | Work::HalfBand => {
                // A window sees what changed next to it; a pixel that borrows is tested itself, no other.
                let reach = if matches!(rung.work, Work::Mesh { .. }) {
                    rung.window.radius()
                } else {
                    0
                };
                let evaluation = Evaluation {
                    level: self.level,
                    left: &self.left_census,
                    right: &self.right_census,
                    candidates: from,
                    width,
                    height,
                    window: rung.window,
                };
                let (changes, is_first) = (&self.changes, !self.has_costs);
                split_rows(
                    (join, &mut self.scratch),
                    (row, width),
                    Best { disparity, cost },
                    |first, best, scratch| match rung.work {
                        Work::Full => evaluation.correct(first, best, scratch),
                        _ if is_first => evaluation.begin(first, best, scratch),
                        _ => evaluation.update(first, |y| changes.blocks(y, reach), best, scratch),
                    },
                );
            }
        }
        if end < height {
            return Some(Stage::Evaluate { row: end });
        }
        self.has_costs = true;
        if rung.work == Work::Full {
            Some(Stage::Recover(recovery::Part::Pick))
        } else {
            Some(Stage::Publish)
        }
    }
}

/// Calls `evaluate` with some of the rows from `first_row` on, `width` wide, on each of the threads there are: the number of the
/// first of them, and what is kept of them.
pub(super) fn split_rows(
    (join, scratch): (&dyn ForkJoin, &mut Vec<Scratch>),
    (first_row, width): (usize, usize),
    best: Best<'_>,
    evaluate: impl Fn(usize, &mut Best<'_>, &mut Scratch) + Sync,
) {
    let scratch = fork_join::scratch(join, scratch);
    let rows = (best.cost.len() / width).div_ceil(scratch.len());
    let parts = best.disparity.chunks_mut(rows * width);
    let parts = parts.zip(best.cost.chunks_mut(rows * width)).zip(scratch);
    fork_join::for_each(join, parts, |piece, ((disparity, cost), scratch)| {
        evaluate(first_row + piece * rows, &mut Best { disparity, cost }, scratch);
    });
}
