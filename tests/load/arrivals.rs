//! When frames are due, in units of the mean interval between two of them: a process of rate 1 that a
//! [`Profile`](crate::plan::Profile) stretches to any rate.

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Exp1, Gamma, weighted::WeightedIndex};

/// An arrival process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Process {
    /// Every camera at its own fixed period, with a phase drawn once.
    Fleet,
    /// Independent arrivals.
    Poisson,
    /// Gamma-distributed intervals: burstier than Poisson above a coefficient of variation of 1, steadier below.
    Gamma {
        /// Standard deviation of the intervals over their mean.
        cv: f64,
    },
}

/// One arrival.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Arrival {
    /// Mean intervals since the start.
    pub(crate) at: f64,
    /// Which camera, from 0.
    pub(crate) camera: u16,
}

/// The arrivals of `process`; cameras get shares as their `weights` say (a fleet's are alike). There is no end.
pub(crate) fn arrivals(process: Process, weights: &[f64], seed: u64) -> Box<dyn Iterator<Item = Arrival>> {
    let rng = StdRng::seed_from_u64(seed);
    match process {
        Process::Fleet => fleet(weights.len(), rng),
        Process::Poisson => random(weights, rng, |rng| Exp1.sample(rng)),
        Process::Gamma { cv } => {
            let gamma = Gamma::new(cv.powi(-2), cv.powi(2)).expect("the command line has checked the CV");
            random(weights, rng, move |rng| gamma.sample(rng))
        }
    }
}

fn random(
    weights: &[f64],
    mut rng: StdRng,
    mut interval: impl FnMut(&mut StdRng) -> f64 + 'static,
) -> Box<dyn Iterator<Item = Arrival>> {
    let cameras = WeightedIndex::new(weights).expect("the command line has checked the weights");
    let mut at = 0.0;
    Box::new(std::iter::repeat_with(move || {
        at += interval(&mut rng);
        let camera =
            u16::try_from(cameras.sample(&mut rng)).expect("the command line has checked the number");
        Arrival { at, camera }
    }))
}

fn fleet(cameras: usize, mut rng: StdRng) -> Box<dyn Iterator<Item = Arrival>> {
    let period = cameras as f64;
    let mut phases: Vec<(f64, u16)> = (0..cameras)
        .map(|camera| {
            let camera = u16::try_from(camera).expect("the command line has checked the number");
            (rng.random_range(0.0..period), camera)
        })
        .collect();
    phases.sort_by(|a, b| a.0.total_cmp(&b.0));
    let rounds = (0_u64..).map(move |round| round as f64 * period);
    Box::new(rounds.flat_map(move |start| {
        let phases = phases.clone();
        phases.into_iter().map(move |(phase, camera)| Arrival {
            at: start + phase,
            camera,
        })
    }))
}

#[cfg(test)]
mod tests {
    use super::{Process, arrivals};

    const COUNT: usize = 40_000;

    /// Mean and coefficient of variation of the intervals.
    fn moments(process: Process, seed: u64) -> (f64, f64) {
        let times: Vec<f64> = arrivals(process, &[1.0], seed)
            .take(COUNT)
            .map(|a| a.at)
            .collect();
        let intervals: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let n = intervals.len() as f64;
        let mean = intervals.iter().sum::<f64>() / n;
        let variance = intervals.iter().map(|i| (i - mean).powi(2)).sum::<f64>() / n;
        (mean, variance.sqrt() / mean)
    }

    #[test]
    fn random_processes_have_rate_one_and_the_variation_asked_for() {
        for seed in 0..5 {
            for (process, cv) in [
                (Process::Poisson, 1.0),
                (Process::Gamma { cv: 0.5 }, 0.5),
                (Process::Gamma { cv: 2.0 }, 2.0),
                (Process::Gamma { cv: 4.0 }, 4.0),
            ] {
                let (mean, got) = moments(process, seed);
                // Five standard errors of a mean of so many intervals; the CV's own is larger for heavy tails.
                let error = 5.0 * cv / (COUNT as f64).sqrt();
                assert!((mean - 1.0).abs() < error, "{process:?} {seed}: mean {mean}");
                assert!(
                    (got / cv - 1.0).abs() < 0.03 + 0.02 * cv,
                    "{process:?} {seed}: CV {got}"
                );
            }
        }
    }

    #[test]
    fn arrivals_never_go_back_and_repeat_for_a_seed() {
        for process in [Process::Fleet, Process::Poisson, Process::Gamma { cv: 4.0 }] {
            let times = |seed| arrivals(process, &[1.0; 7], seed).take(2000).collect::<Vec<_>>();
            assert!(
                times(3).windows(2).all(|pair| pair[0].at <= pair[1].at),
                "{process:?}"
            );
            assert_eq!(times(3), times(3));
            assert_ne!(times(3), times(4));
        }
    }

    #[test]
    fn every_camera_of_a_fleet_is_periodic_with_a_phase_of_its_own() {
        let all: Vec<_> = arrivals(Process::Fleet, &[1.0; 5], 1).take(500).collect();
        let mut phases = Vec::new();
        for camera in 0..5 {
            let times: Vec<f64> = all.iter().filter(|a| a.camera == camera).map(|a| a.at).collect();
            assert_eq!(times.len(), 100);
            assert!(
                times
                    .windows(2)
                    .all(|pair| (pair[1] - pair[0] - 5.0).abs() < 1e-9)
            );
            phases.push(times[0]);
        }
        phases.sort_by(f64::total_cmp);
        assert!(phases.windows(2).all(|pair| pair[0] < pair[1]));
    }

    #[test]
    fn cameras_send_in_proportion_to_their_weights() {
        let flood = arrivals(Process::Poisson, &[10.0, 1.0, 1.0], 9)
            .take(12_000)
            .filter(|a| a.camera == 0)
            .count();
        assert!((9_800..10_200).contains(&flood), "{flood} of 12000");
    }
}
