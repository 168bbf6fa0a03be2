//! What the scheduler knows of the job a worker has.

use std::time::Duration;

use crate::cost::Cost;
use crate::spec::{StreamId, Ticket, Work};

/// Rungs whose costs are told apart; later ones cost what the last of these does.
pub(crate) const RUNGS: usize = 8;

/// Costs of all stages of one job.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct StageCosts {
    pub(crate) decode: Cost,
    pub(crate) rungs: [Cost; RUNGS],
    pub(crate) step: Cost,
    /// After each rung; zero if there is no mesh to make.
    pub(crate) mesh: [Cost; RUNGS],
    /// After each rung.
    pub(crate) encode: [Cost; RUNGS],
}

impl StageCosts {
    pub(crate) fn rung(&self, index: u8) -> Cost {
        self.rungs[at(index)]
    }

    pub(crate) fn mesh(&self, index: u8) -> Cost {
        self.mesh[at(index)]
    }

    pub(crate) fn encode(&self, index: u8) -> Cost {
        self.encode[at(index)]
    }

    /// Everything that must be done: without it there is no answer.
    pub(crate) fn mandatory(&self) -> Cost {
        self.full(1)
    }

    /// From its start until it can be put aside.
    pub(crate) fn until_base(&self) -> Cost {
        self.decode + self.rung(0)
    }

    /// Everything, with `rungs` rungs.
    pub(crate) fn full(&self, rungs: u8) -> Cost {
        let last = rungs.saturating_sub(1);
        let matching: Cost = (0..=last).map(|index| self.rung(index)).sum();
        self.decode + matching + self.mesh(last) + self.encode(last)
    }
}

fn at(index: u8) -> usize {
    usize::from(index).min(RUNGS - 1)
}

/// Where in a job its worker is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Phase {
    Decode,
    Base,
    Refine,
    Mesh,
    Encode,
}

/// A job that a worker has.
#[derive(Debug)]
pub(crate) struct Running<K> {
    pub(crate) ticket: Ticket,
    pub(crate) stream: Option<StreamId>,
    /// `None`: background.
    pub(crate) due: Option<Duration>,
    /// What a slow reply takes more than an ordinary one: no reason to refuse an answer, but to stop refining it.
    pub(crate) slow_reply: Duration,
    pub(crate) work: Work<K>,
    pub(crate) costs: StageCosts,
    pub(crate) has_mesh: bool,
    pub(crate) is_mesh_optional: bool,
    pub(crate) phase: Phase,
    pub(crate) rungs_done: u8,
    pub(crate) stage_started: Duration,
    pub(crate) step_started: Duration,
    /// Time of the present rung before the job was put aside.
    pub(crate) carried: Duration,
    /// Of the stages that are done: what they were expected to take, and what they took.
    pub(crate) predicted: Duration,
    pub(crate) actual: Duration,
    pub(crate) is_cancelled: bool,
    pub(crate) is_superseded: bool,
}

impl<K> Running<K> {
    /// Ends the present stage; how long it took, and the time it lay aside doesn't count.
    pub(crate) fn end_stage(&mut self, now: Duration, expected: Cost, next: Phase) -> Duration {
        let took = self.stage_took(now);
        self.predicted += expected.typical;
        self.actual += took;
        self.phase = next;
        self.stage_started = now;
        self.step_started = now;
        self.carried = Duration::ZERO;
        took
    }

    pub(crate) fn stage_took(&self, now: Duration) -> Duration {
        self.carried + now.saturating_sub(self.stage_started)
    }

    /// The rung whose result there is.
    pub(crate) fn reached(&self) -> u8 {
        self.rungs_done.saturating_sub(1)
    }

    /// Mesh and encoding after the rung `index`, as far as they can't be left out.
    pub(crate) fn ending_after(&self, index: u8) -> Cost {
        if self.is_mesh_optional {
            self.costs.encode(index)
        } else {
            self.costs.mesh(index) + self.costs.encode(index)
        }
    }

    /// Mesh and encoding of what there is.
    pub(crate) fn ending(&self) -> Cost {
        self.ending_after(self.reached())
    }

    /// All that is left of it while it is refined and `done` of the present rung is: every rung, mesh and encoding.
    pub(crate) fn rest(&self, done: Duration) -> Duration {
        let rungs = (self.rungs_done..self.work.rungs).map(|index| self.costs.rung(index).charge());
        let ending = self.ending_after(self.work.rungs.saturating_sub(1));
        rungs.sum::<Duration>().saturating_sub(done) + ending.charge()
    }

    /// The same of a job that lies aside.
    pub(crate) fn rest_aside(&self) -> Duration {
        self.rest(self.carried)
    }

    /// What those after it wait for the ending of one that lies aside, in the average over `workers`.
    pub(crate) fn share(&self, workers: u32) -> Duration {
        self.ending().charge() / workers
    }

    /// How long the worker is bound at least, if no further step is started.
    pub(crate) fn bound_for(&self, now: Duration) -> Duration {
        let costs = &self.costs;
        let (present, after) = match self.phase {
            Phase::Decode => (costs.decode, costs.rungs[0].charge()),
            Phase::Base => (costs.rungs[0], Duration::ZERO),
            Phase::Refine => (costs.step, Duration::ZERO),
            Phase::Mesh => (costs.mesh(self.reached()), Duration::ZERO),
            Phase::Encode => (costs.encode(self.reached()), Duration::ZERO),
        };
        let ending = match self.phase {
            // A background job is put aside after the step.
            Phase::Refine if self.due.is_none() => Duration::ZERO,
            Phase::Decode | Phase::Base if self.due.is_none() => Duration::ZERO,
            Phase::Encode => Duration::ZERO,
            Phase::Mesh => costs.encode(self.reached()).charge(),
            Phase::Decode | Phase::Base | Phase::Refine => self.ending().charge(),
        };
        remaining(present, now.saturating_sub(self.step_started)) + after + ending
    }
}

/// What is left of something after `elapsed`: what it is reckoned with; once it has taken longer than that, what it takes in a
/// bad case; and beyond that a little more, always.
fn remaining(cost: Cost, elapsed: Duration) -> Duration {
    let left = cost.charge().saturating_sub(elapsed);
    if left.is_zero() {
        (cost.tail.saturating_sub(elapsed) / 2).max(cost.typical / 16)
    } else {
        left
    }
}
