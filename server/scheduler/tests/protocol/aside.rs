//! Jobs that are put aside for more urgent ones, and come back.

use stereo_scheduler::{Config, Next, Reason, StopReason, Verdict};

use super::{admitted, background, due, ms, primed, started};

#[test]
fn a_job_makes_way_for_one_that_is_due_earlier_and_comes_back_with_its_promise_kept() {
    let mut scheduler = primed(Config::default());
    let patient = admitted(scheduler.submit(ms(0), due(60), "patient"));
    started(scheduler.next(ms(0), 0));
    let urgent = admitted(scheduler.submit(ms(0), due(33), "urgent"));
    scheduler.decoded(ms(1), 0);
    assert_eq!(scheduler.rung_done(ms(11), 0, true), Verdict::Yield);
    assert_eq!(started(scheduler.next(ms(11), 0)).ticket, urgent);
    assert_eq!(scheduler.snapshot(ms(11)).waiting, 0, "it was started");
    // What it still needs is promised: mesh and encoding, 3 ms.
    let refused = scheduler.submit(ms(11), due(40), "too much").outcome.unwrap_err();
    assert_eq!(refused.refusal.reason, Reason::DeadlineInfeasible);
    scheduler.decoded(ms(12), 0);
    assert_eq!(scheduler.rung_done(ms(22), 0, true), Verdict::Continue);
    let because = StopReason::Budget;
    let stop = Verdict::Finish {
        has_mesh: true,
        because,
    };
    assert_eq!(scheduler.rung_done(ms(27), 0, true), stop);
    scheduler.meshed(ms(29), 0);
    scheduler.finished(ms(30), 0);
    let resumed = scheduler.next(ms(30), 0);
    assert!(
        matches!(resumed, Some(Next::Resume { ticket, verdict: Verdict::Continue }) if ticket == patient),
        "{resumed:?}"
    );
    assert_eq!(scheduler.rung_done(ms(35), 0, true), Verdict::Continue);
}

#[test]
fn a_background_job_goes_on_while_all_that_waits_lies_aside_at_another_worker() {
    let mut scheduler = primed(Config {
        workers: 2,
        ..Config::default()
    });
    let batch = admitted(scheduler.submit(ms(0), background(), "batch"));
    assert_eq!(started(scheduler.next(ms(0), 1)).ticket, batch);
    scheduler.decoded(ms(1), 1);
    admitted(scheduler.submit(ms(1), due(90), "patient"));
    started(scheduler.next(ms(1), 0));
    admitted(scheduler.submit(ms(1), due(30), "urgent"));
    scheduler.decoded(ms(2), 0);
    assert_eq!(scheduler.rung_done(ms(12), 0, true), Verdict::Yield);
    started(scheduler.next(ms(12), 0));
    assert_eq!(scheduler.rung_done(ms(12), 1, true), Verdict::Continue);
}

#[test]
fn a_job_that_lies_aside_when_there_is_no_time_left_for_rungs_is_finished_at_once() {
    let mut scheduler = primed(Config::default());
    admitted(scheduler.submit(ms(0), due(40), "patient"));
    started(scheduler.next(ms(0), 0));
    admitted(scheduler.submit(ms(0), due(30), "urgent"));
    scheduler.decoded(ms(1), 0);
    assert_eq!(scheduler.rung_done(ms(11), 0, true), Verdict::Yield);
    started(scheduler.next(ms(11), 0));
    scheduler.failed(ms(34), 0);
    let because = StopReason::Budget;
    let verdict = Verdict::Finish {
        has_mesh: true,
        because,
    };
    let resumed = scheduler.next(ms(34), 0);
    assert!(
        matches!(resumed, Some(Next::Resume { verdict: told, .. }) if told == verdict),
        "{resumed:?}"
    );
}
