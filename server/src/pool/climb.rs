//! Up the ladder, rung by rung: until it or the request ends, or somebody says that it is enough.

use std::time::{Duration, Instant};

use stereo::{ForkJoin, Progress, Quality};
use stereo_scheduler::{Stage, StopReason, Verdict};

use super::rig::Rig;
use crate::dispatch::{Job, Replaced, Seat};
use crate::job::{FrameOptions, PriorityClass};
use crate::status::ServiceError;

/// Why a frame has no reply.
#[derive(Debug)]
pub(crate) enum Stopped {
    /// Nobody waits for it any more; the scheduler has said so.
    Abandoned,
    /// Another thread has this worker's place, and the frame has been answered.
    Replaced,
    /// The client gets the reason.
    Failed(ServiceError),
}

impl From<ServiceError> for Stopped {
    fn from(error: ServiceError) -> Self {
        Self::Failed(error)
    }
}

impl From<Replaced> for Stopped {
    fn from(_: Replaced) -> Self {
        Self::Replaced
    }
}

/// Who says when it is enough.
pub(super) enum Guide<'a> {
    /// The scheduler.
    Seat(&'a Seat),
    /// Nobody: a number of rungs is climbed and timed.
    Clock(&'a mut Clock),
}

/// Times the stages of a dummy frame.
pub(super) struct Clock {
    last: Instant,
    step: Instant,
    /// How far to go.
    rungs: u8,
    /// The last rung finished, from 0.
    reached: u8,
    pub(super) stages: Vec<(Stage, Duration)>,
}

impl Clock {
    pub(super) fn new(rungs: u8) -> Self {
        let now = Instant::now();
        Self {
            last: now,
            step: now,
            rungs,
            reached: 0,
            stages: Vec::new(),
        }
    }

    fn lap(&mut self) -> Duration {
        let now = Instant::now();
        let took = now - self.last;
        self.last = now;
        self.step = now;
        took
    }
}

impl Guide<'_> {
    pub(super) fn decoded(&mut self) -> Result<(), Replaced> {
        match self {
            Self::Seat(seat) => seat.decoded(),
            Self::Clock(clock) => {
                let took = clock.lap();
                clock.stages.push((Stage::Decode, took));
                Ok(())
            }
        }
    }

    fn rung_done(&mut self, rung: u8, has_more: bool) -> Result<Verdict, Replaced> {
        match self {
            Self::Seat(seat) => seat.rung_done(has_more),
            Self::Clock(clock) => {
                let took = clock.lap();
                clock.reached = rung - 1;
                clock.stages.push((Stage::Rung(clock.reached), took));
                Ok(if has_more && rung < clock.rungs {
                    Verdict::Continue
                } else {
                    COMPLETE
                })
            }
        }
    }

    /// What there is at a rung has been handed out.
    fn shared(&mut self) -> Result<Verdict, Replaced> {
        match self {
            Self::Seat(seat) => seat.shared(),
            Self::Clock(_) => Ok(Verdict::Continue),
        }
    }

    fn step_done(&mut self) -> Result<Verdict, Replaced> {
        match self {
            Self::Seat(seat) => seat.step_done(),
            Self::Clock(clock) => {
                let took = clock.step.elapsed();
                clock.step = Instant::now();
                clock.stages.push((Stage::Step, took));
                Ok(Verdict::Continue)
            }
        }
    }

    pub(super) fn meshed(&mut self) -> Result<(), Replaced> {
        match self {
            Self::Seat(seat) => seat.meshed(),
            Self::Clock(clock) => {
                let took = clock.lap();
                clock.stages.push((Stage::Mesh(clock.reached), took));
                Ok(())
            }
        }
    }

    /// One body is encoded.
    pub(super) fn encoded(&mut self) -> Result<(), Replaced> {
        match self {
            Self::Seat(seat) => seat.beat(),
            Self::Clock(clock) => {
                let took = clock.lap();
                clock.stages.push((Stage::Encode(clock.reached), took));
                Ok(())
            }
        }
    }
}

/// Hands out what there is.
pub(super) type Share<'a> = dyn Fn(&mut Rig, &Height) -> Result<(), ServiceError> + 'a;

/// The end of the ladder.
const COMPLETE: Verdict = Verdict::Finish {
    has_mesh: true,
    because: StopReason::Complete,
};

/// How far a frame has got, kept while it lies aside.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Height {
    pub(super) quality: Option<Quality>,
    pub(super) steps: u64,
    /// Whether the matcher has nothing left worth doing.
    pub(super) has_converged: bool,
    /// Time spent matching.
    pub(super) matched: Duration,
}

/// Why the climb ended.
pub(super) enum Top {
    /// Publish what there is.
    Finish { has_mesh: bool, because: StopReason },
    /// Lay the frame aside.
    Aside,
}

/// From where the frame is until it is told to stop, first by `verdict`, with the help of `join`. `has_mesh` as planned; `active` is how
/// long the frame has been worked on before. `share` hands out what there is at a rung that is not the last, if somebody wants that.
pub(super) fn climb(
    (rig, join, share): (&mut Rig, &dyn ForkJoin, Option<&Share<'_>>),
    job: &Job,
    height: &mut Height,
    guide: &mut Guide<'_>,
    (mut verdict, has_mesh): (Verdict, bool),
    active: Duration,
) -> Result<Top, Stopped> {
    let started = Instant::now();
    let before = height.matched;
    loop {
        match verdict {
            Verdict::Finish { has_mesh, because } => return Ok(Top::Finish { has_mesh, because }),
            Verdict::Yield => return Ok(Top::Aside),
            Verdict::Abandon => return Err(Stopped::Abandoned),
            Verdict::Continue
                if height.quality.is_some() && is_spent(&job.request.options, active + started.elapsed()) =>
            {
                return Ok(Top::Finish {
                    has_mesh,
                    because: StopReason::Budget,
                });
            }
            Verdict::Continue => {}
        }
        let progress = rig.step(&job.request, height.quality.is_none(), join)?;
        height.steps += 1;
        height.matched = before + started.elapsed();
        height.has_converged = matches!(progress, Progress::Converged(_));
        let reached = height.quality.map_or(0, |quality| quality.rung);
        verdict = match progress {
            Progress::Working => guide.step_done()?,
            Progress::Improved(quality) | Progress::Converged(quality) if quality.rung > reached => {
                height.quality = Some(quality);
                job.report_rung(quality);
                let verdict = guide.rung_done(quality.rung, matches!(progress, Progress::Improved(_)))?;
                match share {
                    Some(share) if verdict == Verdict::Continue => {
                        share(rig, height)?;
                        guide.shared()?
                    }
                    _ => verdict,
                }
            }
            // Nothing was left to do, which the scheduler could not know.
            Progress::Improved(_) | Progress::Converged(_) => Verdict::Finish {
                has_mesh,
                because: StopReason::Complete,
            },
        };
    }
}

/// Whether a background request has used up the budget it was given. Budgets of the others are the scheduler's business.
fn is_spent(options: &FrameOptions, active: Duration) -> bool {
    options.priority == PriorityClass::Background && active >= options.latency_budget
}
