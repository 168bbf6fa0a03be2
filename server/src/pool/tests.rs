use std::time::Duration;

use tokio::sync::oneshot::Receiver;

use super::prime::dummy_request;
use super::*;
use crate::dispatch::Outcome;
use crate::job::{FrameRequest, ReplyFormat};

fn shared() -> Arc<Shared> {
    Arc::new(Shared {
        dispatch: Arc::new(Dispatch::new(8)),
        costs: CostBook::default(),
        instance: "test".to_owned(),
        priming: watch::Sender::new(Priming::default()),
        panics: AtomicU64::new(0),
    })
}

fn request() -> FrameRequest {
    FrameRequest {
        formats: vec![ReplyFormat::DisparityPng],
        ..dummy_request()
    }
}

fn send(shared: &Shared, request: FrameRequest) -> Receiver<Outcome> {
    shared.dispatch.push(request, None).unwrap().outcome
}

fn wait(outcome: Receiver<Outcome>) -> Outcome {
    outcome.blocking_recv().unwrap()
}

#[test]
fn a_panic_fails_its_own_frame_is_counted_and_the_worker_goes_on() {
    let shared = shared();
    let process: Arc<Process> = Arc::new(|worker, job, depth| {
        assert_ne!(
            job.request.ids.camera_id, "bad",
            "a fault in the matcher, for this test"
        );
        worker.process(job, depth)
    });
    let pool = Pool::start_with(1, Level::SCALAR, &shared, &process).unwrap();
    let mut bad = request();
    bad.ids.camera_id = "bad".to_owned();
    let (before, failed, after) = (
        send(&shared, request()),
        send(&shared, bad),
        send(&shared, request()),
    );
    let (before, failed, after) = (wait(before), wait(failed), wait(after));
    assert!(matches!(failed, Err(ServiceError::Internal(_))), "{failed:?}");
    assert_eq!(shared.panics.load(Ordering::Relaxed), 1);
    assert_eq!(
        before.unwrap().bodies,
        after.unwrap().bodies,
        "the rebuilt matcher gives the same result"
    );
    shared.dispatch.close();
    pool.join();
}

#[test]
fn the_report_of_a_frame_adds_up() {
    let shared = shared();
    let mut worker = Worker::new(3, Level::SCALAR, Arc::clone(&shared));
    let (job, _outcome) = Job::detached(request());
    let report = worker
        .process(&job, 7)
        .unwrap_or_else(|stopped| panic!("{stopped:?}"))
        .report;
    assert_eq!(
        (report.worker, report.queue_depth, report.instance.as_str()),
        (3, 7, "test")
    );
    assert!(
        report.deadline_met && report.iterations_run >= 1 && report.iterations_run <= report.iterations_asked
    );
    assert_eq!(report.meshed, Duration::ZERO, "nobody asked for a mesh");
    let stages = report.decoded + report.matched + report.meshed + report.encoded;
    assert!(stages <= report.actual_cost && report.actual_cost <= report.total);
    assert_eq!(report.predicted_cost, Duration::ZERO, "nothing was known yet");
    let second = worker
        .process(&job, 0)
        .unwrap_or_else(|stopped| panic!("{stopped:?}"))
        .report;
    assert!(second.predicted_cost > Duration::ZERO);
}

#[test]
fn max_iterations_is_a_number_of_rungs() {
    let mut worker = Worker::new(0, Level::SCALAR, shared());
    let mut one = request();
    one.options.max_iterations = Some(1);
    let (job, _outcome) = Job::detached(one);
    let report = worker
        .process(&job, 0)
        .unwrap_or_else(|stopped| panic!("{stopped:?}"))
        .report;
    assert_eq!(
        (report.iterations_run, report.iterations_asked, report.degradation),
        (1, 1, "")
    );
}

#[test]
fn a_spent_budget_still_gives_the_first_rung_and_says_what_was_cut() {
    let mut worker = Worker::new(0, Level::SCALAR, shared());
    let mut late = request();
    late.options.latency_budget = Duration::from_nanos(1);
    let (job, _outcome) = Job::detached(late);
    let report = worker
        .process(&job, 0)
        .unwrap_or_else(|stopped| panic!("{stopped:?}"))
        .report;
    assert_eq!(report.iterations_run, 1);
    assert!(!report.deadline_met && !report.degradation.is_empty());
}

#[test]
fn an_abandoned_frame_is_not_carried_to_its_end() {
    let mut worker = Worker::new(0, Level::SCALAR, shared());
    let (job, outcome) = Job::detached(request());
    drop(outcome);
    assert!(matches!(worker.process(&job, 0), Err(Stopped::Abandoned)));
}

#[test]
fn the_matcher_is_refitted_when_the_shape_or_the_parameters_change() {
    let mut worker = Worker::new(0, Level::SCALAR, shared());
    let first = request();
    let mut paper = request();
    paper.options.params = stereo::Params::paper();
    let mut small = request();
    for image in [&mut small.left, &mut small.right] {
        (image.width_px, image.height_px) = (320, 200);
    }
    let bodies = |worker: &mut Worker, request: &FrameRequest| {
        let (job, _outcome) = Job::detached(request.clone());
        worker
            .process(&job, 0)
            .unwrap_or_else(|stopped| panic!("{stopped:?}"))
            .bodies
    };
    let before = bodies(&mut worker, &first);
    bodies(&mut worker, &paper);
    bodies(&mut worker, &small);
    assert_eq!(bodies(&mut worker, &first), before);
}
