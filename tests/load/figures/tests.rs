use std::time::Duration;

use stereo_client::v1::Reason;

use super::{Figures, quantile, recovery};
use crate::generator::Run;
use crate::plan::Shot;
use crate::record::{Digest, Outcome, Record};

const MS: Duration = Duration::from_millis(1);

fn record(at_ms: u32, camera: u16, latency_ms: u32, outcome: Outcome) -> Record {
    Record {
        shot: Shot {
            at: at_ms * MS,
            camera,
            budget: 50 * MS,
        },
        lag: MS,
        latency: latency_ms * MS,
        decided: 2 * MS,
        outcome,
    }
}

fn answer() -> Outcome {
    Outcome::Answered(Box::new(Digest {
        rungs_run: 1,
        rungs_asked: 4,
        predicted: 12 * MS,
        actual: 10 * MS,
        deadline_met: true,
        total: 23 * MS,
        stages: [1, 2, 3, 4, 5, 6].map(|ms| ms * MS),
    }))
}

fn refusal(reason: Reason) -> Outcome {
    Outcome::Refused {
        reason,
        says_when: false,
    }
}

#[test]
fn every_frame_is_counted_once_and_late_ones_are_not_in_budget() {
    let run = Run {
        records: vec![
            record(0, 0, 30, answer()),
            record(1, 0, 51, answer()),
            record(2, 1, 60, refusal(Reason::Expired)),
            record(3, 1, 2, refusal(Reason::DeadlineInfeasible)),
            record(4, 1, 9, Outcome::Broken("gone".to_owned())),
            record(5, 1, 0, Outcome::NotSent),
        ],
        length: Duration::from_secs(2),
    };
    let figures = Figures::of(&run);
    assert_eq!((figures.offered, figures.in_budget, figures.answered), (6, 1, 2));
    // One of them was in budget but for the millisecond by which it was sent late.
    assert_eq!(figures.in_budget_from_sending, 2);
    assert_eq!(figures.in_budget_by_the_server, 2);
    // Two answers and one that expired were taken on.
    assert_eq!((figures.admitted, figures.missed_by_the_server), (3, 1));
    assert_eq!((figures.not_sent, figures.mute), (1, 1));
    // A promise that was broken is no refusal.
    assert_eq!(
        (figures.expired, figures.refused.get("DEADLINE_INFEASIBLE")),
        (1, Some(&1))
    );
    assert_eq!(figures.refusing.len(), 1);
    assert_eq!(figures.goodput_hz, 0.5);
    assert_eq!(figures.rungs, 0.25);
    assert_eq!(figures.by_camera[&1].in_budget, 0);
    assert_eq!(figures.by_camera[&0].mean_rungs(), 0.25);
    assert_eq!(
        figures.prediction_error, None,
        "the first answers are for learning"
    );
    let total: u64 = figures.answered
        + figures.expired
        + figures.refused.values().sum::<u64>()
        + figures.broken.values().sum::<u64>()
        + figures.not_sent;
    assert_eq!(total, figures.offered);
    // 30 ms of which 1 is lag and 23 the server's, 21 of them in stages: 6 on the way.
    let (name, transfer) = figures.stages.last().expect("stages");
    assert_eq!(*name, "transfer");
    assert_eq!(quantile(transfer, 0.5).as_millis(), 6);
    let (name, aside) = &figures.stages[figures.stages.len() - 2];
    assert_eq!((*name, quantile(aside, 0.5).as_millis()), ("aside", 2));
}

#[test]
fn the_prediction_error_is_that_of_the_answers_after_the_first() {
    let run = Run {
        records: (0..100).map(|i| record(i, 0, 20, answer())).collect(),
        length: Duration::from_secs(1),
    };
    let error = Figures::of(&run).prediction_error.expect("enough answers");
    assert!((error - 0.2).abs() < 1e-9, "{error}");
}

#[test]
fn recovery_is_when_a_good_second_begins() {
    let run = |bad_until: u32| -> Vec<Record> {
        (0..400)
            .map(|i| record(i * 10, 0, if i * 10 < bad_until { 99 } else { 20 }, answer()))
            .collect()
    };
    let at = |bad_until| recovery(&run(bad_until), 1000 * MS);
    assert_eq!(at(0), Some(Duration::ZERO));
    // One late frame in a second of a hundred is what 99 % allow.
    assert_eq!(at(1500), Some(490 * MS));
    assert_eq!(at(3900), None);
    assert_eq!(recovery(&[], Duration::ZERO), None);
}

#[test]
fn a_flood_is_fair_when_the_others_get_all_they_ask_for() {
    let flood = |others: u32| Run {
        records: (0..100)
            .map(|i| record(i, 0, if i < 30 { 20 } else { 99 }, answer()))
            .chain((0..20).map(|i| {
                record(
                    i,
                    u16::try_from(i % 2).expect("small") + 1,
                    if i < others { 20 } else { 99 },
                    answer(),
                )
            }))
            .collect(),
        length: Duration::from_secs(1),
    };
    let fair = Figures::of(&flood(20));
    assert!((fair.fairness() - 1.0).abs() < 1e-9);
    assert_eq!(fair.others(), 1.0);
    assert!(Figures::of(&flood(2)).fairness() < 0.7);
}
