//! The stages of recovery (see `recovery`).

use super::meshing::{PIXELS_A_STEP, split_rows};
use super::{Frame, Stage, dense};
use crate::cost::{Best, Evaluation};
use crate::fork_join::{self, ForkJoin};
use crate::ladder::{Recipe, Rung};
use crate::recovery;
use crate::support::{self, Unexplained};

/// A part of a recovery's work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Part {
    /// Choose the pixels to search for.
    Pick,
    /// Search candidate `next` and the following ones.
    Search { next: usize },
    /// Make the candidates to try.
    Lend,
    /// Evaluate them from row `row` on.
    Try { row: usize },
}

impl Part {
    /// For people.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Pick | Self::Search { .. } => "recover: search",
            Self::Lend => "recover: lend",
            Self::Try { .. } => "recover: evaluate",
        }
    }
}

impl Frame {
    /// Does `part`; the answer is what comes next.
    pub(super) fn recovery_step(
        &mut self,
        part: Part,
        rung: &Rung,
        recipe: &Recipe,
        join: &dyn ForkJoin,
    ) -> Stage {
        let next = match part {
            Part::Pick => {
                self.pick();
                Some(Part::Search { next: 0 })
            }
            Part::Search { next } => {
                let next = self.search_some(next, false, recipe, join);
                Some(next.map_or(Part::Lend, |next| Part::Search { next }))
            }
            Part::Lend => {
                self.lend();
                Some(Part::Try { row: 0 })
            }
            Part::Try { row } => self.try_lent(row, rung, join).map(|row| Part::Try { row }),
        };
        next.map_or(Stage::Dense(dense::Part::Smooth { row: 0 }), Stage::Recover)
    }

    fn pick(&mut self) {
        self.fresh.clear();
        let unexplained = Unexplained {
            cost: &self.cost,
            explained_up_to: recovery::EXPLAINED_UP_TO,
            enough: 1,
        };
        support::strongest_per_cell(
            self.level,
            &self.gradient,
            (self.window.roi.width, self.window.roi.height),
            recovery::CELL_PX,
            Some(unexplained),
            (&mut self.choosing, &mut self.candidates),
        );
        recovery::spare(&mut self.candidates, self.cost.len() / recovery::PX_A_SEARCH);
    }

    fn lend(&mut self) {
        let (width, max_fixed) = (self.width(), self.window.max_fixed());
        recovery::drop_taken(
            &mut self.fresh,
            (&self.proposed, &self.cost),
            width,
            self.window.disparities,
        );
        recovery::spare(&mut self.fresh, self.cost.len() / recovery::PX_A_MATCH);
        self.changes.reset(self.height());
        self.lent.resize(self.proposed.len(), 0);
        // The evaluation may end one above what it tries, and will once more.
        for (lent, proposed) in self.lent.iter_mut().zip(&self.proposed) {
            *lent = (*proposed).min(max_fixed);
        }
        recovery::lend(&self.fresh, (&mut self.lent, width), max_fixed, &mut self.changes);
    }

    /// Evaluates a band of rows; the answer is the next one's first row.
    fn try_lent(&mut self, row: usize, rung: &Rung, join: &dyn ForkJoin) -> Option<usize> {
        let (width, height) = (self.width(), self.height());
        let end = self.band_end(row, fork_join::in_a_step(join, PIXELS_A_STEP));
        let band = row * width..end * width;
        let evaluation = Evaluation {
            level: self.level,
            left: &self.left_census,
            right: &self.right_census,
            candidates: &self.lent,
            width,
            height,
            window: rung.window,
        };
        let (disparity, cost) = (&mut self.proposed[band.clone()], &mut self.cost[band]);
        let changes = &self.changes;
        split_rows(
            (join, &mut self.scratch),
            (row, width),
            Best { disparity, cost },
            |first, best, scratch| {
                let changed = |y| changes.blocks(y, 0);
                evaluation.update_by(recovery::LEAST_GAIN, first, changed, best, scratch);
            },
        );
        (end < height).then_some(end)
    }
}
