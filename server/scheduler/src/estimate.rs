//! What a piece of work is going to cost: an online tail estimate for each kind of work.
//!
//! The estimate is that of TCP's retransmission timer (Jacobson 1988; RFC 6298): a moving mean plus a multiple of the moving mean
//! absolute deviation. It needs two numbers a kind, follows a machine that gets slower or faster, and errs on the long side, which
//! is the right side for a deadline.

use std::collections::HashMap;
use std::hash::Hash;
use std::time::Duration;

/// Weight of a new value in the moving mean.
const MEAN_GAIN: f64 = 1.0 / 8.0;
/// Weight of a new value in the moving deviation.
const DEVIATION_GAIN: f64 = 1.0 / 4.0;
/// Deviations above the mean that a tail estimate lies: about the 99th percentile of normal noise.
const TAIL_DEVIATIONS: f64 = 3.0;
/// Share of the first value that is taken as deviation while there is only one.
const FIRST_DEVIATION: f64 = 1.0 / 4.0;

/// Moving tail estimate of one non-negative quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TailEstimate {
    mean: f64,
    deviation: f64,
}

impl TailEstimate {
    /// The estimate after one value.
    #[must_use]
    pub fn first(value: f64) -> Self {
        Self {
            mean: value,
            deviation: value * FIRST_DEVIATION,
        }
    }

    /// Takes one more value into account.
    pub fn record(&mut self, value: f64) {
        let error = value - self.mean;
        self.deviation += DEVIATION_GAIN * (error.abs() - self.deviation);
        self.mean += MEAN_GAIN * error;
    }

    /// The moving mean.
    #[must_use]
    pub fn mean(self) -> f64 {
        self.mean
    }

    /// A value that few of the next ones will exceed.
    #[must_use]
    pub fn tail(self) -> f64 {
        self.mean + TAIL_DEVIATIONS * self.deviation
    }
}

/// Cost of each kind of work for a unit of its size (a frame: a pixel), learned from what was measured.
///
/// The caller bounds the number of kinds: one entry is kept for each that was ever recorded.
#[derive(Debug, Clone)]
pub struct Costs<K> {
    seconds_per_unit: HashMap<K, TailEstimate>,
}

impl<K> Default for Costs<K> {
    fn default() -> Self {
        Self {
            seconds_per_unit: HashMap::new(),
        }
    }
}

impl<K: Eq + Hash> Costs<K> {
    /// `units` of work of `kind` took `took`; nothing is learned from zero units.
    pub fn record(&mut self, kind: K, units: u32, took: Duration) {
        if units == 0 {
            return;
        }
        let value = took.as_secs_f64() / f64::from(units);
        self.seconds_per_unit
            .entry(kind)
            .and_modify(|estimate| estimate.record(value))
            .or_insert_with(|| TailEstimate::first(value));
    }

    /// How long `units` of work of `kind` will take at most, nearly always; `None` if this kind was never recorded.
    #[must_use]
    pub fn tail(&self, kind: &K, units: u32) -> Option<Duration> {
        let seconds = self.seconds_per_unit.get(kind)?.tail() * f64::from(units);
        Some(Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_kind_has_no_estimate_and_zero_units_teach_nothing() {
        let mut costs = Costs::default();
        costs.record("base", 0, Duration::from_millis(5));
        assert_eq!(costs.tail(&"base", 100), None);
    }

    #[test]
    fn the_estimate_scales_with_the_size_of_the_work() {
        let mut costs = Costs::default();
        for _ in 0..200 {
            costs.record("base", 1000, Duration::from_millis(10));
        }
        let tail_ms = costs.tail(&"base", 2000).unwrap().as_secs_f64() * 1e3;
        assert!(
            (tail_ms - 20.0).abs() < 0.01,
            "steady work has no deviation: {tail_ms} ms"
        );
    }

    #[test]
    fn one_outlier_lifts_the_tail_more_than_the_mean() {
        let mut estimate = TailEstimate::first(10.0);
        for _ in 0..100 {
            estimate.record(10.0);
        }
        estimate.record(50.0);
        assert!((estimate.mean() - 15.0).abs() < 1e-6);
        assert!(estimate.tail() > 40.0);
    }
}
