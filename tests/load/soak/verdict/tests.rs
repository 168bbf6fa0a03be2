use super::super::tally::Counts;
use super::*;

const MB: u64 = 1_000_000;

/// Half an hour of a server in which nothing changes but what every server's noise does.
fn steady() -> Vec<Sample> {
    (0..=360)
        .map(|look| Sample {
            seconds: 5.0 * look as f64,
            // The warm-up is no leak.
            resident_bytes: (look * 4).min(150) * MB + look * 7919 % 5 * MB,
            descriptors: 40 + look % 4,
            threads: 30,
            tasks: 25 + look * 13 % 7,
            in_flight_bytes: 0,
            counts: Counts {
                offered: 100 * look,
                in_budget: 100 * look - look / 10,
                ..Counts::default()
            },
            camera_frames: 150 * look,
            camera_answers: 150 * look,
        })
        .collect()
}

fn failures(change: impl Fn(u64, &mut Sample)) -> Vec<String> {
    let mut samples = steady();
    for (look, sample) in (0..).zip(&mut samples) {
        change(look, sample);
    }
    judge(&samples).expect("long enough").failures
}

#[test]
fn a_server_that_stays_as_it_is_passes() {
    assert_eq!(failures(|_, _| {}), [""; 0]);
}

#[test]
fn memory_that_grows_is_found_and_a_peak_is_none() {
    let leak = failures(|look, sample| sample.resident_bytes += look * 40_000);
    assert_eq!(leak.len(), 1, "{leak:?}");
    assert!(leak[0].starts_with("resident memory grew by 11."), "{leak:?}");
    let peak = failures(|look, sample| sample.resident_bytes += u64::from(look % 50 == 9) * 300 * MB);
    assert_eq!(peak, [""; 0]);
}

#[test]
fn descriptors_threads_and_tasks_that_grow_are_found() {
    for (name, leak) in [
        (
            "descriptors",
            (|look, sample| sample.descriptors += look / 30) as fn(u64, &mut Sample),
        ),
        ("threads", |look, sample| sample.threads += look / 60),
        ("tasks", |look, sample| sample.tasks += look / 20),
    ] {
        let found = failures(leak);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(found[0].starts_with(name), "{found:?}");
    }
}

#[test]
fn deadlines_that_are_missed_more_and_more_are_found() {
    let worse = failures(|look, sample| sample.camera_answers -= 3 * look.saturating_sub(240));
    assert!(worse.iter().any(|why| why.contains("fell from")), "{worse:?}");
    let bad = failures(|look, sample| sample.camera_answers -= 5 * look);
    assert!(bad.iter().any(|why| why.contains("wanted 99 %")), "{bad:?}");
}

#[test]
fn one_answer_that_is_none_fails_the_run() {
    let broken = failures(|look, sample| sample.counts.broken = u64::from(look > 100));
    assert_eq!(broken, ["1 answers were none, or did not come"]);
}

#[test]
fn what_the_load_leaves_behind_is_found() {
    let before = Sample {
        descriptors: 20,
        tasks: 5,
        ..Sample::default()
    };
    let gone = Sample {
        descriptors: 22,
        tasks: 8,
        ..before
    };
    assert_eq!(remains(&before, &gone), [""; 0]);
    let left = Sample {
        descriptors: 50,
        tasks: 50,
        in_flight_bytes: 9,
        ..before
    };
    assert_eq!(remains(&before, &left).len(), 3);
}

#[test]
fn the_warm_up_is_at_most_half_of_a_run() {
    let short = judge(&steady()[..=24]).expect("two minutes are enough");
    assert_eq!((short.warm_up, short.length), (60.0, 60.0));
    let long = judge(&steady()).expect("half an hour");
    assert_eq!((long.warm_up, long.length), (360.0, 1440.0));
}

#[test]
fn a_run_that_is_too_short_says_so() {
    let why = judge(&steady()[..10]).expect_err("45 s").to_string();
    assert!(why.contains("too short"), "{why}");
}
