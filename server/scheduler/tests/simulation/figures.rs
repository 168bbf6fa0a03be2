//! The figures of the service's promise, on virtual time: budgets of 10, 20, 50, 100 ms, VGA pairs, loads in terms of the capacity
//! C at full quality.

use stereo_scheduler::{Config, Policy};

use std::time::Duration;

use super::bound::most_in_budget;
use super::dice::Dice;
use super::traffic::{Arrivals, Costs, MEASURED, VGA, requests};
use super::world::{Outcome, Tally, World};

const SEEDS: u64 = 4;
const SECONDS: f64 = 15.0;

fn run(policy: Policy, workers: u32, arrivals: Arrivals, load: f64) -> Tally {
    let mut tally = Tally::default();
    for seed in 0..SEEDS {
        let mut dice = Dice::new(seed);
        let config = Config {
            policy,
            workers: workers as usize,
            ..Config::default()
        };
        let moments = arrivals.moments(
            &mut dice,
            load * VGA.capacity() * f64::from(workers),
            0.0,
            SECONDS,
        );
        let requests = requests(&mut dice, &VGA, &moments, 0..8);
        let outcomes = World { config, costs: VGA }.run(&mut dice, &requests);
        tally.count(&requests, &outcomes, 0.0, SECONDS);
    }
    tally
}

fn show(what: &str, load: f64, tally: &Tally) {
    println!(
        "{what:28} {load:3} C: in budget {:7.3} %, refused {:6.3} %, missed of admitted {:.4} %, rungs {:.3}, goodput {:.1}/s",
        100.0 * tally.attained(),
        100.0 * tally.refused(),
        100.0 * tally.missed(),
        tally.mean_rungs(),
        tally.goodput()
    );
}

const STEADY: [(&str, Arrivals); 2] = [("Poisson", Arrivals::Poisson), ("30 Hz fleet", Arrivals::Fleet)];

#[test]
fn below_capacity_everything_is_in_budget_and_nearly_all_rungs_are_run() {
    let most = f64::from(VGA.rungs());
    for (name, arrivals) in STEADY {
        for workers in [1, 2] {
            let tally = run(Policy::Edf, workers, arrivals, 0.8);
            show(&format!("{name}, {workers} worker(s)"), 0.8, &tally);
            assert!(
                tally.attained() >= 0.999,
                "{name}, {workers}: {}",
                tally.attained()
            );
            assert!(
                tally.mean_rungs() >= 0.95 * most,
                "{name}, {workers}: {}",
                tally.mean_rungs()
            );
        }
    }
}

#[test]
fn at_capacity_rungs_are_cut_and_nobody_is_refused() {
    for (name, arrivals) in STEADY {
        for workers in [1, 2] {
            let tally = run(Policy::Edf, workers, arrivals, 1.0);
            show(&format!("{name}, {workers} worker(s)"), 1.0, &tally);
            assert!(
                tally.attained() >= 0.995,
                "{name}, {workers}: {}",
                tally.attained()
            );
            assert!(tally.refused() <= 0.001, "{name}, {workers}: {}", tally.refused());
        }
    }
}

#[test]
fn far_above_capacity_goodput_stays_at_its_peak() {
    for (name, arrivals) in STEADY {
        for workers in [1, 2] {
            let tallies: Vec<(f64, Tally)> = [1.0, 2.0, 3.0, 4.0]
                .map(|load| (load, run(Policy::Edf, workers, arrivals, load)))
                .into();
            let peak = tallies
                .iter()
                .map(|(_, tally)| tally.goodput())
                .fold(0.0, f64::max);
            for (load, tally) in &tallies {
                show(&format!("{name}, {workers} worker(s)"), *load, tally);
                // No more than what is offered can be good.
                let possible = peak.min(tally.offered / tally.seconds);
                assert!(
                    tally.goodput() >= 0.95 * possible,
                    "{name}, {workers} at {load} C"
                );
                assert!(
                    tally.missed() <= 0.001,
                    "{name}, {workers} at {load} C: {}",
                    tally.missed()
                );
            }
        }
    }
}

#[test]
fn after_a_burst_of_five_times_the_capacity_it_is_back_within_half_a_second() {
    for workers in [1_u32, 2] {
        let mut after = Tally::default();
        for seed in 0..30 {
            let mut dice = Dice::new(seed);
            let capacity = VGA.capacity() * f64::from(workers);
            let mut moments = Arrivals::Poisson.moments(&mut dice, 0.8 * capacity, 0.0, 1.0);
            moments.extend(Arrivals::Poisson.moments(&mut dice, 5.0 * capacity, 1.0, 6.0));
            moments.extend(Arrivals::Poisson.moments(&mut dice, 0.8 * capacity, 6.0, 7.5));
            let requests = requests(&mut dice, &VGA, &moments, 0..8);
            let config = Config {
                workers: workers as usize,
                ..Config::default()
            };
            let outcomes = World { config, costs: VGA }.run(&mut dice, &requests);
            after.count(&requests, &outcomes, 6.5, 7.5);
        }
        show(&format!("0.5 s after a burst, {workers}"), 0.8, &after);
        assert!(after.attained() >= 0.99);
    }
}

/// `cargo test --release -p stereo-scheduler --test simulation -- --nocapture rivals` prints the table.
#[test]
fn rivals_collapse_where_this_does_not() {
    for load in [0.8, 1.0, 2.0, 4.0] {
        let ours = run(Policy::Edf, 1, Arrivals::Poisson, load);
        show("edf", load, &ours);
        for (name, rival) in [
            ("fifo", Policy::Fifo),
            ("fifo-timeout", Policy::FifoTimeout),
            ("fixed:1", Policy::Fixed(1)),
            ("fixed:3", Policy::Fixed(3)),
        ] {
            let tally = run(rival, 1, Arrivals::Poisson, load);
            show(name, load, &tally);
            let limit = match rival {
                Policy::Fifo if load >= 2.0 => 0.02,
                Policy::FifoTimeout | Policy::Fixed(3) if load >= 1.0 => 0.8,
                _ => 1.0,
            };
            assert!(
                tally.attained() <= limit * ours.attained(),
                "{name} at {load} C: {}",
                tally.attained()
            );
        }
    }
}

/// Costs as the server was seen to have, on a machine whose pace changes: what is asked of a real server.
#[test]
fn on_an_uneven_machine_frames_are_in_time_and_predictions_close() {
    for (load, wanted) in [(0.8, 0.99), (1.0, 0.97)] {
        let mut tally = Tally::default();
        let mut errors = Vec::new();
        for seed in 0..SEEDS {
            let mut dice = Dice::new(seed);
            let config = Config::default();
            let moments = Arrivals::Poisson.moments(&mut dice, load * MEASURED.capacity(), 0.0, SECONDS);
            let requests = requests(&mut dice, &MEASURED, &moments, 0..8);
            let costs = MEASURED;
            let outcomes = World { config, costs }.run(&mut dice, &requests);
            tally.count(&requests, &outcomes, 0.0, SECONDS);
            errors.extend(outcomes.iter().skip(50).filter_map(|outcome| match outcome {
                Outcome::Served {
                    predicted, actual, ..
                } => Some((predicted.as_secs_f64() / actual.as_secs_f64() - 1.0).abs()),
                _ => None,
            }));
        }
        show("uneven", load, &tally);
        assert!(tally.attained() >= wanted, "{load} C: {}", tally.attained());
        errors.sort_by(f64::total_cmp);
        let p95 = errors[errors.len() * 95 / 100];
        println!("prediction error p95 {:.1} %", 100.0 * p95);
        assert!(p95 <= 0.2, "{load} C: {p95}");
    }
}

/// Cameras whose frames all have the same budget, nearly as many as the worker can serve in full. A frame that comes is begun before
/// the others are refined any further; where only one may lie aside, it waits for those that came before it.
#[test]
fn frames_of_cameras_are_begun_soon_whatever_their_budget_and_lose_no_rungs_by_it() {
    for budget_ms in [20, 33, 100] {
        let [(others, longer), (ours, wait)] = [1, Config::default().max_aside].map(|max_aside| {
            let config = Config {
                max_aside,
                ..Config::default()
            };
            let (tally, mut waits) = cameras(config, Duration::from_millis(budget_ms));
            waits.sort_unstable();
            let p99 = waits[waits.len() * 99 / 100];
            show(
                &format!("cameras, {budget_ms} ms, {max_aside} aside"),
                0.9,
                &tally,
            );
            println!(
                "until a worker has it: p50 {:?}, p99 {p99:?}",
                waits[waits.len() / 2]
            );
            (tally, p99)
        });
        assert!(ours.attained() >= 0.995, "{budget_ms} ms: {}", ours.attained());
        assert!(
            ours.mean_rungs() >= 0.99 * others.mean_rungs(),
            "{budget_ms} ms: {} of {}",
            ours.mean_rungs(),
            others.mean_rungs()
        );
        assert!(
            wait <= longer.mul_f64(0.75) && wait <= Duration::from_millis(14),
            "{budget_ms} ms: {wait:?}, not {longer:?}"
        );
    }
}

/// What becomes of the frames, and how long each waits for a worker.
fn cameras(config: Config, budget: Duration) -> (Tally, Vec<Duration>) {
    let (mut tally, mut waits) = (Tally::default(), Vec::new());
    for seed in 0..SEEDS {
        let mut dice = Dice::new(seed);
        let moments = Arrivals::Fleet.moments(&mut dice, 0.9 * MEASURED.capacity(), 0.0, SECONDS);
        let mut requests = requests(&mut dice, &MEASURED, &moments, 0..8);
        for request in &mut requests {
            request.deadline = Some(request.at + budget);
        }
        let costs = MEASURED;
        let outcomes = World { config, costs }.run(&mut dice, &requests);
        tally.count(&requests, &outcomes, 0.0, SECONDS);
        let begun = requests.iter().zip(&outcomes);
        waits.extend(begun.filter_map(|(request, outcome)| match outcome {
            Outcome::Served { begun, .. } => Some(*begun - request.at),
            _ => None,
        }));
    }
    (tally, waits)
}

/// Where frames come in bursts, some can't be in time whatever is done.
#[test]
fn of_bursts_nearly_as_much_is_in_budget_as_anyone_could_get_there() {
    // All frames alike, so that the bound holds exactly.
    let costs = Costs {
        spread: 0.0,
        hiccups: 0.0,
        ..VGA
    };
    let mandatory = Duration::from_secs_f64(costs.mandatory() / 1e3);
    for (name, arrivals) in Arrivals::ALL {
        for load in [0.8, 1.0, 2.0, 4.0] {
            let (mut tally, mut possible) = (Tally::default(), 0.0);
            for seed in 0..SEEDS {
                let mut dice = Dice::new(seed);
                let config = Config::default();
                let moments = arrivals.moments(&mut dice, load * costs.capacity(), 0.0, SECONDS);
                let requests = requests(&mut dice, &costs, &moments, 0..8);
                let outcomes = World { config, costs }.run(&mut dice, &requests);
                tally.count(&requests, &outcomes, 0.0, SECONDS);
                possible += most_in_budget(&requests, mandatory) * requests.len() as f64;
            }
            let possible = possible / tally.offered;
            show(name, load, &tally);
            println!("{:28} {load:3} C: at most {:7.3} %", "", 100.0 * possible);
            assert!(
                tally.attained() <= possible + 1e-9,
                "{name} at {load} C: no bound"
            );
            assert!(
                tally.attained() >= 0.95 * possible,
                "{name} at {load} C: {} of {possible}",
                tally.attained()
            );
        }
    }
}
