//! What a number of frames allows to be said.
//!
//! The claim is "at least the share `p` of frames is in budget". As in MLPerf Inference (rules, appendix "Early stopping
//! criterion"; loadgen `early_stopping.cc`, tolerance 0), it holds with confidence `c` after `n` frames with `t` misses once
//! a server that attains only `p` would have so few misses with a probability of at most `1 - c`:
//!
//! ```text
//! sum over x = 0..=t of binomial(n, x) p^(n-x) (1-p)^x <= 1 - c
//! ```

/// Confidence of every claim.
pub(crate) const CONFIDENCE: f64 = 0.99;

/// Where a claim stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Decision {
    /// The share is at least what is claimed.
    Proven,
    /// The share is less.
    Refuted,
    /// Too few frames to tell.
    Open,
}

/// Where the claim "at least `share` of the frames is in budget" stands after `frames` with `misses`.
pub(crate) fn decide(share: f64, frames: u64, misses: u64) -> Decision {
    if holds(share, frames, misses) {
        return Decision::Proven;
    }
    let so_many = match misses.checked_sub(1) {
        Some(fewer) => 1.0 - binomial_cdf(fewer, frames, 1.0 - share),
        None => 1.0,
    };
    if so_many <= 1.0 - CONFIDENCE {
        Decision::Refuted
    } else {
        Decision::Open
    }
}

fn holds(share: f64, frames: u64, misses: u64) -> bool {
    frames > 0 && binomial_cdf(misses, frames, 1.0 - share) <= 1.0 - CONFIDENCE
}

/// The largest share that is proven by `frames` with `misses` (the one-sided Clopper-Pearson bound).
pub(crate) fn proven_share(frames: u64, misses: u64) -> f64 {
    let (mut proven, mut open) = (0.0, 1.0);
    // Each round halves the interval.
    for _ in 0..50 {
        let middle = f64::midpoint(proven, open);
        if holds(middle, frames, misses) {
            proven = middle;
        } else {
            open = middle;
        }
    }
    proven
}

/// How many of the largest of `frames` latencies are left out so that the next one is an upper bound of the percentile
/// `share`, by MLPerf's count; `None` if the frames are too few for any.
pub(crate) fn discardable(share: f64, frames: u64) -> Option<u64> {
    // Always so: all frames over a latency say nothing for it.
    let (mut good, mut bad) = (0, frames);
    while bad.saturating_sub(good) > 1 {
        let middle = u64::midpoint(good, bad);
        if holds(share, frames, middle) {
            good = middle;
        } else {
            bad = middle;
        }
    }
    // The bound itself counts as over the latency.
    good.checked_sub(1)
}

/// The probability of at most `most` events in `trials` with a probability of `chance` each.
fn binomial_cdf(most: u64, trials: u64, chance: f64) -> f64 {
    if most >= trials {
        return 1.0;
    }
    let odds = (chance / (1.0 - chance)).ln();
    // Sums in logarithms, relative to the largest term so far: the first one underflows with many trials.
    let mut term = trials as f64 * (1.0 - chance).ln();
    let (mut largest, mut sum) = (term, 1.0);
    for x in 0..most {
        term += ((trials - x) as f64 / (x + 1) as f64).ln() + odds;
        if term > largest {
            sum = sum * (largest - term).exp() + 1.0;
            largest = term;
        } else {
            sum += (term - largest).exp();
        }
    }
    (largest + sum.ln()).exp().min(1.0)
}

/// Jain's fairness index: 1 if all are alike, 1/n if one has everything (Jain, Chiu, Hawe 1984).
pub(crate) fn jain(values: &[f64]) -> f64 {
    let sum: f64 = values.iter().sum();
    let squares: f64 = values.iter().map(|value| value * value).sum();
    if squares == 0.0 {
        return 1.0;
    }
    sum * sum / (values.len() as f64 * squares)
}

/// What each client gets of `capacity` when it is shared fairly (max-min): nobody more than it asks for, and what one
/// leaves goes to the others.
pub(crate) fn fair_shares(capacity: f64, demands: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..demands.len()).collect();
    order.sort_by(|&a, &b| demands[a].total_cmp(&demands[b]));
    let mut shares = vec![0.0; demands.len()];
    let (mut left, mut clients) = (capacity, demands.len() as f64);
    for client in order {
        shares[client] = demands[client].min(left / clients);
        left -= shares[client];
        clients -= 1.0;
    }
    shares
}

#[cfg(test)]
mod tests {
    use super::{Decision, binomial_cdf, decide, discardable, fair_shares, jain, proven_share};

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-9 * b.abs().max(1e-3)
    }

    #[test]
    fn the_binomial_distribution_is_exact() {
        // By hand: (1/2)^4 (1 + 4 + 6), 0.9^2, 0.9^2 + 2 x 0.9 x 0.1.
        assert!(close(binomial_cdf(2, 4, 0.5), 11.0 / 16.0));
        assert!(close(binomial_cdf(0, 2, 0.1), 0.81));
        assert!(close(binomial_cdf(1, 2, 0.1), 0.99));
        assert!(close(binomial_cdf(2, 2, 0.1), 1.0));
        // The median of a wide one; a sum that starts at e^-10050.
        let half = binomial_cdf(10_000, 1_000_000, 0.01);
        assert!((0.5..0.51).contains(&half), "{half}");
    }

    #[test]
    fn the_least_numbers_of_queries_are_those_that_mlperf_publishes() {
        // One miss: 64 queries for the 90th percentile, 662 for the 99th.
        assert_eq!(decide(0.9, 64, 1), Decision::Proven);
        assert_ne!(decide(0.9, 63, 1), Decision::Proven);
        assert_eq!(decide(0.99, 662, 1), Decision::Proven);
        assert_ne!(decide(0.99, 661, 1), Decision::Proven);
        // Its report for 2048 queries at the 90th percentile: "would discard 172 highest latency queries".
        assert_eq!(discardable(0.9, 2048), Some(172));
        assert_eq!(discardable(0.9, 63), None);
        assert_eq!(discardable(0.9, 64), Some(0));
        assert_eq!(discardable(0.9, 0), None);
    }

    #[test]
    fn claims_are_proven_refuted_or_open() {
        assert_eq!(decide(0.99, 1000, 2), Decision::Proven);
        assert_eq!(decide(0.99, 1000, 10), Decision::Open);
        assert_eq!(decide(0.99, 1000, 30), Decision::Refuted);
        assert_eq!(decide(0.99, 0, 0), Decision::Open);
        assert_eq!(decide(0.99, 5, 5), Decision::Refuted);
    }

    #[test]
    fn the_proven_share_is_where_the_claim_stops_to_hold() {
        for (frames, misses) in [(500, 0), (1000, 12), (100, 100)] {
            let share = proven_share(frames, misses);
            assert_ne!(decide(share + 1e-6, frames, misses), Decision::Proven);
            if misses < frames {
                assert_eq!(decide(share - 1e-6, frames, misses), Decision::Proven);
            }
        }
        // With no miss at all: 0.01^(1/n).
        assert!(close(proven_share(500, 0), 0.01_f64.powf(1.0 / 500.0)));
    }

    #[test]
    fn fairness_is_one_when_all_are_alike() {
        assert!(close(jain(&[3.0, 3.0, 3.0]), 1.0));
        assert!(close(jain(&[1.0, 0.0, 0.0, 0.0]), 0.25));
        assert!(close(jain(&[0.0, 0.0]), 1.0));
    }

    #[test]
    fn fair_shares_leave_what_small_clients_do_not_want_to_the_large() {
        assert_eq!(fair_shares(10.0, &[1.0, 20.0, 2.0]), [1.0, 7.0, 2.0]);
        assert_eq!(fair_shares(9.0, &[5.0, 20.0, 6.0]), [3.0, 3.0, 3.0]);
        assert_eq!(fair_shares(90.0, &[5.0, 20.0]), [5.0, 20.0]);
    }
}
