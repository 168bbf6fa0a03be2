//! One worker's way through a frame: decode, the ladder's rungs while the budget allows, mesh, encode.

use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use stereo::{DisparityMap, Level, Matcher, Mesh, Progress, Quality, Serial, Shape, StereoPair, rung_names};

use super::Shared;
use super::costs::{FrameClass, Stage, decode_stage, encode_stage};
use super::plan::Plan;
use crate::decode::{self, GrayScratch, Side};
use crate::dispatch::Job;
use crate::encode;
use crate::job::{FrameReply, MatchedFrame, Report};
use crate::status::ServiceError;

/// Degradation as reports write it.
const BUDGET_ENDED: &str = "the latency budget left no time for another rung";

/// Why a frame has no reply.
#[derive(Debug)]
pub(crate) enum Stopped {
    /// Nobody waits for it any more.
    Abandoned,
    /// The client gets the reason.
    Failed(ServiceError),
}

impl From<ServiceError> for Stopped {
    fn from(error: ServiceError) -> Self {
        Self::Failed(error)
    }
}

/// The matcher, the buffers, and what they are used with.
pub(crate) struct Worker {
    index: u32,
    level: Level,
    shared: Arc<Shared>,
    matcher: Option<Matcher>,
    left: GrayScratch,
    right: GrayScratch,
    map: Option<DisparityMap>,
    mesh: Mesh,
}

/// How the rungs of a frame went.
struct Climb {
    quality: Quality,
    degradation: &'static str,
}

impl Worker {
    pub(crate) fn new(index: u32, level: Level, shared: Arc<Shared>) -> Self {
        Self {
            index,
            level,
            shared,
            matcher: None,
            left: GrayScratch::default(),
            right: GrayScratch::default(),
            map: None,
            mesh: Mesh::default(),
        }
    }

    pub(crate) fn index(&self) -> u32 {
        self.index
    }

    pub(crate) fn shared(&self) -> Arc<Shared> {
        Arc::clone(&self.shared)
    }

    /// Forgets everything a panic may have left in disorder.
    pub(crate) fn rebuild(&mut self) {
        *self = Self::new(self.index, self.level, Arc::clone(&self.shared));
    }

    /// Carries one job from its image data to its encoded bodies; `queue_depth` others wait behind it.
    pub(crate) fn process(&mut self, job: &Job, queue_depth: usize) -> Result<FrameReply, Stopped> {
        let taken_at = Instant::now();
        let request = &job.request;
        let options = &request.options;
        let Self {
            index,
            level,
            shared,
            matcher,
            left,
            right,
            map,
            mesh,
        } = self;
        let costs = &shared.costs;

        let left_gray = decode::gray(Side::Left, &request.left, left)?;
        let pair = StereoPair::new(left_gray, decode::gray(Side::Right, &request.right, right)?)
            .map_err(unmatchable)?;
        let shape = Shape::new(left_gray.width_px(), left_gray.height_px()).map_err(unmatchable)?;
        let matcher = fitted(matcher, *level, shape, &options.params)?;
        let map = map.get_or_insert_with(|| DisparityMap::new(shape));
        let decoded_at = Instant::now();
        let class = FrameClass::new(shape, &options.params);
        costs.record(
            class,
            decode_stage(&request.left, &request.right),
            decoded_at - taken_at,
        );

        let plan = Plan::new(job, class, shared);
        let climb = climb(matcher, pair, map, &plan, job)?;
        let matched_at = Instant::now();

        let wants_mesh = plan.wants_mesh;
        if wants_mesh {
            matcher.mesh(&options.mesh, mesh);
        }
        let meshed_at = Instant::now();
        if wants_mesh {
            costs.record(class, Stage::Mesh, meshed_at - matched_at);
        }

        let finish = || {
            let now = Instant::now();
            Report {
                budget: options.latency_budget,
                received: job.enqueued_at.saturating_duration_since(request.received_at),
                queued: taken_at - job.enqueued_at,
                decoded: decoded_at - taken_at,
                matched: matched_at - decoded_at,
                meshed: if wants_mesh {
                    meshed_at - matched_at
                } else {
                    Duration::ZERO
                },
                encoded: now - meshed_at,
                total: now.saturating_duration_since(request.received_at),
                iterations_run: climb.quality.rung.into(),
                iterations_asked: plan.rungs_asked.into(),
                rung: rung_name(options.params.preset, climb.quality.rung),
                predicted_cost: plan.predicted_cost,
                actual_cost: now - taken_at,
                deadline_met: now <= request.deadline(),
                quality_estimate: climb.quality.estimate,
                density: climb.quality.density,
                degradation: climb.degradation,
                worker: *index,
                instance: shared.instance.clone(),
                queue_depth: u32::try_from(queue_depth).unwrap_or(u32::MAX),
                software_version: env!("CARGO_PKG_VERSION"),
            }
        };
        let frame = MatchedFrame {
            request,
            left_gray,
            map,
            mesh: wants_mesh.then_some(&*mesh),
        };
        let mut bodies: Vec<Bytes> = Vec::with_capacity(request.formats.len());
        for &format in &request.formats {
            if job.is_abandoned() {
                return Err(Stopped::Abandoned);
            }
            let started = Instant::now();
            bodies.push(encode::body(format, &frame, &finish)?);
            costs.record(class, encode_stage(format, options), started.elapsed());
        }
        Ok(FrameReply {
            bodies,
            report: finish(),
        })
    }
}

/// Base, then one rung after another: until the ladder or the request ends, or the next rung would not be done in time.
fn climb(
    matcher: &mut Matcher,
    pair: StereoPair<'_>,
    map: &mut DisparityMap,
    plan: &Plan<'_>,
    job: &Job,
) -> Result<Climb, Stopped> {
    let mut rung_started = Instant::now();
    let mut progress = matcher.base(pair, map, &Serial).map_err(unmatchable)?;
    let mut published: Option<Quality> = None;
    loop {
        if let Progress::Improved(quality) | Progress::Converged(quality) = progress {
            let finished = published.map_or(0, |before| before.rung);
            published = Some(quality);
            if quality.rung > finished {
                plan.record_rung(quality.rung - 1, rung_started.elapsed());
                job.report_rung(quality);
            }
            if matches!(progress, Progress::Converged(_)) || quality.rung >= plan.rungs_asked {
                return Ok(Climb {
                    quality,
                    degradation: "",
                });
            }
            if !plan.may_start(quality.rung) {
                return Ok(Climb {
                    quality,
                    degradation: BUDGET_ENDED,
                });
            }
            rung_started = Instant::now();
        } else if let Some(quality) = published
            && plan.is_spent()
        {
            return Ok(Climb {
                quality,
                degradation: BUDGET_ENDED,
            });
        }
        if job.is_abandoned() {
            return Err(Stopped::Abandoned);
        }
        progress = matcher.refine(pair, map, &Serial);
    }
}

/// The worker's matcher, made for `shape` and `params`; nothing is allocated if it is already.
fn fitted<'a>(
    slot: &'a mut Option<Matcher>,
    level: Level,
    shape: Shape,
    params: &stereo::Params,
) -> Result<&'a mut Matcher, ServiceError> {
    match slot.take() {
        Some(mut matcher) => {
            if matcher.shape() != shape || matcher.params() != params {
                let changed = matcher.reconfigure(shape, params.clone());
                if let Err(error) = changed {
                    *slot = Some(matcher);
                    return Err(unmatchable(error));
                }
            }
            Ok(slot.insert(matcher))
        }
        None => Ok(slot.insert(Matcher::new(level, shape, params.clone()).map_err(unmatchable)?)),
    }
}

fn rung_name(preset: stereo::Preset, rung: u8) -> &'static str {
    let index = usize::from(rung).saturating_sub(1);
    rung_names(preset).get(index).copied().unwrap_or_default()
}

/// Sizes and parameters that the core refuses, in its own words.
fn unmatchable(error: impl ToString) -> ServiceError {
    ServiceError::Unmatchable(error.to_string())
}
