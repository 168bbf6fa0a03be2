//! What clients and classes do to each other.

use std::time::Duration;

use stereo_scheduler::{Config, DropReason, Priority};

use super::dice::Dice;
use super::traffic::{Arrivals, Request, VGA, requests};
use super::world::{Outcome, Tally, World};

const CLIENTS: u64 = 8;
const SECONDS: f64 = 10.0;
const SEEDS: u64 = 5;

/// Per client, of runs in which the first client asks for `flood` times what each of the others asks for; all of them together
/// would ask for `load` without the flood.
fn clients(workers: u32, load: f64, flood: f64) -> Vec<Tally> {
    let mut tallies = vec![Tally::default(); usize::try_from(CLIENTS).unwrap()];
    for seed in 0..SEEDS {
        let mut dice = Dice::new(seed);
        let each = load * VGA.capacity() * f64::from(workers) / 8.0;
        let mut all: Vec<Request> = Vec::new();
        for client in 0..CLIENTS {
            let rate = if client == 0 { flood * each } else { each };
            let moments = Arrivals::Poisson.moments(&mut dice, rate, 0.0, SECONDS);
            all.extend(requests(&mut dice, &VGA, &moments, client..client + 1));
        }
        all.sort_by_key(|request| request.at);
        let config = Config {
            workers: workers as usize,
            ..Config::default()
        };
        let outcomes = World { config, costs: VGA }.run(&mut dice, &all);
        for (request, outcome) in all.iter().zip(outcomes) {
            tallies[usize::try_from(request.client).unwrap()].add(request, outcome);
        }
    }
    tallies
}

/// Shares of `total` under which nobody could have more without taking it from somebody who has less.
fn max_min(demands: &[f64], total: f64) -> Vec<f64> {
    let mut shares = vec![0.0; demands.len()];
    let mut left = total;
    loop {
        let hungry: Vec<usize> = (0..demands.len())
            .filter(|&i| shares[i] < demands[i] - 1e-9)
            .collect();
        if hungry.is_empty() || left < 1e-9 {
            return shares;
        }
        let each = left / f64::from(u32::try_from(hungry.len()).unwrap());
        for i in hungry {
            let more = each.min(demands[i] - shares[i]);
            shares[i] += more;
            left -= more;
        }
    }
}

/// Jain's index of what each got beside its fair share.
fn jain(tallies: &[Tally]) -> f64 {
    let demands: Vec<f64> = tallies.iter().map(|tally| tally.offered).collect();
    let got: Vec<f64> = tallies.iter().map(|tally| tally.in_budget).collect();
    let fair = max_min(&demands, got.iter().sum());
    let ratios: Vec<f64> = got.iter().zip(fair).map(|(got, fair)| got / fair).collect();
    let sum: f64 = ratios.iter().sum();
    let squares: f64 = ratios.iter().map(|ratio| ratio * ratio).sum();
    sum * sum / (squares * f64::from(u32::try_from(ratios.len()).unwrap()))
}

fn others(tallies: &[Tally]) -> f64 {
    let sum = |of: fn(&Tally) -> f64| tallies[1..].iter().map(of).sum::<f64>();
    sum(|tally| tally.in_budget) / sum(|tally| tally.offered)
}

#[test]
fn a_client_at_ten_times_its_share_costs_the_others_nothing_to_speak_of() {
    for workers in [1, 2] {
        for load in [0.8, 1.6, 2.0] {
            let (calm, flooded) = (clients(workers, load, 1.0), clients(workers, load, 10.0));
            let lost = others(&calm) - others(&flooded);
            let fairness = jain(&flooded);
            println!(
                "{workers} worker(s), {load} C + flood: others {:.3} % -> {:.3} %, flood {:.1} %, Jain {fairness:.4}",
                100.0 * others(&calm),
                100.0 * others(&flooded),
                100.0 * flooded[0].attained()
            );
            assert!(lost <= 0.01, "the others lose {lost}");
            assert!(fairness >= 0.98, "{fairness}");
        }
    }
}

#[test]
fn a_batch_that_never_ends_costs_the_deadline_class_nothing_to_speak_of() {
    for workers in [1_u32, 2] {
        for load in [0.3, 0.8, 1.0, 2.0] {
            let mut attained = Vec::new();
            let mut batch = 0;
            for has_batch in [false, true] {
                let mut tally = Tally::default();
                for seed in 0..SEEDS {
                    let mut dice = Dice::new(seed);
                    let capacity = VGA.capacity() * f64::from(workers);
                    let moments = Arrivals::Poisson.moments(&mut dice, load * capacity, 0.0, SECONDS);
                    let mut all = requests(&mut dice, &VGA, &moments, 0..8);
                    let mut extra = Dice::new(seed + 1000);
                    if has_batch {
                        let moments = Arrivals::Poisson.moments(&mut extra, 1.5 * capacity, 0.0, SECONDS);
                        let frames = requests(&mut extra, &VGA, &moments, 100..101);
                        all.extend(frames.into_iter().map(|request| Request {
                            deadline: None,
                            ..request
                        }));
                        all.sort_by_key(|request| request.at);
                    }
                    let config = Config {
                        workers: workers as usize,
                        ..Config::default()
                    };
                    let outcomes = World { config, costs: VGA }.run(&mut dice, &all);
                    for (request, outcome) in all.iter().zip(outcomes) {
                        if request.deadline.is_some() {
                            tally.add(request, outcome);
                        } else if let Outcome::Served { rungs, .. } = outcome {
                            assert_eq!(rungs, VGA.rungs(), "a batch frame is done in full");
                            batch += 1;
                        }
                    }
                }
                attained.push(tally.attained());
                println!(
                    "{workers} worker(s), {load} C, batch {has_batch}: {:.3} % in budget, rungs {:.3}, {batch} of the batch done",
                    100.0 * tally.attained(),
                    tally.mean_rungs()
                );
            }
            assert!(attained[0] - attained[1] <= 0.002, "{attained:?}");
            assert!(batch > 0 || load > 1.5, "the batch gets on while there is time");
        }
    }
}

#[test]
fn overload_is_borne_by_best_effort_first_and_by_the_high_class_last() {
    let mut by_class = [Tally::default(); 3];
    for seed in 0..SEEDS {
        let mut dice = Dice::new(seed);
        let moments = Arrivals::Poisson.moments(&mut dice, 4.0 * VGA.capacity(), 0.0, SECONDS);
        let mut all = requests(&mut dice, &VGA, &moments, 0..8);
        for request in &mut all {
            request.priority = [
                Priority::BestEffort,
                Priority::Normal,
                Priority::Normal,
                Priority::High,
            ][dice.below(4)];
        }
        let outcomes = World {
            config: Config::default(),
            costs: VGA,
        }
        .run(&mut dice, &all);
        for (request, outcome) in all.iter().zip(outcomes) {
            by_class[request.priority as usize].add(request, outcome);
        }
    }
    let [best_effort, normal, high] = by_class.map(|tally| tally.attained());
    println!("best effort {best_effort:.3}, normal {normal:.3}, high {high:.3}");
    assert!(best_effort < 0.1 && best_effort < normal && normal < high && high > 0.95);
}

#[test]
fn frames_that_may_be_halved_are_halved_instead_of_refused() {
    let attained = |may_halve| {
        let mut dice = Dice::new(3);
        let moments = Arrivals::Poisson.moments(&mut dice, 4.0 * VGA.capacity(), 0.0, SECONDS);
        let mut all = requests(&mut dice, &VGA, &moments, 0..8);
        all.iter_mut().for_each(|request| request.may_halve = may_halve);
        let outcomes = World {
            config: Config::default(),
            costs: VGA,
        }
        .run(&mut dice, &all);
        let mut tally = Tally::default();
        tally.count(&all, &outcomes, 0.0, SECONDS);
        tally.attained()
    };
    let (full, halved) = (attained(false), attained(true));
    println!("4 C: {full:.3} at full resolution, {halved:.3} if half is allowed");
    assert!(full < 0.7 && halved > 0.99);
}

#[test]
fn of_a_stream_only_the_newest_frame_waits() {
    let mut dice = Dice::new(4);
    let moments = Arrivals::Fleet.moments(&mut dice, 4.0 * VGA.capacity(), 0.0, SECONDS);
    let mut all = requests(&mut dice, &VGA, &moments, 0..8);
    for request in &mut all {
        request.stream = Some(request.client);
        request.deadline = Some(request.at + Duration::from_millis(200));
    }
    let outcomes = World {
        config: Config {
            capacity: 8,
            ..Config::default()
        },
        costs: VGA,
    }
    .run(&mut dice, &all);
    let refused = outcomes
        .iter()
        .filter(|outcome| matches!(outcome, Outcome::Refused(_)))
        .count();
    let served = outcomes
        .iter()
        .filter(|outcome| matches!(outcome, Outcome::Served { .. }))
        .count();
    println!("{served} served, {refused} refused of {}", outcomes.len());
    assert_eq!(refused, 0, "eight streams never need more than eight places");
    let superseded = outcomes
        .iter()
        .filter(|outcome| **outcome == Outcome::Dropped(DropReason::Superseded))
        .count();
    assert_eq!(
        served + superseded,
        outcomes.len(),
        "a frame is answered or replaced by a newer one"
    );
}
