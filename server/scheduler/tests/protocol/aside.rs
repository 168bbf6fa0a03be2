//! Jobs that are put aside for more urgent ones, and come back.

use stereo_scheduler::{Config, Next, Reason, StopReason, Verdict};

use super::{UNITS, admitted, background, due, ms, primed, started};

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

#[test]
fn a_job_that_comes_is_begun_before_the_one_at_work_is_refined_and_both_get_all_their_rungs() {
    let mut scheduler = primed(Config::default());
    let first = admitted(scheduler.submit(ms(0), due(80), "first"));
    started(scheduler.next(ms(0), 0));
    scheduler.decoded(ms(1), 0);
    assert_eq!(scheduler.rung_done(ms(11), 0, true), Verdict::Continue);
    let second = admitted(scheduler.submit(ms(12), due(92), "second"));
    assert_eq!(scheduler.step_done(ms(12), 0), Verdict::Yield);
    assert_eq!(started(scheduler.next(ms(12), 0)).ticket, second);
    scheduler.decoded(ms(13), 0);
    // Its answer is there, and the rungs of the one that is due earlier come first.
    assert_eq!(scheduler.rung_done(ms(23), 0, true), Verdict::Yield);
    let resumed = scheduler.next(ms(23), 0);
    assert!(
        matches!(resumed, Some(Next::Resume { ticket, verdict: Verdict::Continue }) if ticket == first),
        "{resumed:?}"
    );
    assert_eq!(scheduler.rung_done(ms(27), 0, true), Verdict::Continue);
    let complete = Verdict::Finish {
        has_mesh: true,
        because: StopReason::Complete,
    };
    assert_eq!(scheduler.rung_done(ms(32), 0, true), complete);
    scheduler.meshed(ms(34), 0);
    scheduler.finished(ms(35), 0);
    let resumed = scheduler.next(ms(35), 0);
    assert!(
        matches!(resumed, Some(Next::Resume { ticket, .. }) if ticket == second),
        "{resumed:?}"
    );
}

#[test]
fn a_job_that_would_lose_a_rung_to_one_that_comes_is_refined_first() {
    let mut scheduler = primed(Config::default());
    admitted(scheduler.submit(ms(0), due(30), "first"));
    started(scheduler.next(ms(0), 0));
    scheduler.decoded(ms(1), 0);
    assert_eq!(scheduler.rung_done(ms(11), 0, true), Verdict::Continue);
    admitted(scheduler.submit(ms(12), due(92), "second"));
    assert_eq!(scheduler.step_done(ms(12), 0), Verdict::Continue);
}

#[test]
fn no_more_jobs_lie_aside_than_may() {
    for (max_aside, max_aside_units, wanted) in
        [(3, u64::MAX, 2), (8, 3 * u64::from(UNITS), 3), (1, u64::MAX, 0)]
    {
        let mut scheduler = primed(Config {
            max_aside,
            max_aside_units,
            ..Config::default()
        });
        let mut aside = 0;
        admitted(scheduler.submit(ms(0), due(900), "first"));
        started(scheduler.next(ms(0), 0));
        for round in 0..6 {
            let from = 12 * round;
            scheduler.decoded(ms(from + 1), 0);
            admitted(scheduler.submit(ms(from + 2), due(910 + round), "another"));
            if scheduler.rung_done(ms(from + 11), 0, true) != Verdict::Yield {
                break;
            }
            let Some(Next::Start(_)) = scheduler.next(ms(from + 12), 0) else {
                break;
            };
            aside += 1;
        }
        assert_eq!(aside, wanted, "{max_aside}, {max_aside_units}");
    }
}
