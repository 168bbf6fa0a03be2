//! One job at a time: what the scheduler answers to each call, and what it remembers.

use std::time::Duration;

use stereo_scheduler::{
    Cancelled, ClientId, Config, Dispatch, DropReason, JobSpec, Level, Next, Policy, Priority, Reason,
    Scheduler, Stage, StopReason, StreamId, Submission, Ticket, Urgency, Verdict, Work,
};

#[cfg(test)]
#[path = "protocol/aside.rs"]
mod aside;

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

const UNITS: u32 = 1000;
const FULL: u32 = 0;
const HALF: u32 = 1;

/// Decode 1 ms, base 10 ms, rungs 5 ms each, mesh 2 ms, encode 1 ms; a quarter of that at half resolution.
fn primed(config: Config) -> Scheduler<u32, &'static str> {
    let mut scheduler = Scheduler::new(config);
    for _ in 0..64 {
        for (kind, part) in [(FULL, 4), (HALF, 1)] {
            for (stage, cost) in [
                (Stage::Decode, 1),
                (Stage::Rung(0), 10),
                (Stage::Rung(1), 5),
                (Stage::Rung(2), 5),
                (Stage::Step, 1),
                (Stage::Mesh(0), 2),
                (Stage::Encode(0), 1),
            ] {
                scheduler.prime(kind, stage, UNITS, ms(cost) * part / 4);
            }
        }
    }
    scheduler
}

fn work(kind: u32) -> Work<u32> {
    Work {
        units: UNITS,
        decode: kind,
        matching: kind,
        mesh: Some(kind),
        encode: kind,
        rungs: 3,
    }
}

fn due(at_ms: u64) -> JobSpec<u32> {
    JobSpec {
        client: ClientId(0),
        weight: 1,
        stream: None,
        urgency: Urgency::Deadline {
            at: ms(at_ms),
            priority: Priority::Normal,
        },
        work: work(FULL),
        half: None,
        is_mesh_optional: false,
    }
}

fn background() -> JobSpec<u32> {
    JobSpec {
        urgency: Urgency::Background,
        ..due(0)
    }
}

fn admitted<J: std::fmt::Debug>(submission: Submission<J>) -> Ticket {
    assert!(submission.dropped.is_empty(), "{:?}", submission.dropped);
    submission.outcome.expect("it fits")
}

fn started(next: Option<Next<&'static str>>) -> Dispatch<&'static str> {
    match next {
        Some(Next::Start(dispatch)) => dispatch,
        other => unreachable!("{other:?}"),
    }
}

#[test]
fn what_is_refused_would_have_been_admitted_at_the_deadline_it_names() {
    let mut scheduler = primed(Config::default());
    for at in [20, 40, 60] {
        admitted(scheduler.submit(ms(0), due(at), "promised"));
    }
    let refused = scheduler.submit(ms(0), due(30), "too much").outcome.unwrap_err();
    assert_eq!(
        (refused.job, refused.refusal.reason),
        ("too much", Reason::DeadlineInfeasible)
    );
    let earliest = refused.refusal.earliest_feasible.unwrap();
    let mut spec = due(0);
    spec.urgency = Urgency::Deadline {
        at: earliest,
        priority: Priority::Normal,
    };
    assert_eq!(scheduler.assess(ms(0), &spec), Ok(()));
    admitted(scheduler.submit(ms(0), spec, "at that"));
}

#[test]
fn late_frame_is_refused_before_work_starts() {
    let mut scheduler = primed(Config::default());
    let refused = scheduler.submit(ms(50), due(50), "late").outcome.unwrap_err();
    assert_eq!(refused.refusal.reason, Reason::Expired);
    let refused = scheduler.assess(ms(50), &due(63)).unwrap_err();
    assert_eq!(
        (refused.reason, refused.earliest_feasible),
        (Reason::DeadlineInfeasible, Some(ms(14)))
    );
}

#[test]
fn a_waiting_job_expires_while_every_worker_is_busy() {
    let mut scheduler = primed(Config::default());
    admitted(scheduler.submit(ms(0), due(40), "stuck"));
    started(scheduler.next(ms(0), 0));
    let ticket = admitted(scheduler.submit(ms(0), due(41), "waits"));
    let wakeup = scheduler.next_wakeup().unwrap();
    assert!((ms(27)..ms(28)).contains(&wakeup), "it takes 14 ms: {wakeup:?}");
    assert!(scheduler.expire(ms(27)).is_empty());
    let expired = scheduler.expire(wakeup);
    assert_eq!(
        (expired[0].ticket, expired[0].job, expired[0].reason),
        (ticket, "waits", DropReason::Expired)
    );
}

#[test]
fn rungs_are_run_while_they_end_before_the_deadline() {
    let mut scheduler = primed(Config::default());
    admitted(scheduler.submit(ms(0), due(22), "a"));
    let dispatch = started(scheduler.next(ms(0), 0));
    assert_eq!(dispatch.plan.rungs, 3);
    scheduler.decoded(ms(1), 0);
    assert_eq!(scheduler.rung_done(ms(11), 0, true), Verdict::Continue);
    assert_eq!(scheduler.step_done(ms(12), 0), Verdict::Continue);
    let because = StopReason::Budget;
    assert_eq!(
        scheduler.rung_done(ms(16), 0, true),
        Verdict::Finish {
            has_mesh: true,
            because
        }
    );
    scheduler.meshed(ms(18), 0);
    let finished = scheduler.finished(ms(19), 0).unwrap();
    assert_eq!((finished.predicted, finished.actual), (ms(19), ms(19)));
}

#[test]
fn a_rung_is_not_started_if_others_were_promised_the_time() {
    let mut scheduler = primed(Config::default());
    admitted(scheduler.submit(ms(0), due(30), "a"));
    started(scheduler.next(ms(0), 0));
    admitted(scheduler.submit(ms(0), due(31), "b"));
    scheduler.decoded(ms(1), 0);
    let because = StopReason::Load;
    assert_eq!(
        scheduler.rung_done(ms(11), 0, true),
        Verdict::Finish {
            has_mesh: true,
            because
        }
    );
}

#[test]
fn a_better_map_has_a_dearer_ending_which_is_reckoned_with_before_the_rung() {
    let mut scheduler = primed(Config::default());
    scheduler.prime(FULL, Stage::Mesh(1), UNITS, ms(6));
    // Promised is base with its mesh: 14 ms. The next rung is 5 ms, and 4 ms of mesh more.
    admitted(scheduler.submit(ms(0), due(21), "a"));
    started(scheduler.next(ms(0), 0));
    scheduler.decoded(ms(1), 0);
    let because = StopReason::Budget;
    let stop = Verdict::Finish {
        has_mesh: true,
        because,
    };
    assert_eq!(scheduler.rung_done(ms(11), 0, true), stop);
    scheduler.meshed(ms(13), 0);
    assert_eq!(scheduler.expected(0), Some(ms(14)));
}

#[test]
fn the_time_that_replies_take_is_left_of_the_budget() {
    let mut scheduler = primed(Config::default());
    assert_eq!(scheduler.assess(ms(0), &due(15)), Ok(()));
    for _ in 0..64 {
        scheduler.replied(ms(0), &due(15), ms(2));
    }
    let refused = scheduler.submit(ms(0), due(15), "a").outcome.unwrap_err();
    let earliest = refused.refusal.earliest_feasible.unwrap();
    assert!(earliest >= ms(16) && earliest < ms(18), "{earliest:?}");
    admitted(scheduler.submit(ms(0), due(18), "b"));
    // A quarter of the budget is the most that is left.
    for _ in 0..64 {
        scheduler.replied(ms(0), &due(15), ms(500));
    }
    assert_eq!(scheduler.assess(ms(0), &due(100)), Ok(()));
}

#[test]
fn an_optional_mesh_is_left_out_when_it_would_be_late() {
    let mut scheduler = primed(Config::default());
    let spec = JobSpec {
        is_mesh_optional: true,
        ..due(15)
    };
    admitted(scheduler.submit(ms(0), spec, "a"));
    assert!(started(scheduler.next(ms(0), 0)).plan.has_mesh);
    scheduler.decoded(ms(1), 0);
    let because = StopReason::Budget;
    assert_eq!(
        scheduler.rung_done(ms(13), 0, true),
        Verdict::Finish {
            has_mesh: false,
            because
        }
    );
}

#[test]
fn a_frame_that_does_not_fit_is_halved_if_it_may_be() {
    let mut scheduler = primed(Config::default());
    let spec = JobSpec {
        half: Some(work(HALF)),
        ..due(8)
    };
    admitted(scheduler.submit(ms(0), spec, "a"));
    assert!(started(scheduler.next(ms(0), 0)).plan.is_half);
}

#[test]
fn a_newer_frame_replaces_the_one_that_waits_and_ends_the_one_that_runs() {
    let mut scheduler = primed(Config::default());
    let spec = |at| JobSpec {
        stream: Some(StreamId(9)),
        ..due(at)
    };
    admitted(scheduler.submit(ms(0), spec(100), "first"));
    started(scheduler.next(ms(0), 0));
    let second = admitted(scheduler.submit(ms(1), spec(101), "second"));
    let third = scheduler.submit(ms(2), spec(102), "third");
    assert!(third.outcome.is_ok());
    assert_eq!(
        (third.dropped[0].ticket, third.dropped[0].reason),
        (second, DropReason::Superseded)
    );
    scheduler.decoded(ms(3), 0);
    let because = StopReason::Superseded;
    assert_eq!(
        scheduler.rung_done(ms(13), 0, true),
        Verdict::Finish {
            has_mesh: true,
            because
        }
    );
}

#[test]
fn a_newer_frame_that_is_refused_leaves_the_older_one_its_place() {
    let mut scheduler = primed(Config::default());
    let spec = |at| JobSpec {
        stream: Some(StreamId(9)),
        ..due(at)
    };
    admitted(scheduler.submit(ms(0), spec(20), "older"));
    let refused = scheduler.submit(ms(0), spec(5), "newer");
    assert!(refused.outcome.is_err() && refused.dropped.is_empty());
    assert_eq!(started(scheduler.next(ms(0), 0)).job, "older");
}

#[test]
fn a_cancelled_job_leaves_the_queue_at_once_and_its_worker_after_the_step() {
    let mut scheduler = primed(Config::default());
    let running = admitted(scheduler.submit(ms(0), due(100), "runs"));
    started(scheduler.next(ms(0), 0));
    let waiting = admitted(scheduler.submit(ms(0), due(101), "waits"));
    assert!(matches!(
        scheduler.cancel(ms(1), waiting),
        Cancelled::Waiting("waits")
    ));
    assert!(matches!(scheduler.cancel(ms(1), waiting), Cancelled::Gone));
    assert!(matches!(scheduler.cancel(ms(1), running), Cancelled::Running));
    scheduler.decoded(ms(1), 0);
    assert_eq!(scheduler.rung_done(ms(11), 0, true), Verdict::Abandon);
    assert_eq!(scheduler.snapshot(ms(11)).busy_workers, 0);
}

#[test]
fn a_background_job_steps_aside_between_steps_and_comes_back() {
    let mut scheduler = primed(Config::default());
    let batch = admitted(scheduler.submit(ms(0), background(), "batch"));
    started(scheduler.next(ms(0), 0));
    scheduler.decoded(ms(1), 0);
    assert_eq!(scheduler.rung_done(ms(11), 0, true), Verdict::Continue);
    admitted(scheduler.submit(ms(11), due(60), "urgent"));
    assert_eq!(scheduler.step_done(ms(12), 0), Verdict::Yield);
    assert_eq!(started(scheduler.next(ms(12), 0)).job, "urgent");
    scheduler.decoded(ms(13), 0);
    scheduler.rung_done(ms(23), 0, false);
    scheduler.meshed(ms(25), 0);
    scheduler.finished(ms(26), 0);
    assert!(
        matches!(scheduler.next(ms(26), 0), Some(Next::Resume { ticket, verdict: Verdict::Continue }) if ticket == batch)
    );
    assert_eq!(scheduler.rung_done(ms(30), 0, true), Verdict::Continue);
    let because = StopReason::Complete;
    assert_eq!(
        scheduler.rung_done(ms(35), 0, true),
        Verdict::Finish {
            has_mesh: true,
            because
        }
    );
    scheduler.meshed(ms(37), 0);
    let finished = scheduler.finished(ms(38), 0).unwrap();
    assert_eq!(
        (finished.predicted, finished.actual),
        (ms(24), ms(24)),
        "the time aside doesn't count"
    );
}

#[test]
fn best_effort_gives_way_to_what_is_promised() {
    let mut scheduler = primed(Config {
        capacity: 1,
        ..Config::default()
    });
    let mut spec = due(100);
    spec.urgency = Urgency::Deadline {
        at: ms(100),
        priority: Priority::BestEffort,
    };
    let place = admitted(scheduler.submit(ms(0), spec, "best effort"));
    let promised = scheduler.submit(ms(0), due(100), "promised");
    assert!(promised.outcome.is_ok());
    assert_eq!(
        (promised.dropped[0].ticket, promised.dropped[0].reason),
        (place, DropReason::Displaced)
    );
    let refused = scheduler.submit(ms(0), due(100), "one more").outcome.unwrap_err();
    assert_eq!(refused.refusal.reason, Reason::QueueFull);
}

#[test]
fn an_idle_worker_is_not_denied_for_the_load_of_those_that_were_refused() {
    let mut scheduler = primed(Config::default());
    // One base in ten takes twice as long: 14 ms in all, rarely 24.
    for value in 0..64 {
        let took = if value % 10 == 9 { ms(20) } else { ms(10) };
        scheduler.prime(FULL, Stage::Rung(0), UNITS, took);
    }
    for time in (0..900).step_by(10) {
        let impossible = scheduler.submit(ms(time), due(time + 5), "impossible");
        assert!(impossible.outcome.is_err());
    }
    assert!(scheduler.snapshot(ms(900)).mandatory_load > 1.0);
    admitted(scheduler.submit(ms(900), due(918), "nobody else wants the worker"));
    let waiting = scheduler.submit(ms(900), due(933), "there may be no time for it");
    assert!(waiting.outcome.is_err());
}

#[test]
fn costs_that_look_too_high_are_measured_again_after_a_while() {
    let mut scheduler = primed(Config::default());
    assert!(scheduler.submit(ms(100), due(112), "a").outcome.is_err());
    admitted(scheduler.submit(ms(2000), due(2012), "probe"));
    assert_eq!(started(scheduler.next(ms(2000), 0)).job, "probe");
    scheduler.decoded(ms(2001), 0);
    scheduler.rung_done(ms(2004), 0, false);
    scheduler.meshed(ms(2005), 0);
    scheduler.finished(ms(2006), 0);
    admitted(scheduler.submit(ms(2006), due(2018), "now it fits"));
}

#[test]
fn rivals_keep_the_order_of_arrival_and_run_what_they_are_told() {
    for (policy, rungs) in [(Policy::Fifo, 3), (Policy::FifoTimeout, 3), (Policy::Fixed(2), 2)] {
        let mut scheduler = primed(Config {
            policy,
            ..Config::default()
        });
        admitted(scheduler.submit(ms(0), due(90), "first"));
        admitted(scheduler.submit(ms(0), due(20), "second"));
        let dispatch = started(scheduler.next(ms(0), 0));
        assert_eq!((dispatch.job, dispatch.plan.rungs), ("first", rungs));
        scheduler.decoded(ms(80), 0);
        assert_eq!(scheduler.rung_done(ms(89), 0, true), Verdict::Continue);
        let expired = scheduler.expire(ms(90)).len();
        assert_eq!(expired, usize::from(policy != Policy::Fifo));
    }
}

#[test]
fn nothing_grows_without_bound() {
    let config = Config {
        capacity: 8,
        background_capacity: 4,
        max_clients: 16,
        max_costs: 32,
        ..Config::default()
    };
    let mut scheduler: Scheduler<u32, u32> = Scheduler::new(config);
    let mut now = ms(0);
    for index in 0..20_000_u32 {
        now += Duration::from_micros(500);
        let kind = index % 5000;
        let urgency = match index % 3 {
            0 => Urgency::Background,
            _ => Urgency::Deadline {
                at: now + ms(u64::from(index % 50)),
                priority: Priority::Normal,
            },
        };
        let spec = JobSpec {
            client: ClientId(index.into()),
            stream: Some(StreamId(index.into())),
            urgency,
            work: work(kind),
            ..due(0)
        };
        drop(scheduler.submit(now, spec, index));
        if scheduler.next(now, 0).is_some() {
            scheduler.decoded(now, 0);
            scheduler.rung_done(now + ms(1), 0, false);
            scheduler.meshed(now + ms(1), 0);
            scheduler.finished(now + ms(1), 0);
        }
        let state = scheduler.snapshot(now + ms(1));
        assert!(
            state.waiting <= 8 && state.background_waiting <= 5 && state.active_clients <= 16,
            "{state:?}"
        );
        assert!(scheduler.costs().len() <= 32);
    }
}

#[test]
fn the_level_shows_the_overload_and_its_end() {
    let mut scheduler = primed(Config {
        capacity: 64,
        ..Config::default()
    });
    assert_eq!(scheduler.snapshot(ms(0)).level, Level::Full);
    for t in 1..1000 {
        drop(scheduler.submit(ms(t), due(t + 50), "flood"));
        scheduler.expire(ms(t));
    }
    assert_eq!(scheduler.snapshot(ms(1000)).level, Level::Refuse);
    let levels: Vec<Level> = (1000..3000).map(|t| scheduler.snapshot(ms(t)).level).collect();
    assert_eq!(levels.last(), Some(&Level::Full));
    assert!(levels.is_sorted_by(|a, b| a >= b));
}
