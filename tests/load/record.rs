//! What became of one frame.

use std::time::Duration;

use stereo_client::v1::{ExecutionReport, Reason};

use crate::plan::Shot;

/// One frame that was due.
#[derive(Debug, Clone)]
pub(crate) struct Record {
    /// The frame.
    pub(crate) shot: Shot,
    /// From when it was due until it was sent.
    pub(crate) lag: Duration,
    /// From when it was due until the whole answer was there.
    pub(crate) latency: Duration,
    /// From when it was sent until the answer began.
    pub(crate) decided: Duration,
    /// How it ended.
    pub(crate) outcome: Outcome,
}

/// How a frame ended.
#[derive(Debug, Clone)]
pub(crate) enum Outcome {
    /// With a result.
    Answered(Box<Digest>),
    /// With a refusal; whether it said when it would have been feasible.
    Refused {
        /// Why.
        reason: Reason,
        /// Whether it named the earliest feasible time.
        says_when: bool,
    },
    /// Without an answer that is understood, or without any: what happened.
    Broken(String),
    /// Not sent, for too many were under way.
    NotSent,
}

/// What matters of an execution report.
#[derive(Debug, Clone, Default)]
pub(crate) struct Digest {
    /// Rungs finished.
    pub(crate) rungs_run: u32,
    /// Rungs asked for.
    pub(crate) rungs_asked: u32,
    /// What the server expected to spend.
    pub(crate) predicted: Duration,
    /// What it spent.
    pub(crate) actual: Duration,
    /// Whether the server was done in time by its own clock.
    pub(crate) deadline_met: bool,
    /// From the request's head until the answer was written, by the server's clock.
    pub(crate) total: Duration,
    /// Times of the server's [`STAGES`].
    pub(crate) stages: [Duration; STAGES.len()],
}

/// Where the server's time goes, in order.
pub(crate) const STAGES: [&str; 6] = ["receive", "queue", "decode", "match", "mesh", "encode"];

impl Digest {
    /// The digest of a report.
    pub(crate) fn of(report: &ExecutionReport) -> Self {
        let time = |stage: Option<_>| stage.and_then(|d| Duration::try_from(d).ok()).unwrap_or_default();
        Self {
            rungs_run: report.iterations_run,
            rungs_asked: report.iterations_asked,
            predicted: time(report.predicted_cost),
            actual: time(report.actual_cost),
            deadline_met: report.deadline_met,
            total: time(report.total),
            stages: [
                report.received,
                report.queued,
                report.decoded,
                report.matched,
                report.meshed,
                report.encoded,
            ]
            .map(time),
        }
    }

    /// Share of the asked rungs that were run.
    pub(crate) fn rungs_share(&self) -> f64 {
        f64::from(self.rungs_run) / f64::from(self.rungs_asked.max(1))
    }

    /// What of the server's time is in none of the stages: the frame made way for others.
    pub(crate) fn aside(&self) -> Duration {
        self.total.saturating_sub(self.stages.iter().sum())
    }
}

impl Record {
    /// Whether a result was there, whole, before the budget was over - counted from when the frame was due.
    pub(crate) fn is_in_budget(&self) -> bool {
        matches!(self.outcome, Outcome::Answered(_)) && self.latency <= self.shot.budget
    }

    /// As [`is_in_budget`](Self::is_in_budget), counted from when the frame was sent: without the delays of the generator's timer.
    pub(crate) fn is_in_budget_from_sending(&self) -> bool {
        let taken = self.latency.saturating_sub(self.lag);
        matches!(self.outcome, Outcome::Answered(_)) && taken <= self.shot.budget
    }

    /// Whether the server was in time by its own clock, which starts when the request's head has arrived and stops when
    /// the answer is written.
    pub(crate) fn is_in_budget_by_the_server(&self) -> bool {
        matches!(&self.outcome, Outcome::Answered(digest) if digest.deadline_met)
    }

    /// Whether the server took the frame on: it answered, or it promised to and the deadline passed.
    pub(crate) fn is_admitted(&self) -> bool {
        matches!(
            self.outcome,
            Outcome::Answered(_)
                | Outcome::Refused {
                    reason: Reason::Expired,
                    ..
                }
        )
    }
}
