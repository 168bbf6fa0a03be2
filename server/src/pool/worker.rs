//! One worker's way through a frame: decode, the ladder's rungs while the scheduler allows, mesh, encode.

use std::sync::Arc;
use std::time::{Duration, Instant};

use stereo::{ForkJoin, Level, Params, Serial};
use stereo_scheduler::{Dispatch as Taken, Plan, StopReason, Ticket, Verdict};

use super::Shared;
use super::climb::{Guide, Height, Share, Stopped, Top, climb};
use super::rig::Rig;
use super::spares::{SPARE_PX, Spares};
use crate::dispatch::{Job, Seat, work};
use crate::encode;
use crate::encode::memory::Encoded;
use crate::job::{Degradation, FrameReply, MatchedFrame, PriorityClass, ReplyFormat, Report, RungsCut};
use crate::status::ServiceError;

/// The matchers, the buffers, and what they are used with.
pub(crate) struct Worker {
    index: usize,
    level: Level,
    shared: Arc<Shared>,
    rig: Rig,
    /// Frames that make room for others, and their rigs: one of the background class at most, and of those with a deadline as many as
    /// the scheduler allows.
    aside: Vec<(Run, Rig)>,
    /// Rigs for the other frames meanwhile.
    spares: Spares,
}

/// A frame that a worker has taken.
pub(crate) struct Run {
    ticket: Ticket,
    pub(crate) job: Arc<Job>,
    plan: Plan,
    waiting: usize,
    taken_at: Instant,
    /// When its images were gray; `None` before that.
    decoded_at: Option<Instant>,
    height: Height,
    /// What to do next.
    verdict: Verdict,
    /// Since when it lies aside, and for how long it did before.
    aside_since: Option<Instant>,
    aside_for: Duration,
}

/// What a worker did with a frame.
pub(crate) enum Ended {
    /// Everything.
    Reply(Box<FrameReply>),
    /// A part; the rest has to wait.
    Aside,
}

impl Run {
    pub(crate) fn new(taken: Taken<Arc<Job>>) -> Self {
        Self {
            ticket: taken.ticket,
            job: taken.job,
            plan: taken.plan,
            waiting: taken.waiting,
            taken_at: Instant::now(),
            decoded_at: None,
            height: Height::default(),
            verdict: Verdict::Continue,
            aside_since: None,
            aside_for: Duration::ZERO,
        }
    }

    /// How long it has been worked on.
    fn active(&self) -> Duration {
        self.taken_at.elapsed().saturating_sub(self.aside_for)
    }
}

impl Worker {
    pub(crate) fn new(index: usize, level: Level, shared: Arc<Shared>) -> Self {
        Self {
            index,
            level,
            shared,
            rig: Rig::default(),
            aside: Vec::new(),
            spares: Spares::default(),
        }
    }

    pub(crate) fn index(&self) -> usize {
        self.index
    }

    pub(crate) fn shared(&self) -> &Shared {
        &self.shared
    }

    pub(super) fn level(&self) -> Level {
        self.level
    }

    pub(super) fn rig_mut(&mut self) -> &mut Rig {
        &mut self.rig
    }

    /// Puts the rig aside, and one of those in its place that frames with a deadline have while another lies aside.
    pub(super) fn swap_rigs(&mut self) {
        let rig = std::mem::replace(&mut self.rig, self.spares.take());
        self.spares.keep(rig, Instant::now());
    }

    /// Makes the images of a frame gray, with the rig that is in place, unless that holds far more memory than the frame needs and
    /// might be laid aside with it.
    fn load(&mut self, run: &Run) -> Result<(), ServiceError> {
        let request = &run.job.request;
        let area_px = work(request, false).units as usize;
        if !self.aside.is_empty() && self.rig.largest_px() > (2 * area_px).max(SPARE_PX / 4) {
            self.rig = Rig::default();
        }
        self.rig.load(self.level, request, run.plan.is_half)
    }

    /// Forgets everything a panic may have left in disorder.
    pub(crate) fn rebuild(&mut self) {
        self.rig = Rig::default();
    }

    /// Lays a frame aside with its rig.
    pub(crate) fn put_aside(&mut self, mut run: Run) {
        run.aside_since = Some(Instant::now());
        let rig = std::mem::replace(&mut self.rig, self.spares.take());
        self.aside.push((run, rig));
    }

    /// Takes a frame up again that lies aside, to go on with `verdict`.
    pub(crate) fn pick_up(&mut self, ticket: Ticket, verdict: Verdict) -> Option<Run> {
        let place = self.aside.iter().position(|(run, _)| run.ticket == ticket)?;
        let (mut run, rig) = self.aside.swap_remove(place);
        let spare = std::mem::replace(&mut self.rig, rig);
        self.spares.keep(spare, Instant::now());
        run.verdict = verdict;
        if let Some(since) = run.aside_since.take() {
            run.aside_for += since.elapsed();
        }
        Some(run)
    }

    /// Carries a frame from its image data, or from where it was laid aside, to its encoded bodies.
    pub(crate) fn process(&mut self, run: &mut Run, seat: &Seat) -> Result<Ended, Stopped> {
        let request = &run.job.request;
        let mut guide = Guide::Seat(seat);
        let decoded_at = match run.decoded_at {
            Some(decoded_at) => decoded_at,
            None => {
                self.load(run)?;
                guide.decoded()?;
                *run.decoded_at.insert(Instant::now())
            }
        };
        let active = run.active();
        let planned = (run.verdict, run.plan.has_mesh);
        let join: &dyn ForkJoin = match &self.shared.helpers {
            Some(helpers) if run.job.is_split => helpers,
            _ => &Serial,
        };
        let desk = Desk {
            seat,
            shared: &self.shared,
            worker: self.index,
            job: &run.job,
            plan: &run.plan,
            waiting: run.waiting,
            taken_at: run.taken_at,
            aside_for: run.aside_for,
            decoded_at,
        };
        let share = |rig: &mut Rig, height: &Height| desk.share(rig, height, run.plan.has_mesh);
        let share = run.job.on_partial().map(|_| &share as &Share<'_>);
        let top = climb(
            (&mut self.rig, join, share),
            &run.job,
            &mut run.height,
            &mut guide,
            planned,
            active,
        )?;
        let Top::Finish { has_mesh, because } = top else {
            return Ok(Ended::Aside);
        };
        let times = desk.finish(&mut self.rig, has_mesh);
        if times.meshed_at.is_some() {
            guide.meshed()?;
        }
        let mut bodies: Vec<Encoded> = Vec::with_capacity(request.formats.len());
        for &format in &request.formats {
            bodies.push(desk.body(format, &self.rig, &run.height, because, &times)?);
            guide.encoded()?;
        }
        Ok(Ended::Reply(Box::new(FrameReply {
            bodies,
            report: desk.report(&run.height, because, &times),
            costs: None,
        })))
    }
}

/// Where a result and its report are written.
struct Desk<'a> {
    seat: &'a Seat,
    shared: &'a Shared,
    worker: usize,
    job: &'a Job,
    plan: &'a Plan,
    waiting: usize,
    taken_at: Instant,
    aside_for: Duration,
    decoded_at: Instant,
}

impl Desk<'_> {
    /// Hands out what there is now.
    fn share(&self, rig: &mut Rig, height: &Height, has_mesh: bool) -> Result<(), ServiceError> {
        let (Some(on_partial), Some(&format)) = (self.job.on_partial(), self.job.request.formats.first())
        else {
            return Ok(());
        };
        let times = self.finish(rig, has_mesh);
        on_partial(self.body(format, rig, height, StopReason::Complete, &times)?);
        Ok(())
    }

    /// Brings map and mesh into the form they are sent in.
    fn finish(&self, rig: &mut Rig, has_mesh: bool) -> Times {
        let matched_at = Instant::now();
        Times {
            decoded_at: self.decoded_at,
            matched_at,
            meshed_at: rig.finish(&self.job.request, has_mesh),
        }
    }

    fn body(
        &self,
        format: ReplyFormat,
        rig: &Rig,
        height: &Height,
        because: StopReason,
        times: &Times,
    ) -> Result<Encoded, ServiceError> {
        let request = &self.job.request;
        let (left_gray, map) = rig.result(request)?;
        let frame = MatchedFrame {
            request,
            left_gray,
            map,
            mesh: times.meshed_at.map(|_| &rig.mesh),
        };
        encode::body(format, &frame, self.job.memory(), &|| {
            self.report(height, because, times)
        })
    }

    fn report(&self, height: &Height, because: StopReason, times: &Times) -> Report {
        let now = Instant::now();
        let request = &self.job.request;
        let options = &request.options;
        let Height {
            quality,
            steps,
            has_converged,
            matched,
        } = *height;
        let (rung, estimate, density) = quality.map_or((0, 0.0, 0.0), |q| (q.rung, q.estimate, q.density));
        let asked = work(request, false);
        let encoding_from = times.meshed_at.unwrap_or(times.matched_at);
        let actual_cost = (now - self.taken_at).saturating_sub(self.aside_for);
        Report {
            budget: options.latency_budget,
            received: self
                .job
                .enqueued_at
                .saturating_duration_since(request.received_at),
            queued: self.taken_at - self.job.enqueued_at,
            decoded: times.decoded_at - self.taken_at,
            matched,
            meshed: times
                .meshed_at
                .map_or(Duration::ZERO, |meshed_at| meshed_at - times.matched_at),
            encoded: now - encoding_from,
            total: now.saturating_duration_since(request.received_at),
            iterations_run: rung.into(),
            iterations_asked: asked.rungs.into(),
            rung: rung_name(&options.params, rung),
            predicted_cost: self.seat.expected(),
            actual_cost,
            deadline_met: match options.priority {
                PriorityClass::Background => actual_cost <= options.latency_budget,
                PriorityClass::Deadline | PriorityClass::BestEffort => {
                    request.deadline().is_none_or(|deadline| now <= deadline)
                }
            },
            quality_estimate: estimate,
            density,
            steps,
            has_converged,
            degradation: Degradation {
                rungs: cut(because, rung, asked.rungs, self.plan).filter(|_| !has_converged),
                is_half: self.plan.is_half,
                has_no_mesh: asked.mesh.is_some() && times.meshed_at.is_none(),
            },
            worker: u32::try_from(self.worker).unwrap_or(u32::MAX),
            instance: self.shared.instance.clone(),
            queue_depth: u32::try_from(self.waiting).unwrap_or(u32::MAX),
            software_version: env!("CARGO_PKG_VERSION"),
        }
    }
}

/// When the stages of a frame ended.
struct Times {
    decoded_at: Instant,
    matched_at: Instant,
    /// `None` = no mesh was made.
    meshed_at: Option<Instant>,
}

/// Why fewer rungs were run than asked for, if so.
fn cut(because: StopReason, rung: u8, asked: u8, plan: &Plan) -> Option<RungsCut> {
    match because {
        _ if rung >= asked => None,
        StopReason::Budget => Some(RungsCut::Budget),
        StopReason::Load => Some(RungsCut::Load),
        StopReason::Superseded => Some(RungsCut::Superseded),
        // The plan was shorter than asked.
        StopReason::Complete if rung >= plan.rungs && plan.rungs < asked => Some(RungsCut::Load),
        StopReason::Complete => None,
    }
}

fn rung_name(params: &Params, rung: u8) -> &'static str {
    let index = usize::from(rung).saturating_sub(1);
    params.rung_names().get(index).copied().unwrap_or_default()
}

impl From<Stopped> for ServiceError {
    fn from(stopped: Stopped) -> Self {
        match stopped {
            Stopped::Failed(error) => error,
            Stopped::Abandoned | Stopped::Replaced => Self::Internal("the frame was given up".to_owned()),
        }
    }
}
