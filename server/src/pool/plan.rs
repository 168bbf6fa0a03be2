//! How much of a frame is going to be done: decided when a worker takes it, checked again between its rungs.

use std::time::{Duration, Instant};

use stereo::rung_names;
use stereo_scheduler::Budget;

use super::Shared;
use super::costs::{FrameClass, Stage, decode_stage, encode_stage};
use crate::dispatch::Job;
use crate::job::{FrameRequest, ReplyFormat};

/// What dispatch decides about a frame from its deadline and the costs known so far.
pub(super) struct Plan<'a> {
    shared: &'a Shared,
    class: FrameClass,
    budget: Budget,
    /// Rungs to run at most: what was asked for, and never more than the ladder has.
    pub(super) rungs_asked: u8,
    /// Whether the output mesh is triangulated.
    pub(super) wants_mesh: bool,
    /// Decode, the rungs that fit, mesh and encode; zero while one of them is unknown.
    pub(super) predicted_cost: Duration,
}

impl<'a> Plan<'a> {
    pub(super) fn new(job: &Job, class: FrameClass, shared: &'a Shared) -> Self {
        let request = &job.request;
        let options = &request.options;
        let wants_mesh = wants_mesh(request);
        let mut after_match: Vec<Stage> = request
            .formats
            .iter()
            .map(|&f| encode_stage(f, options))
            .collect();
        if wants_mesh {
            after_match.push(Stage::Mesh);
        }
        let after_match: Vec<Option<Duration>> = after_match
            .into_iter()
            .map(|stage| shared.costs.tail(class, stage))
            .collect();
        let budget = Budget {
            deadline: shared.dispatch.scheduler_time(request.deadline()),
            reserve: after_match.iter().flatten().sum(),
        };
        let ladder = u8::try_from(rung_names(options.params.preset).len()).unwrap_or(u8::MAX);
        let rungs_asked = options.max_iterations.unwrap_or(ladder).min(ladder);
        let mut plan = Self {
            shared,
            class,
            budget,
            rungs_asked,
            wants_mesh,
            predicted_cost: Duration::ZERO,
        };
        let decode = shared
            .costs
            .tail(class, decode_stage(&request.left, &request.right));
        let fixed: Option<Duration> = after_match.into_iter().chain([decode]).sum();
        plan.predicted_cost = fixed
            .zip(plan.rungs_cost())
            .map_or(Duration::ZERO, |(fixed, rungs)| fixed + rungs);
        plan
    }

    /// The rung of this index (0 = base) took `took`.
    pub(super) fn record_rung(&self, index: u8, took: Duration) {
        self.shared.costs.record(self.class, Stage::Rung(index), took);
    }

    /// Whether the rung of this index will be done in time, mesh and encoding included.
    pub(super) fn may_start(&self, index: u8) -> bool {
        self.budget.may_start(self.now(), self.cost(index))
    }

    /// Whether mesh and encoding have to start now.
    pub(super) fn is_spent(&self) -> bool {
        self.budget.is_spent(self.now())
    }

    /// What the rungs that fit into the budget will take, the first one always; `None` if that is unknown.
    fn rungs_cost(&self) -> Option<Duration> {
        let started = self.now();
        let mut rungs = self.cost(0)?;
        for rung in 1..self.rungs_asked {
            let cost = self.cost(rung)?;
            if !self.budget.may_start(started + rungs, Some(cost)) {
                break;
            }
            rungs += cost;
        }
        Some(rungs)
    }

    /// What the rung of this index will take, 0 = base.
    fn cost(&self, index: u8) -> Option<Duration> {
        self.shared.costs.tail(self.class, Stage::Rung(index))
    }

    fn now(&self) -> Duration {
        self.shared.dispatch.scheduler_time(Instant::now())
    }
}

/// Whether any body of the reply has the mesh in it.
fn wants_mesh(request: &FrameRequest) -> bool {
    let in_result = request.options.outputs.mesh;
    request
        .formats
        .iter()
        .any(|&format| format.needs_mesh() || (format == ReplyFormat::Protobuf && in_result))
}
