//! The figures of a run, from its records.

use std::collections::BTreeMap;
use std::time::Duration;

use hdrhistogram::Histogram;
use stereo_client::v1::Reason;

use crate::generator::Run;
use crate::record::{Outcome, Record, STAGES};
use crate::statistics::{discardable, fair_shares, jain, proven_share};

/// Answers before this many have been given teach the server what its work costs.
const LEARNING: usize = 50;
/// Length of the stretch that has to be good again after a burst.
const RECOVERED: Duration = Duration::from_secs(1);
/// Share of frames in budget that counts as good again.
const RECOVERED_SHARE: f64 = 0.99;

/// The figures of a run. Shares are 0 to 1.
#[derive(Debug)]
pub(crate) struct Figures {
    /// Frames that were due.
    pub(crate) offered: u64,
    /// The same a second.
    pub(crate) offered_hz: f64,
    /// Frames answered in budget, counted from when they were due.
    pub(crate) in_budget: u64,
    /// The same, counted from when they were sent.
    pub(crate) in_budget_from_sending: u64,
    /// Frames in budget by the server's clock.
    pub(crate) in_budget_by_the_server: u64,
    /// Frames that the server took on.
    pub(crate) admitted: u64,
    /// Those of them that were late or not answered, by the server's clock.
    pub(crate) missed_by_the_server: u64,
    /// Frames in budget a second.
    pub(crate) goodput_hz: f64,
    /// Answers.
    pub(crate) answered: u64,
    /// Refusals at once, by reason.
    pub(crate) refused: BTreeMap<&'static str, u64>,
    /// Frames taken on whose deadline then passed unanswered.
    pub(crate) expired: u64,
    /// Refusals as infeasible that did not say what would be feasible.
    pub(crate) mute: u64,
    /// Frames without an answer that is understood, by what happened.
    pub(crate) broken: BTreeMap<String, u64>,
    /// Frames that were not sent.
    pub(crate) not_sent: u64,
    /// Mean share of the asked rungs that were run.
    pub(crate) rungs: f64,
    /// 95th percentile of |predicted - actual| / actual cost, after the first answers.
    pub(crate) prediction_error: Option<f64>,
    /// From when frames were due until their results were there.
    pub(crate) latency: Histogram<u64>,
    /// From when frames were sent until they were refused at once.
    pub(crate) refusing: Histogram<u64>,
    /// From when frames were due until they were sent.
    pub(crate) lag: Histogram<u64>,
    /// Times of answered frames: lag, the server's [`STAGES`], making way for others, and the rest, which is the way there and back.
    pub(crate) stages: Vec<(&'static str, Histogram<u64>)>,
    /// Offered and in budget by budget.
    pub(crate) by_budget: BTreeMap<Duration, Part>,
    /// Offered and in budget by camera.
    pub(crate) by_camera: BTreeMap<u16, Part>,
}

/// Part of the frames.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Part {
    /// Frames that were due.
    pub(crate) offered: u64,
    /// Those in budget.
    pub(crate) in_budget: u64,
    /// Those answered.
    pub(crate) answered: u64,
    /// Shares of the asked rungs that were run, of all answers together.
    pub(crate) rungs: f64,
}

impl Part {
    /// Counts one frame.
    pub(crate) fn count(&mut self, record: &Record) {
        self.offered += 1;
        self.in_budget += u64::from(record.is_in_budget());
        if let Outcome::Answered(digest) = &record.outcome {
            self.answered += 1;
            self.rungs += digest.rungs_share();
        }
    }

    /// Mean share of the asked rungs that were run.
    pub(crate) fn mean_rungs(self) -> f64 {
        self.rungs / (self.answered as f64).max(1.0)
    }

    /// Share in budget.
    pub(crate) fn share(self) -> f64 {
        share(self.in_budget, self.offered)
    }
}

impl Figures {
    /// The figures of `run`.
    pub(crate) fn of(run: &Run) -> Self {
        let seconds = run.length.as_secs_f64().max(1e-9);
        let records = &run.records;
        let count = |keep: fn(&Record) -> bool| records.iter().filter(|r| keep(r)).count() as u64;
        let in_budget = count(Record::is_in_budget);
        let by_the_server = count(Record::is_in_budget_by_the_server);
        let admitted = count(Record::is_admitted);
        let mut figures = Self {
            offered: records.len() as u64,
            offered_hz: records.len() as f64 / seconds,
            in_budget,
            in_budget_from_sending: count(Record::is_in_budget_from_sending),
            in_budget_by_the_server: by_the_server,
            admitted,
            missed_by_the_server: admitted - by_the_server,
            goodput_hz: in_budget as f64 / seconds,
            answered: 0,
            refused: BTreeMap::new(),
            expired: 0,
            mute: 0,
            broken: BTreeMap::new(),
            not_sent: 0,
            rungs: 0.0,
            prediction_error: prediction_error(records),
            latency: histogram(),
            refusing: histogram(),
            lag: histogram(),
            stages: ["send"]
                .iter()
                .chain(&STAGES)
                .chain(&["aside", "transfer"])
                .map(|stage| (*stage, histogram()))
                .collect(),
            by_budget: BTreeMap::new(),
            by_camera: BTreeMap::new(),
        };
        for record in records {
            figures.count(record);
        }
        figures.rungs /= (figures.answered as f64).max(1.0);
        figures
    }

    fn count(&mut self, record: &Record) {
        self.by_budget
            .entry(record.shot.budget)
            .or_default()
            .count(record);
        self.by_camera
            .entry(record.shot.camera)
            .or_default()
            .count(record);
        add(&mut self.lag, record.lag);
        match &record.outcome {
            Outcome::Answered(digest) => {
                self.answered += 1;
                self.rungs += digest.rungs_share();
                add(&mut self.latency, record.latency);
                let rest = record.latency.saturating_sub(record.lag + digest.total);
                let times = [record.lag].into_iter().chain(digest.stages);
                let times = times.chain([digest.aside(), rest]);
                for ((_, histogram), time) in self.stages.iter_mut().zip(times) {
                    add(histogram, time);
                }
            }
            Outcome::Refused {
                reason: Reason::Expired,
                ..
            } => self.expired += 1,
            Outcome::Refused { reason, says_when } => {
                *self.refused.entry(reason_name(*reason)).or_default() += 1;
                add(&mut self.refusing, record.decided);
                let is_infeasible = *reason == Reason::DeadlineInfeasible;
                self.mute += u64::from(is_infeasible && !says_when);
            }
            Outcome::Broken(why) => *self.broken.entry(why.clone()).or_default() += 1,
            Outcome::NotSent => self.not_sent += 1,
        }
    }

    /// Share of the offered frames in budget.
    pub(crate) fn attainment(&self) -> f64 {
        share(self.in_budget, self.offered)
    }

    /// Share of the offered frames in budget, counted from when they were sent.
    pub(crate) fn attainment_from_sending(&self) -> f64 {
        share(self.in_budget_from_sending, self.offered)
    }

    /// The share in budget that is proven.
    pub(crate) fn proven_attainment(&self) -> f64 {
        proven_share(self.offered, self.offered - self.in_budget)
    }

    /// Share of the offered frames in budget by the server's clock.
    pub(crate) fn attainment_by_the_server(&self) -> f64 {
        share(self.in_budget_by_the_server, self.offered)
    }

    /// Share of the admitted frames that missed their deadline by the server's clock.
    pub(crate) fn admitted_misses(&self) -> f64 {
        share(self.missed_by_the_server, self.admitted)
    }

    /// Share of the offered frames that were refused at once, whatever the reason.
    pub(crate) fn refused_share(&self) -> f64 {
        share(self.refused.values().sum(), self.offered)
    }

    /// An upper bound of the latency of the share `percentile` of the results, if they are enough for one.
    pub(crate) fn latency_bound(&self, percentile: f64) -> Option<Duration> {
        let out = discardable(percentile, self.latency.len())?;
        Some(quantile(&self.latency, 1.0 - share(out, self.latency.len())))
    }

    /// Jain's index over what every camera got in budget, relative to its fair (max-min) share of all that was.
    pub(crate) fn fairness(&self) -> f64 {
        let demands: Vec<f64> = self.by_camera.values().map(|part| part.offered as f64).collect();
        let fair = fair_shares(self.in_budget as f64, &demands);
        let got: Vec<f64> = self
            .by_camera
            .values()
            .zip(&fair)
            .map(|(part, fair)| part.in_budget as f64 / fair.max(1e-9))
            .collect();
        jain(&got)
    }

    /// Share in budget of all cameras but the first.
    pub(crate) fn others(&self) -> f64 {
        let others = || self.by_camera.iter().filter(|(camera, _)| **camera > 0);
        share(
            others().map(|(_, part)| part.in_budget).sum(),
            others().map(|(_, part)| part.offered).sum(),
        )
    }
}

/// How long after `end` of a burst until a second begins of whose frames 99 % are in budget; `None` if that isn't seen.
pub(crate) fn recovery(records: &[Record], end: Duration) -> Option<Duration> {
    let mut after: Vec<&Record> = records.iter().filter(|r| r.shot.at >= end).collect();
    after.sort_by_key(|record| record.shot.at);
    let last = after.last()?.shot.at;
    (0..after.len())
        .map(|first| (first, after[first].shot.at))
        .take_while(|(_, at)| *at + RECOVERED <= last)
        .find(|&(first, at)| {
            let mut part = Part::default();
            for record in after[first..].iter().take_while(|r| r.shot.at < at + RECOVERED) {
                part.count(record);
            }
            part.share() >= RECOVERED_SHARE
        })
        .map(|(_, at)| at - end)
}

fn prediction_error(records: &[Record]) -> Option<f64> {
    let mut errors: Vec<f64> = records
        .iter()
        .filter_map(|record| match &record.outcome {
            Outcome::Answered(digest) if !digest.actual.is_zero() => Some(digest),
            _ => None,
        })
        .skip(LEARNING)
        .map(|digest| digest.predicted.as_secs_f64() / digest.actual.as_secs_f64() - 1.0)
        .map(f64::abs)
        .collect();
    errors.sort_by(f64::total_cmp);
    let rank = (errors.len() * 95).div_ceil(100);
    errors.get(rank.checked_sub(1)?).copied()
}

fn reason_name(reason: Reason) -> &'static str {
    reason.as_str_name().trim_start_matches("REASON_")
}

fn share(part: u64, whole: u64) -> f64 {
    part as f64 / (whole as f64).max(1.0)
}

/// Microseconds with three digits, up to 10 minutes.
fn histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, 600_000_000, 3).expect("the bounds and digits are in the library's ranges")
}

fn add(histogram: &mut Histogram<u64>, time: Duration) {
    histogram.saturating_record(u64::try_from(time.as_micros()).unwrap_or(u64::MAX));
}

/// The value that the share `quantile` of a histogram doesn't exceed.
pub(crate) fn quantile(histogram: &Histogram<u64>, quantile: f64) -> Duration {
    Duration::from_micros(histogram.value_at_quantile(quantile))
}

#[cfg(test)]
mod tests;
