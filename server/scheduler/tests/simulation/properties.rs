//! What holds whatever comes. [`World`] looks at every moment; here is what it is made to live through.
//!
//! - never starts what can't finish, by its own estimate; - an idle worker means that nobody waits; - the queue is bounded;
//! - every request is answered exactly once, and no admitted one later than its deadline plus one uninterruptible piece of work;
//! - refused as infeasible means that the earliest feasible deadline is later than the one asked for.

use std::time::Duration;

use stereo_scheduler::{Config, Priority};

use super::dice::Dice;
use super::traffic::{Arrivals, Costs, Request, VGA, requests};
use super::world::{Outcome, Tally, World};

/// Seeds of the mixed runs.
const SEEDS: u64 = 2500;

/// Any arrivals, load, number of workers, queue, and all kinds of jobs.
fn anything(seed: u64) -> (World, Dice, Vec<Request>) {
    let mut dice = Dice::new(seed);
    let workers = 1 + dice.below(3);
    let capacity = [4, 16, 64, 1024][dice.below(4)];
    let config = Config {
        workers,
        capacity,
        background_capacity: 8,
        max_clients: 16,
        ..Config::default()
    };
    let (_, arrivals) = Arrivals::ALL[dice.below(Arrivals::ALL.len())];
    let load = 0.5 + 3.5 * dice.uniform();
    let costs = Costs {
        spread: 0.15 * dice.uniform(),
        hiccups: 0.003 * dice.uniform(),
        ..VGA
    };
    let moments = arrivals.moments(
        &mut dice,
        load * costs.capacity() * f64::from(u32::try_from(workers).unwrap()),
        0.0,
        0.7,
    );
    let mut mixed = requests(&mut dice, &costs, &moments, 0..32);
    for request in &mut mixed {
        request.priority = [
            Priority::BestEffort,
            Priority::Normal,
            Priority::Normal,
            Priority::High,
        ][dice.below(4)];
        request.may_halve = dice.uniform() < 0.3;
        request.stream = (dice.uniform() < 0.3).then_some(request.client);
        if dice.uniform() < 0.05 {
            request.deadline = None;
        }
    }
    (World { config, costs }, dice, mixed)
}

#[test]
fn the_properties_hold_for_thousands_of_seeds() {
    let mut tally = Tally::default();
    for seed in 0..SEEDS {
        let (world, mut dice, requests) = anything(seed);
        let outcomes = world.run(&mut dice, &requests);
        for (request, outcome) in requests.iter().zip(&outcomes) {
            let (Some(due), Outcome::Served { at, .. }) = (request.deadline, outcome) else {
                continue;
            };
            // It started in time by its own estimate, so it is late by what its stages took beyond that.
            assert!(
                *at < due + Duration::from_millis(60),
                "seed {seed}: due {due:?}, answered {at:?}"
            );
        }
        tally.count(&requests, &outcomes, 0.0, 1.0);
    }
    println!(
        "{} requests, {:.4} % of the admitted missed",
        tally.offered,
        100.0 * tally.missed()
    );
    assert!(
        tally.missed() <= 0.002,
        "{} of the admitted missed under wild costs",
        tally.missed()
    );
}

#[test]
fn equal_seeds_give_equal_runs() {
    let run = || {
        let (world, mut dice, requests) = anything(7);
        world.run(&mut dice, &requests)
    };
    assert_eq!(run(), run());
}

#[test]
fn admitted_means_kept_for_all_arrivals_and_loads() {
    for (name, arrivals) in Arrivals::ALL {
        for load in [0.5, 0.8, 1.0, 1.5, 2.0, 3.0, 4.0] {
            let mut tally = Tally::default();
            for seed in 0..40 {
                let mut dice = Dice::new(seed);
                let config = Config {
                    workers: 2,
                    ..Config::default()
                };
                let moments = arrivals.moments(&mut dice, load * 2.0 * VGA.capacity(), 0.0, 2.0);
                let requests = requests(&mut dice, &VGA, &moments, 0..8);
                let outcomes = World { config, costs: VGA }.run(&mut dice, &requests);
                tally.count(&requests, &outcomes, 0.0, 2.0);
            }
            let missed = tally.missed();
            println!(
                "{name:12} {load:3} C: {:.4} % of {} admitted missed",
                100.0 * missed,
                tally.admitted
            );
            assert!(missed <= 0.001, "{name} at {load} C: {missed}");
        }
    }
}

#[test]
fn nobody_starves_for_however_long_the_overload_lasts() {
    let mut dice = Dice::new(11);
    let config = Config::default();
    let moments = Arrivals::Poisson.moments(&mut dice, 4.0 * VGA.capacity(), 0.0, 30.0);
    let requests = requests(&mut dice, &VGA, &moments, 0..8);
    let outcomes = World { config, costs: VGA }.run(&mut dice, &requests);
    for client in 0..8 {
        // Of any second, every client gets something.
        for second in 0..30 {
            let served = requests.iter().zip(&outcomes).filter(|(request, outcome)| {
                request.client == client
                    && request.at.as_secs() == second
                    && matches!(outcome, Outcome::Served { .. })
            });
            assert!(served.count() > 0, "client {client} in second {second}");
        }
    }
}

#[test]
fn the_prediction_is_close_after_fifty_frames() {
    let mut dice = Dice::new(5);
    let moments = Arrivals::Poisson.moments(&mut dice, 0.8 * VGA.capacity(), 0.0, 60.0);
    let requests = requests(&mut dice, &VGA, &moments, 0..8);
    let outcomes = World {
        config: Config::default(),
        costs: VGA,
    }
    .run(&mut dice, &requests);
    let mut errors: Vec<f64> = outcomes
        .iter()
        .filter_map(|outcome| match outcome {
            Outcome::Served {
                predicted, actual, ..
            } => Some((predicted.as_secs_f64() / actual.as_secs_f64() - 1.0).abs()),
            _ => None,
        })
        .skip(50)
        .collect();
    errors.sort_by(f64::total_cmp);
    let p95 = errors[errors.len() * 95 / 100];
    println!("prediction error p95 {:.1} %", 100.0 * p95);
    assert!(p95 <= 0.1, "{p95}");
}
