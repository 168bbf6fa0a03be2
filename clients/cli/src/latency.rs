//! How long many answers took, and how many were in time.

use std::time::Duration;

use hdrhistogram::Histogram;
use serde_json::{Value, json};

use crate::output::ms;

/// The shares that tables show, in percent.
const PERCENTILES: [f64; 5] = [50.0, 90.0, 95.0, 99.0, 99.9];

/// What is longer counts as this: ten minutes.
const LONGEST_US: u64 = 600_000_000;

/// Latencies from 1 us on, to three digits.
#[derive(Debug)]
pub(crate) struct Latencies {
    histogram: Histogram<u64>,
    budget: Duration,
    in_budget: u64,
}

impl Latencies {
    /// None yet; they are compared with `budget`.
    pub(crate) fn new(budget: Duration) -> Self {
        Self {
            histogram: Histogram::new_with_bounds(1, LONGEST_US, 3).expect("bounds and digits are allowed"),
            budget,
            in_budget: 0,
        }
    }

    pub(crate) fn add(&mut self, latency: Duration) {
        let us = u64::try_from(latency.as_micros()).unwrap_or(LONGEST_US);
        self.histogram.saturating_record(us.max(1));
        self.in_budget += u64::from(latency <= self.budget);
    }

    pub(crate) fn count(&self) -> u64 {
        self.histogram.len()
    }

    /// Those within the budget.
    pub(crate) fn in_budget(&self) -> u64 {
        self.in_budget
    }

    /// The latency that this many percent kept; zero if there is none.
    pub(crate) fn at(&self, percent: f64) -> Duration {
        Duration::from_micros(self.histogram.value_at_quantile(percent / 100.0))
    }

    fn max(&self) -> Duration {
        Duration::from_micros(self.histogram.max())
    }

    /// `null` if there is none.
    pub(crate) fn to_json(&self) -> Value {
        if self.histogram.is_empty() {
            return Value::Null;
        }
        let mut object = serde_json::Map::new();
        for percent in PERCENTILES {
            object.insert(format!("p{percent}"), json!(ms(self.at(percent))));
        }
        object.insert("max".to_owned(), json!(ms(self.max())));
        object.insert("mean".to_owned(), json!(self.histogram.mean() / 1e3));
        Value::Object(object)
    }

    /// Head and numbers of a table, in ms.
    pub(crate) fn rows(&self) -> [Vec<String>; 2] {
        let mut head = vec!["latency, ms".to_owned()];
        let mut row = vec![String::new()];
        for percent in PERCENTILES {
            head.push(format!("p{percent}"));
            row.push(format!("{:.2}", ms(self.at(percent))));
        }
        head.push("max".to_owned());
        row.push(format!("{:.2}", ms(self.max())));
        [head, row]
    }
}

/// A part of a whole in percent; nothing of nothing is 0.
#[expect(
    clippy::cast_precision_loss,
    reason = "counts of frames, shown with two digits"
)]
pub(crate) fn percent(part: u64, whole: u64) -> f64 {
    100.0 * part as f64 / (whole.max(1)) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_what_was_added() {
        let mut latencies = Latencies::new(Duration::from_millis(90));
        for i in 1..=100 {
            latencies.add(Duration::from_millis(i));
        }
        let close = |a: Duration, b: u64| {
            a.abs_diff(Duration::from_millis(b)) < Duration::from_micros(b * 1000 / 500)
        };
        assert!(close(latencies.at(50.0), 50) && close(latencies.at(99.0), 99));
        assert_eq!((latencies.count(), latencies.in_budget()), (100, 90));
        assert_eq!(Latencies::new(Duration::ZERO).to_json(), Value::Null);
    }
}
