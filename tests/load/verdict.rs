//! What one run says to somebody who sizes a fleet.

use std::fmt::Write as _;
use std::time::Duration;

use crate::figures::{Figures, quantile};
use crate::statistics::{Decision, decide};

/// Frames that are sent later than this make the generator a part of what it measures.
const PUNCTUAL: Duration = Duration::from_millis(5);

/// The verdict with its reasons.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Verdict {
    /// Whether the load was carried.
    pub(crate) is_kept: bool,
    /// All of it, for reading.
    pub(crate) text: String,
}

/// Judges a run against the share of frames that has to be in budget (`None`: nothing has to be, it measures what comes
/// out); `what` is the load in a few words.
pub(crate) fn judge(figures: &Figures, attain: Option<f64>, what: &str, length: Duration) -> Verdict {
    let (is_kept, headline) = match attain {
        Some(attain) => attainment(figures, attain),
        None => (
            true,
            format!(
                "CAPACITY: {:.1} frames a second with {:.0} % of the rungs",
                figures.answered as f64 / length.as_secs_f64(),
                100.0 * figures.rungs
            ),
        ),
    };
    let mut text = format!(
        "{what}: {} frames in {:.1} s ({:.1} a second)\n\n{headline}\n",
        figures.offered,
        length.as_secs_f64(),
        figures.offered_hz,
    );
    let mut line = |label: &str, value: String| {
        writeln!(text, "  {label:26} {value}").expect("a String takes everything");
    };
    line(
        "in budget, server's clock",
        format!("{:.2} %", 100.0 * figures.attainment_by_the_server()),
    );
    line(
        "in budget, once sent",
        format!("{:.2} %", 100.0 * figures.attainment_from_sending()),
    );
    line(
        "goodput",
        format!("{:.1} frames a second in budget", figures.goodput_hz),
    );
    line("latency of results, ms", latencies(figures));
    line("where the time went, ms", stages(figures));
    line(
        "rungs run",
        format!("{:.0} % of the ladder", 100.0 * figures.rungs),
    );
    if let Some(error) = figures.prediction_error {
        line(
            "cost predictions",
            format!("within {:.0} % for 95 % of the frames", 100.0 * error),
        );
    }
    for (budget, part) in figures.by_budget.iter().filter(|_| figures.by_budget.len() > 1) {
        line(
            &format!("budget {} ms", ms(*budget)),
            format!(
                "{:.2} % of {} in budget, {:.0} % of the ladder",
                100.0 * part.share(),
                part.offered,
                100.0 * part.mean_rungs()
            ),
        );
    }
    if !figures.refused.is_empty() {
        line("refused", refusals(figures));
    }
    if figures.expired > 0 {
        line(
            "expired",
            format!("{}, taken on and not answered in time", figures.expired),
        );
    }
    for (why, count) in &figures.broken {
        line("without an answer", format!("{count}: {why}"));
    }
    if figures.not_sent > 0 {
        line(
            "not sent",
            format!(
                "{}, for too many were under way (--max-in-flight)",
                figures.not_sent
            ),
        );
    }
    let lag = quantile(&figures.lag, 0.99);
    if lag > PUNCTUAL {
        line(
            "beware",
            format!(
                "the generator sent up to {} ms late (p99): give it a core of its own, or another machine",
                ms(lag)
            ),
        );
    }
    Verdict { is_kept, text }
}

/// Whether the share is attained, and what the frames say about it.
fn attainment(figures: &Figures, attain: f64) -> (bool, String) {
    let decision = decide(attain, figures.offered, figures.offered - figures.in_budget);
    let looks_good = figures.attainment() >= attain;
    let (is_kept, verdict) = match decision {
        Decision::Proven => (true, "KEPT"),
        Decision::Refuted => (false, "NOT KEPT"),
        Decision::Open if looks_good => (
            true,
            "NOT CERTAIN, but it looks good (longer is surer: --max-seconds)",
        ),
        Decision::Open => (
            false,
            "NOT CERTAIN, and it doesn't look good (longer is surer: --max-seconds)",
        ),
    };
    let said = format!(
        "{verdict}: {:.2} % in budget, wanted {:.2} %; at least {:.2} % with 99 % confidence",
        100.0 * figures.attainment(),
        100.0 * attain,
        100.0 * figures.proven_attainment(),
    );
    (is_kept, said)
}

fn latencies(figures: &Figures) -> String {
    if figures.latency.is_empty() {
        return "no result at all".to_owned();
    }
    let at = |share| ms(quantile(&figures.latency, share));
    let bound = match figures.latency_bound(0.99) {
        Some(bound) => format!(" (p99 at most {} with 99 % confidence)", ms(bound)),
        None => String::new(),
    };
    format!(
        "p50 {}, p90 {}, p99 {}, p99.9 {}, most {}{bound}",
        at(0.5),
        at(0.9),
        at(0.99),
        at(0.999),
        at(1.0)
    )
}

fn stages(figures: &Figures) -> String {
    let stages: Vec<String> = figures
        .stages
        .iter()
        .map(|(stage, times)| {
            format!(
                "{stage} {:.2} ({})",
                times.mean() / 1e3,
                ms(quantile(times, 0.99))
            )
        })
        .collect();
    format!("{}: mean (p99)", stages.join(", "))
}

fn refusals(figures: &Figures) -> String {
    let reasons: Vec<String> = figures
        .refused
        .iter()
        .map(|(reason, count)| format!("{count} {reason}"))
        .collect();
    let mute = match figures.mute {
        0 => String::new(),
        count => format!("; {count} didn't say what would be feasible"),
    };
    format!(
        "{} (decided in {} ms, p99){mute}",
        reasons.join(", "),
        ms(quantile(&figures.refusing, 0.99))
    )
}

/// Milliseconds with as many digits as matter.
fn ms(time: Duration) -> String {
    let ms = time.as_secs_f64() * 1e3;
    if ms < 10.0 {
        format!("{ms:.2}")
    } else {
        format!("{ms:.1}")
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::judge;
    use crate::figures::Figures;
    use crate::generator::Run;
    use crate::plan::Shot;
    use crate::record::{Digest, Outcome, Record};

    fn figures(count: u32, late: u32) -> Figures {
        let record = |i| Record {
            shot: Shot {
                at: Duration::from_millis(u64::from(i)),
                camera: 0,
                budget: Duration::from_millis(50),
            },
            lag: Duration::ZERO,
            latency: Duration::from_millis(if i < late { 70 } else { 20 }),
            decided: Duration::ZERO,
            outcome: Outcome::Answered(Box::new(Digest {
                rungs_run: 3,
                rungs_asked: 4,
                deadline_met: true,
                ..Digest::default()
            })),
        };
        Figures::of(&Run {
            records: (0..count).map(record).collect(),
            length: Duration::from_secs(1),
        })
    }

    #[test]
    fn a_load_is_kept_when_the_frames_prove_it_and_not_when_they_refute_it() {
        for (count, late, kept, words) in [
            (1000, 1, true, "\nKEPT"),
            (1000, 100, false, "\nNOT KEPT"),
            (100, 0, true, "NOT CERTAIN, but"),
            (100, 3, false, "NOT CERTAIN, and"),
        ] {
            let verdict = judge(
                &figures(count, late),
                Some(0.99),
                "a fleet",
                Duration::from_secs(1),
            );
            assert_eq!(verdict.is_kept, kept, "{}", verdict.text);
            assert!(verdict.text.contains(words), "{}", verdict.text);
        }
    }

    #[test]
    fn a_closed_loop_measures_a_capacity() {
        let verdict = judge(&figures(100, 50), None, "a closed loop", Duration::from_secs(2));
        assert!(verdict.is_kept);
        assert!(
            verdict
                .text
                .contains("\nCAPACITY: 50.0 frames a second with 75 % of the rungs")
        );
    }
}
