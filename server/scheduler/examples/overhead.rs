//! Prints what a decision costs with 10,000 jobs in the queue:
//! `cargo run --release -p stereo-scheduler --example overhead`
#![expect(clippy::print_stdout, reason = "it prints a measurement")]
#![expect(
    clippy::disallowed_methods,
    reason = "it measures the policy, it isn't part of it"
)]

use std::time::{Duration, Instant};

use stereo_scheduler::{ClientId, Config, JobSpec, Next, Priority, Scheduler, Stage, Urgency, Work};

const QUEUED: u32 = 10_000;
const ROUNDS: u32 = 100_000;

fn main() {
    let config = Config {
        capacity: 2 * QUEUED as usize,
        ..Config::default()
    };
    let mut scheduler = Scheduler::new(config);
    for stage in [
        Stage::Decode,
        Stage::Rung(0),
        Stage::Rung(1),
        Stage::Rung(2),
        Stage::Encode(0),
    ] {
        scheduler.prime(0, stage, 307_200, Duration::from_micros(1));
    }
    // Minutes ahead, so that everybody fits; in no order.
    let spec = |now: Duration, index: u32| JobSpec {
        client: ClientId(u64::from(index % 500)),
        weight: 1,
        stream: None,
        urgency: Urgency::Deadline {
            at: now
                + Duration::from_secs(60)
                + Duration::from_micros(u64::from(index.wrapping_mul(2_654_435_761)) / 100),
            priority: Priority::Normal,
        },
        work: Work {
            units: 307_200,
            decode: 0,
            matching: 0,
            mesh: None,
            encode: 0,
            rungs: 3,
        },
        half: None,
        is_mesh_optional: false,
    };
    let mut now = Duration::ZERO;
    let mut refused = 0;
    for index in 0..QUEUED {
        now += Duration::from_micros(10);
        refused += u32::from(scheduler.submit(now, spec(now, index), index).outcome.is_err());
    }
    let mut times = Vec::with_capacity(ROUNDS as usize);
    for index in 0..ROUNDS {
        now += Duration::from_micros(10);
        let started = Instant::now();
        refused += u32::from(scheduler.submit(now, spec(now, index), index).outcome.is_err());
        if let Some(Next::Start(_)) = scheduler.next(now, 0) {
            scheduler.decoded(now, 0);
            for _ in 0..4 {
                scheduler.step_done(now, 0);
            }
            scheduler.rung_done(now, 0, true);
            scheduler.rung_done(now, 0, true);
            scheduler.rung_done(now, 0, false);
            scheduler.finished(now, 0);
        }
        times.push(started.elapsed());
    }
    times.sort_unstable();
    let mean = times.iter().sum::<Duration>() / ROUNDS;
    println!(
        "{} jobs queued, {refused} refused; all decisions of a request: mean {mean:?}, p50 {:?}, p99 {:?}",
        scheduler.snapshot(now).waiting,
        times[times.len() / 2],
        times[times.len() * 99 / 100]
    );
}
