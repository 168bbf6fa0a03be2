//! What is sent when: arrivals stretched to rates, each with a camera and a budget.

use std::time::Duration;

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

use crate::arrivals::{self, Process};

/// One frame that is due.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Shot {
    /// When it is due, since the start of the run.
    pub(crate) at: Duration,
    /// Which camera sends it, from 0.
    pub(crate) camera: u16,
    /// Its latency budget.
    pub(crate) budget: Duration,
}

/// A time with one rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stretch {
    /// How long; may be infinite.
    pub(crate) seconds: f64,
    /// Frames a second, above 0.
    pub(crate) rate_hz: f64,
}

/// Rates over time; a run ends with the last stretch.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Profile(pub(crate) Vec<Stretch>);

impl Profile {
    /// One rate for ever.
    pub(crate) fn steady(rate_hz: f64) -> Self {
        Self(vec![Stretch {
            seconds: f64::INFINITY,
            rate_hz,
        }])
    }

    /// When so many mean intervals have passed; `None` after the end.
    fn moment(&self, intervals: f64) -> Option<Duration> {
        let (mut start, mut left) = (0.0, intervals);
        for stretch in &self.0 {
            let content = stretch.seconds * stretch.rate_hz;
            if left < content {
                return Duration::try_from_secs_f64(start + left / stretch.rate_hz).ok();
            }
            start += stretch.seconds;
            left -= content;
        }
        None
    }
}

/// A load on a server.
#[derive(Debug, Clone)]
pub(crate) struct Load {
    /// How frames arrive.
    pub(crate) process: Process,
    /// At which rates, of all cameras together.
    pub(crate) profile: Profile,
    /// Relative rates of the cameras; as many as there are cameras.
    pub(crate) weights: Vec<f64>,
    /// Budgets, mixed evenly; at least one.
    pub(crate) budgets: Vec<Duration>,
    /// Which arrivals.
    pub(crate) seed: u64,
}

impl Load {
    /// The frames in the order they are due.
    pub(crate) fn shots(&self) -> impl Iterator<Item = Shot> + use<> {
        // Not the arrivals' own generator, so that the budgets don't change the arrivals.
        let mut rng = StdRng::seed_from_u64(!self.seed);
        let Self {
            process,
            profile,
            budgets,
            ..
        } = self.clone();
        arrivals::arrivals(process, &self.weights, self.seed).map_while(move |arrival| {
            let kind = match process {
                Process::Fleet => usize::from(arrival.camera) % budgets.len(),
                _ => rng.random_range(0..budgets.len()),
            };
            Some(Shot {
                at: profile.moment(arrival.at)?,
                camera: arrival.camera,
                budget: budgets[kind],
            })
        })
    }

    /// The longest budget.
    pub(crate) fn longest_budget(&self) -> Duration {
        self.budgets.iter().copied().max().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::time::Duration;

    use super::{Load, Profile, Stretch};
    use crate::arrivals::Process;

    fn load(process: Process, profile: Profile) -> Load {
        Load {
            process,
            profile,
            weights: vec![1.0; 4],
            budgets: [10, 20, 50, 100].map(Duration::from_millis).to_vec(),
            seed: 5,
        }
    }

    #[test]
    fn a_burst_has_its_rate_its_time_and_an_end() {
        let stretch = |seconds, rate_hz| Stretch { seconds, rate_hz };
        let burst = Profile(vec![
            stretch(5.0, 100.0),
            stretch(5.0, 500.0),
            stretch(5.0, 100.0),
        ]);
        for process in [Process::Fleet, Process::Poisson] {
            let shots: Vec<f64> = load(process, burst.clone())
                .shots()
                .map(|s| s.at.as_secs_f64())
                .collect();
            let within = |from, to| shots.iter().filter(|at| (from..to).contains(*at)).count() as f64;
            for (count, expected) in [
                (within(0.0, 5.0), 500.0),
                (within(5.0, 10.0), 2500.0),
                (within(10.0, 15.0), 500.0),
            ] {
                // Five standard deviations of a Poisson count.
                let error: f64 = f64::sqrt(expected) * 5.0;
                assert!((count - expected).abs() < error, "{process:?}: {count}");
            }
            assert!(shots.iter().all(|at| *at < 15.0));
        }
    }

    #[test]
    fn a_fleet_at_30_hz_sends_every_camera_every_33_ms() {
        let shots: Vec<_> = load(Process::Fleet, Profile::steady(4.0 * 30.0))
            .shots()
            .take(400)
            .collect();
        let one: Vec<_> = shots.iter().filter(|shot| shot.camera == 2).collect();
        assert_eq!(one.len(), 100);
        for pair in one.windows(2) {
            assert!(((pair[1].at - pair[0].at).as_secs_f64() - 1.0 / 30.0).abs() < 1e-6);
        }
        // A camera keeps its budget.
        assert_eq!(one.iter().map(|s| s.budget).collect::<BTreeSet<_>>().len(), 1);
    }

    #[test]
    fn budgets_are_mixed_evenly() {
        let shots: Vec<_> = load(Process::Poisson, Profile::steady(50.0))
            .shots()
            .take(4000)
            .collect();
        for budget in [10, 20, 50, 100].map(Duration::from_millis) {
            let count = shots.iter().filter(|s| s.budget == budget).count();
            assert!((850..1150).contains(&count), "{budget:?}: {count}");
        }
    }
}
