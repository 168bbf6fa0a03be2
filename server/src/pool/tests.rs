use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use stereo_scheduler::{Policy, Verdict};
use tokio::sync::oneshot;

use super::prime::dummy_request;
use super::*;
use crate::dispatch::{Delivery, Outcome, Setting};
use crate::job::{FrameOptions, FrameReply, FrameRequest, PriorityClass, ReplyFormat, RungsCut};

const PATIENT: Patience = Patience {
    stuck_after: Duration::from_secs(600),
    replacements: 1,
};

fn shared(policy: Policy) -> Arc<Shared> {
    let metrics = Arc::new(Metrics::new());
    let setting = Setting {
        workers: 1,
        capacity: 8,
        policy,
        ..Setting::default()
    };
    Arc::new(Shared {
        dispatch: Arc::new(Dispatch::new(setting, Arc::clone(&metrics))),
        helpers: None,
        metrics,
        instance: "test".to_owned(),
        priming: signal::Sender::new(Priming::default()),
        is_crippled: AtomicBool::new(false),
    })
}

fn request() -> FrameRequest {
    FrameRequest {
        formats: vec![ReplyFormat::DisparityPng],
        ..dummy_request()
    }
}

fn named(camera: &str) -> FrameRequest {
    let mut named = request();
    named.ids.camera_id = camera.to_owned();
    named
}

fn send(shared: &Shared, request: FrameRequest) -> oneshot::Receiver<Outcome> {
    shared
        .dispatch
        .submit(request, Delivery::default())
        .unwrap()
        .outcome
}

fn wait(outcome: oneshot::Receiver<Outcome>) -> Outcome {
    outcome.blocking_recv().unwrap()
}

/// A worker on this thread, and what it makes of one request.
struct Bench {
    shared: Arc<Shared>,
    seat: Seat,
    worker: Worker,
}

impl Bench {
    fn new(policy: Policy) -> Self {
        let shared = shared(policy);
        Self {
            seat: shared.dispatch.seat(0),
            worker: Worker::new(0, Level::SCALAR, Arc::clone(&shared)),
            shared,
        }
    }

    fn start(&self) -> Run {
        match self.seat.take() {
            Some(Task::Start(taken)) => Run::new(taken),
            _ => panic!("nothing to start"),
        }
    }

    fn reply(&mut self, request: FrameRequest) -> FrameReply {
        let outcome = send(&self.shared, request);
        let mut run = self.start();
        let ended = self.worker.process(&mut run, &self.seat);
        settle(&mut self.worker, run, &self.seat, ended);
        wait(outcome).unwrap()
    }
}

#[test]
fn a_panic_fails_its_own_frame_is_counted_and_the_worker_goes_on() {
    let shared = shared(Policy::Edf);
    let process: Arc<Process> = Arc::new(|worker, run, seat| {
        assert_ne!(
            run.job.request.ids.camera_id, "bad",
            "a fault in the matcher, for this test"
        );
        worker.process(run, seat)
    });
    let pool = Pool::start_with(1, Level::SCALAR, PATIENT, &shared, process).unwrap();
    let before = wait(send(&shared, request()));
    let failed = wait(send(&shared, named("bad")));
    let after = wait(send(&shared, request()));
    assert!(matches!(failed, Err(ServiceError::Internal(_))), "{failed:?}");
    assert_eq!(shared.metrics.worker_panics.get(), 1);
    assert_eq!(
        before.unwrap().bodies,
        after.unwrap().bodies,
        "the rebuilt matcher gives the same result"
    );
    pool.join();
}

/// Workers that hang at frames of the camera `stuck` until the sender is dropped, and say when they are there.
fn hanging() -> (Arc<Process>, Receiver<()>, SyncSender<()>) {
    let (reached, at) = sync_channel(8);
    let (release, released) = sync_channel(0);
    let released = Mutex::new(released);
    let process: Arc<Process> = Arc::new(move |worker, run, seat| {
        if run.job.request.ids.camera_id == "stuck" {
            reached.send(()).unwrap();
            // Ends when the test drops its end.
            let _ = released.lock().unwrap().recv();
        }
        worker.process(run, seat)
    });
    (process, at, release)
}

#[test]
fn a_stuck_worker_is_replaced_and_its_frame_answered() {
    let shared = shared(Policy::Edf);
    let (process, reached, release) = hanging();
    let impatient = Patience {
        stuck_after: Duration::from_millis(400),
        replacements: 1,
    };
    let pool = Pool::start_with(1, Level::SCALAR, impatient, &shared, process).unwrap();
    let lost = send(&shared, named("stuck"));
    reached.recv().unwrap();
    let error = wait(lost).unwrap_err();
    assert!(
        matches!(&error, ServiceError::Internal(why) if why.contains("no progress")),
        "{error}"
    );
    assert!(
        wait(send(&shared, request())).is_ok(),
        "another thread has its place"
    );
    assert_eq!(shared.metrics.workers_replaced.get(), 1);
    assert!(!shared.is_crippled());
    drop(release);
    pool.join();
}

#[test]
fn a_server_that_can_replace_no_more_workers_says_so() {
    let shared = shared(Policy::Edf);
    let (process, reached, release) = hanging();
    let patience = Patience {
        stuck_after: Duration::from_millis(400),
        replacements: 0,
    };
    let pool = Pool::start_with(1, Level::SCALAR, patience, &shared, process).unwrap();
    let lost = send(&shared, named("stuck"));
    reached.recv().unwrap();
    assert!(wait(lost).is_err());
    while !shared.is_crippled() {
        std::thread::yield_now();
    }
    drop(release);
    pool.join();
}

#[test]
fn the_report_of_a_frame_adds_up() {
    let mut bench = Bench::new(Policy::Edf);
    let report = bench.reply(request()).report;
    assert_eq!((report.worker, report.instance.as_str()), (0, "test"));
    assert_eq!(report.queue_depth, 0);
    assert!(
        report.deadline_met && report.iterations_run >= 1 && report.iterations_run <= report.iterations_asked
    );
    assert_eq!(report.meshed, Duration::ZERO, "nobody asked for a mesh");
    assert!(report.steps >= u64::from(report.iterations_run));
    let stages = report.decoded + report.matched + report.meshed + report.encoded;
    assert!(stages <= report.actual_cost && report.actual_cost <= report.total);
    let second = bench.reply(request());
    assert!(second.report.predicted_cost > Duration::ZERO);
    let (predicted, actual) = second.costs.unwrap();
    assert!(predicted > Duration::ZERO && actual > Duration::ZERO);
}

#[test]
fn max_iterations_is_a_number_of_rungs() {
    let mut one = request();
    one.options.max_iterations = Some(1);
    let report = Bench::new(Policy::Edf).reply(one).report;
    assert_eq!((report.iterations_run, report.iterations_asked), (1, 1));
    assert_eq!(report.degradation.to_string(), "");
}

#[test]
fn a_policy_that_cuts_rungs_shows_in_the_report() {
    let report = Bench::new(Policy::Fixed(2)).reply(request()).report;
    assert_eq!(report.iterations_run, 2);
    assert_eq!(report.degradation.rungs, Some(RungsCut::Load));
}

#[test]
fn a_client_that_goes_stops_its_frame_after_the_present_step() {
    let mut bench = Bench::new(Policy::Edf);
    let admission = bench
        .shared
        .dispatch
        .submit(request(), Delivery::default())
        .unwrap();
    let mut run = bench.start();
    assert!(bench.shared.dispatch.cancel(admission.ticket));
    let ended = bench.worker.process(&mut run, &bench.seat);
    assert!(matches!(ended, Err(Stopped::Abandoned)));
    assert!(
        bench.reply(request()).report.iterations_run > 0,
        "the worker is free"
    );
}

#[test]
fn a_background_budget_counts_from_the_moment_a_worker_takes_the_frame() {
    let mut frame = request();
    frame.options.priority = PriorityClass::Background;
    frame.options.latency_budget = Duration::from_nanos(1);
    let report = Bench::new(Policy::Edf).reply(frame.clone()).report;
    assert_eq!(report.iterations_run, 1, "the first rung is always run");
    assert_eq!(report.degradation.rungs, Some(RungsCut::Budget));
    frame.options.latency_budget = FrameOptions::UNBOUNDED;
    let report = Bench::new(Policy::Edf).reply(frame).report;
    assert_eq!(report.iterations_run, report.iterations_asked);
    assert!(report.deadline_met);
}

#[test]
fn a_background_frame_makes_room_and_goes_on_where_it_was() {
    let mut bench = Bench::new(Policy::Edf);
    let mut background = request();
    background.options.priority = PriorityClass::Background;
    let alone = bench.reply(background.clone());
    let outcome = send(&bench.shared, background);
    let mut run = bench.start();
    let urgent = send(&bench.shared, request());
    let ended = bench
        .worker
        .process(&mut run, &bench.seat)
        .unwrap_or_else(|stopped| panic!("{stopped:?}"));
    assert!(matches!(ended, Ended::Aside), "one with a deadline waits");
    settle(&mut bench.worker, run, &bench.seat, Ok(ended));
    let mut first = bench.start();
    let ended = bench.worker.process(&mut first, &bench.seat);
    settle(&mut bench.worker, first, &bench.seat, ended);
    assert!(wait(urgent).is_ok());
    let Some(Task::Resume(ticket, verdict)) = bench.seat.take() else {
        panic!("the one that was laid aside is next");
    };
    let mut again = bench.worker.pick_up(ticket, verdict).unwrap();
    let ended = bench.worker.process(&mut again, &bench.seat);
    settle(&mut bench.worker, again, &bench.seat, ended);
    assert_eq!(wait(outcome).unwrap().bodies, alone.bodies);
}

#[test]
fn half_resolution_gives_a_map_of_the_full_size_near_the_full_one() {
    let mut bench = Bench::new(Policy::Edf);
    prime::prime(&mut bench.worker).unwrap();
    let half = request();
    let rig = bench.worker.rig_mut();
    rig.load(Level::SCALAR, &half, true).unwrap();
    let mut quality = None;
    while let stereo::Progress::Working | stereo::Progress::Improved(_) = {
        let progress = rig.step(&half, quality.is_none(), &stereo::Serial).unwrap();
        quality = Some(progress);
        progress
    } {}
    rig.finish(&half, true);
    let (_, map) = rig.result(&half).unwrap();
    assert_eq!(map.shape().width_px(), 640);
    let found: Vec<f32> = map.iter_px().filter(|px| px.is_finite()).collect();
    assert!(found.len() > 640 * 480 / 4, "{} pixels", found.len());
    let right = found.iter().filter(|px| (*px - 20.0).abs() <= 1.0).count();
    assert!(
        right * 10 > found.len() * 9,
        "{right} of {} are near 20 px",
        found.len()
    );
    assert!(!rig.mesh.triangles.is_empty());
    assert!(
        rig.mesh
            .vertices
            .iter()
            .any(|vertex| vertex.u > 500.0 && (vertex.disparity - 20.0).abs() < 1.0)
    );
}

#[test]
fn the_matcher_is_refitted_when_the_shape_or_the_parameters_change() {
    let mut bench = Bench::new(Policy::Edf);
    let first = request();
    let mut paper = request();
    paper.options.params = stereo::Params::paper();
    let mut small = request();
    for image in [&mut small.left, &mut small.right] {
        (image.width_px, image.height_px) = (320, 200);
    }
    let before = bench.reply(first.clone()).bodies;
    bench.reply(paper);
    bench.reply(small);
    assert_eq!(bench.reply(first).bodies, before);
}

#[test]
fn a_step_of_a_worker_that_was_replaced_is_not_listened_to() {
    let bench = Bench::new(Policy::Edf);
    let lost = send(&bench.shared, request());
    let _run = bench.start();
    let error = ServiceError::Internal("gone".to_owned());
    let seats = bench.shared.dispatch.replace_stuck(Duration::ZERO, &error);
    assert_eq!((seats.len(), wait(lost).unwrap_err()), (1, error));
    assert!(bench.seat.step_done().is_err());
    assert!(bench.seat.take().is_none());
    let next = send(&bench.shared, request());
    assert!(matches!(seats[0].take(), Some(Task::Start(_))));
    assert_ne!(seats[0].step_done(), Ok(Verdict::Abandon));
    drop(next);
}
