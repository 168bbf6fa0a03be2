//! Prints what the policies do with the same arrivals, on virtual time, as a table for the README:
//! `cargo run --release -p stereo-scheduler --example simulate`
#![expect(clippy::print_stdout, reason = "it prints a table")]

#[path = "../tests/simulation/dice.rs"]
mod dice;
#[path = "../tests/simulation/traffic.rs"]
mod traffic;
#[expect(dead_code, reason = "shared with the tests, which need more of it")]
#[path = "../tests/simulation/world.rs"]
mod world;

use dice::Dice;
use stereo_scheduler::{Config, Policy};
use traffic::{Arrivals, Costs, MEASURED, VGA, requests};
use world::{Tally, World};

const SECONDS: f64 = 20.0;
const SEEDS: u64 = 5;
const LOADS: [f64; 5] = [0.5, 0.8, 1.0, 2.0, 4.0];
const POLICIES: [(&str, Policy); 5] = [
    ("edf", Policy::Edf),
    ("fifo", Policy::Fifo),
    ("fifo-timeout", Policy::FifoTimeout),
    ("fixed:1", Policy::Fixed(1)),
    ("fixed:3", Policy::Fixed(3)),
];

fn main() {
    println!("Virtual time; budgets 10, 20, 50, 100 ms.");
    println!(
        "Each cell: in budget of offered / mean rungs of {}. Admitted and missed: last column, worst of the row.",
        VGA.rungs()
    );
    for (name, costs, most_workers) in [("even", VGA, 2), ("measured", MEASURED, 1)] {
        println!(
            "\nCosts `{name}`: {:.1} ms mandatory, {:.1} ms in full; C = {:.0} frames/s a worker.\n",
            costs.mandatory(),
            1e3 / costs.capacity(),
            costs.capacity()
        );
        for workers in 1..=most_workers {
            println!("| {workers} worker(s) | policy | 0.5 C | 0.8 C | 1 C | 2 C | 4 C | missed |");
            println!("|---|---|---|---|---|---|---|---|");
            for (name, arrivals) in Arrivals::ALL {
                for (label, policy) in POLICIES {
                    row(costs, workers, (name, arrivals), (label, policy));
                }
            }
            println!();
        }
    }
}

fn row(costs: Costs, workers: u32, (name, arrivals): (&str, Arrivals), (label, policy): (&str, Policy)) {
    let mut line = format!("| {name} | {label} |");
    let mut worst: f64 = 0.0;
    for load in LOADS {
        let mut tally = Tally::default();
        for seed in 0..SEEDS {
            let mut dice = Dice::new(seed);
            let config = Config {
                policy,
                workers: workers as usize,
                ..Config::default()
            };
            let rate = load * costs.capacity() * f64::from(workers);
            let moments = arrivals.moments(&mut dice, rate, 0.0, SECONDS);
            let requests = requests(&mut dice, &costs, &moments, 0..8);
            let outcomes = World { config, costs }.run(&mut dice, &requests);
            tally.count(&requests, &outcomes, 0.0, SECONDS);
        }
        line += &format!(" {:.2} % / {:.2} |", 100.0 * tally.attained(), tally.mean_rungs());
        worst = worst.max(tally.missed());
    }
    println!("{line} {:.3} % |", 100.0 * worst);
}
