//! How fast the machine is of late, beside what is typical of it.
//!
//! Cores are shared with other machines of the same host, and slow down and recover together with what those do: the stages of a few
//! milliseconds are all dear or all cheap. So what the last stages took, beside what they take typically, says something about the next
//! one, for as long as they are fresh. How much it says is learned as well (the slope of a regression): nothing where each frame is dear
//! or cheap for itself.

use std::time::Duration;

/// For how long a stage counts: those of about this time, the last one most, make the pace.
const MEMORY_S: f64 = 1.5e-3;
/// After so long without a stage, the pace says about a third of what it did.
const FADES_S: f64 = 0.05;
/// Logarithm of the largest change of pace that is believed: twice or half.
const MOST: f64 = std::f64::consts::LN_2;
/// Weight of the last frame among those that tell what the pace is worth: half of all after 64.
const WEIGHT: f64 = 0.011;
/// Variance of a pace that says nothing: below it, a few frames prove nothing.
const NOISE: f64 = 1e-3;

/// The pace; logarithms throughout, so that twice as slow and twice as fast are equally far from typical.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Pace {
    present: f64,
    noted_at: Duration,
    /// Of the pace before a frame and what the frame took then: variance of the former, covariance of both.
    variance: f64,
    covariance: f64,
}

impl Pace {
    /// A stage that ended at `now` took `took` where `typical_s` is typical.
    pub(crate) fn note(&mut self, now: Duration, typical_s: f64, took: Duration) {
        let took_s = took.as_secs_f64();
        if typical_s > 0.0 && took_s > 0.0 {
            let weight = 1.0 - (-took_s / MEMORY_S).exp();
            let present = self.at(now.saturating_sub(took));
            self.present = present + weight * (logarithm(took_s / typical_s) - present);
            self.noted_at = now;
        }
    }

    /// The first long stage of a frame, which ended at `now`, took `took` where `typical_s` is typical: what was the pace worth that
    /// frames before it had?
    pub(crate) fn judge(&mut self, now: Duration, typical_s: f64, took: Duration) {
        let took_s = took.as_secs_f64();
        if typical_s > 0.0 && took_s > 0.0 {
            let was = self.at(now.saturating_sub(took));
            let came = logarithm(took_s / typical_s);
            self.variance += WEIGHT * (was * was - self.variance);
            self.covariance += WEIGHT * (was * came - self.covariance);
        }
    }

    /// What a frame is going to take at `now`, beside what is typical.
    pub(crate) fn factor(&self, now: Duration) -> f64 {
        let worth = (self.covariance / (self.variance + NOISE)).clamp(0.0, 1.0);
        (worth * self.at(now)).exp()
    }

    /// The pace at `now`: what nothing has confirmed for a while fades. Or else jobs would be refused for a pace that was long over, and
    /// none of them measured that would show it.
    fn at(&self, now: Duration) -> f64 {
        let silent = now.saturating_sub(self.noted_at);
        self.present * (-silent.as_secs_f64() / FADES_S).exp()
    }
}

fn logarithm(ratio: f64) -> f64 {
    ratio.ln().clamp(-MOST, MOST)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The factor after frames of 2 ms and an ending of 1 ms, each `slow(i)` times as long as typical.
    fn paced(slow: impl Fn(u32) -> f64) -> f64 {
        let mut pace = Pace::default();
        let mut now = Duration::ZERO;
        for frame in 0..300 {
            for (stage, typical_s) in [2e-3, 1e-3].into_iter().enumerate() {
                let took = Duration::from_secs_f64(typical_s * slow(frame));
                now += took;
                if stage == 0 {
                    pace.judge(now, typical_s, took);
                }
                pace.note(now, typical_s, took);
            }
        }
        pace.factor(now)
    }

    #[test]
    fn slow_times_that_last_are_expected_to_last() {
        // Ten frames slow, ten fast.
        let phases = |frame: u32| if frame / 10 % 2 == 1 { 1.4 } else { 1.0 };
        let factor = paced(phases);
        assert!((1.2..1.4).contains(&factor), "{factor}");
        assert!(paced(|frame| phases(frame + 10)) < 1.05);
    }

    #[test]
    fn frames_that_differ_for_themselves_say_nothing_about_the_next_one() {
        let each = |frame: u32| if frame % 2 == 1 { 1.2 } else { 1.0 / 1.2 };
        let factor = paced(each);
        assert!((0.95..1.05).contains(&factor), "{factor}");
        // Between 0.8 and 1.2, without any order.
        let noise = |frame: u32| 0.8 + f64::from(frame.wrapping_mul(2_654_435_761) >> 24) / 640.0;
        let factor = paced(noise);
        assert!((0.95..1.05).contains(&factor), "{factor}");
    }
}
