//! Whether anything grew or got worse after the warm-up.

use std::time::Duration;

use anyhow::{Result, ensure};

use super::sample::Sample;

/// The first part of a run, in which buffers get their sizes and the allocator its arenas: a fifth of it, and at least this, but no
/// more than half.
const LEAST_WARM_UP: Duration = Duration::from_secs(120);
const WARM_UP_SHARE: f64 = 0.2;
const MOST_WARM_UP_SHARE: f64 = 0.5;
/// Samples after it, without which nothing can be said.
const LEAST_SAMPLES: usize = 6;
/// How much the memory may grow from the end of the warm-up to the end: a share of it or so many bytes, whichever is more.
const GROWTH_SHARE: f64 = 0.05;
const GROWTH_BYTES: f64 = (8 << 20) as f64;
/// How many more descriptors, threads and tasks there may be at the end.
const MORE_DESCRIPTORS: f64 = 5.0;
const MORE_THREADS: f64 = 2.0;
const MORE_TASKS: f64 = 10.0;
/// How many more descriptors than before the load there may be when all of it is over: Zenoh opens what its threads and shared memory
/// need when it is used first, and keeps it.
const KEPT_DESCRIPTORS: f64 = 20.0;
/// The share of frames with a deadline that has to be in budget, and how much less of them in the last third than in the first.
const LEAST_ATTAINMENT: f64 = 0.99;
const LESS_ATTAINMENT: f64 = 0.005;

/// One quantity through the run.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Line {
    /// What it is.
    pub(super) name: &'static str,
    /// Its unit, after the numbers; and by what they are divided to have it.
    pub(super) unit: &'static str,
    pub(super) divisor: f64,
    /// Its median in the first and the last third after the warm-up.
    pub(super) first: f64,
    pub(super) last: f64,
    /// How much it grew by the slope of the whole time after the warm-up, and how much it may.
    pub(super) growth: f64,
    pub(super) limit: f64,
}

impl Line {
    fn is_kept(&self) -> bool {
        self.growth <= self.limit
    }
}

/// What came of a run.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Verdict {
    /// Seconds of the warm-up, and after it.
    pub(super) warm_up: f64,
    pub(super) length: f64,
    /// Memory, descriptors, threads, tasks.
    pub(super) lines: Vec<Line>,
    /// Shares in budget: of the first third, of the last, of all.
    pub(super) attainment: [f64; 3],
    /// What is wrong; empty if nothing is.
    pub(super) failures: Vec<String>,
}

/// Judges the samples of a run, whose first is of its start.
///
/// # Errors
/// If it was too short to say anything.
pub(super) fn judge(samples: &[Sample]) -> Result<Verdict> {
    let end = samples.last().map_or(0.0, |sample| sample.seconds);
    let warm_up = (WARM_UP_SHARE * end)
        .max(LEAST_WARM_UP.as_secs_f64())
        .min(MOST_WARM_UP_SHARE * end);
    let from = samples.partition_point(|sample| sample.seconds < warm_up);
    let after = &samples[from..];
    ensure!(
        after.len() >= LEAST_SAMPLES,
        "{end:.0} s are too short: after the warm-up of {warm_up:.0} s there are {} looks at the server, {LEAST_SAMPLES} are needed",
        after.len()
    );
    let memory = |sample: &Sample| sample.resident_bytes as f64;
    let third = after.len() / 3;
    let allowed = (GROWTH_SHARE * median(after.iter().map(memory).collect())).max(GROWTH_BYTES);
    let line = |name, unit, divisor, value: &dyn Fn(&Sample) -> f64, limit| {
        let points: Vec<(f64, f64)> = after
            .iter()
            .map(|sample| (sample.seconds, value(sample)))
            .collect();
        Line {
            name,
            unit,
            divisor,
            first: median(after[..third].iter().map(value).collect()),
            last: median(after[after.len() - third..].iter().map(value).collect()),
            growth: slope(&points) * (end - after[0].seconds),
            limit,
        }
    };
    let lines = vec![
        line("resident memory", " MB", 1e6, &memory, allowed),
        line(
            "descriptors",
            "",
            1.0,
            &|sample| sample.descriptors as f64,
            MORE_DESCRIPTORS,
        ),
        line("threads", "", 1.0, &|sample| sample.threads as f64, MORE_THREADS),
        line("tasks", "", 1.0, &|sample| sample.tasks as f64, MORE_TASKS),
    ];
    let attainment = [&after[..=third], &after[after.len() - 1 - third..], after].map(share_in_budget);
    let mut failures: Vec<String> = lines.iter().filter(|line| !line.is_kept()).map(grew).collect();
    let [first, last, all] = attainment.map(|share| 100.0 * share);
    if attainment[2] < LEAST_ATTAINMENT {
        failures.push(format!(
            "{all:.2} % of the frames were in budget, wanted {:.0} %",
            100.0 * LEAST_ATTAINMENT
        ));
    }
    if attainment[1] < attainment[0] - LESS_ATTAINMENT {
        failures.push(format!("the share in budget fell from {first:.2} to {last:.2} %"));
    }
    let broken = samples.last().map_or(0, |sample| sample.counts.broken);
    if broken > 0 {
        failures.push(format!("{broken} answers were none, or did not come"));
    }
    Ok(Verdict {
        warm_up: after[0].seconds,
        length: end - after[0].seconds,
        lines,
        attainment,
        failures,
    })
}

/// What is wrong after the load: `before` it, and once all of it is over, the server should hold the same.
pub(super) fn remains(before: &Sample, after: &Sample) -> Vec<String> {
    let held = after.in_flight_bytes;
    let mut failures = Vec::new();
    if held > 0 {
        failures.push(format!(
            "{held} bytes of requests and replies are held though nothing is under way"
        ));
    }
    for (name, before, after, more) in [
        (
            "descriptors",
            before.descriptors,
            after.descriptors,
            KEPT_DESCRIPTORS,
        ),
        ("tasks", before.tasks, after.tasks, MORE_TASKS),
    ] {
        if after as f64 > before as f64 + more {
            failures.push(format!(
                "{after} {name} are left after the load, {before} were there before it"
            ));
        }
    }
    failures
}

fn grew(line: &Line) -> String {
    let Line {
        name, unit, divisor, ..
    } = line;
    format!(
        "{name} grew by {:.1}{unit}, at most {:.1}{unit} would do",
        line.growth / divisor,
        line.limit / divisor
    )
}

/// The share of the frames with a deadline that ended between the first and the last of `samples` and were in budget.
fn share_in_budget(samples: &[Sample]) -> f64 {
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else {
        return 1.0;
    };
    let ((offered_before, kept_before), (offered, kept)) = (first.deadlines(), last.deadlines());
    match offered - offered_before {
        0 => 0.0,
        offered => (kept - kept_before) as f64 / offered as f64,
    }
}

/// The median of all slopes between two points (Theil and Sen): a single peak does not change it.
fn slope(points: &[(f64, f64)]) -> f64 {
    let pairs = points.iter().enumerate().flat_map(|(index, &(x, y))| {
        let later = points[index + 1..].iter();
        later.map(move |&(later_x, later_y)| (later_y - y) / (later_x - x))
    });
    median(pairs.collect())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests;
