//! Clients that go on sending pairs, whatever becomes of them, and remember what did.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use stereo_client::{Client, ClientError, Fleet, v1};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval};

use crate::table::{Recovery, Row};

/// After so long nothing will happen any more.
const NEVER: Duration = Duration::from_secs(60);
/// Time between two looks at what came back.
const LOOK_EVERY: Duration = Duration::from_millis(2);
/// How long a client that found nobody waits before it tries again.
const AGAIN_AFTER: Duration = Duration::from_millis(20);

/// What became of a pair.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Fate {
    /// A result, within its budget or after it.
    Result { in_time: bool },
    /// A refusal, by its reason.
    Refused(String),
    /// Nobody took it.
    NotTaken,
    /// It was sent, and then there was no answer.
    Cut(String),
}

/// A pair and what became of it.
#[derive(Debug, Clone)]
struct Answer {
    sent: Instant,
    took: Duration,
    fate: Fate,
}

/// Where pairs are sent.
#[derive(Debug, Clone)]
pub(crate) enum Target {
    /// One server over HTTP.
    Http(Client),
    /// All servers of a Zenoh network.
    Zenoh(Fleet),
}

impl Target {
    /// The server at `url`.
    pub(crate) fn http(url: &str) -> Result<Self> {
        Ok(Self::Http(Client::new(url)?))
    }

    async fn send(&self, pair: &v1::StereoRequest) -> Answer {
        let sent = Instant::now();
        let outcome = match self {
            Self::Http(client) => client.match_pair(pair).await,
            Self::Zenoh(fleet) => fleet.match_pair(pair).await,
        };
        let fate = match outcome {
            Ok(result) => Fate::Result {
                in_time: result.report.is_some_and(|report| report.deadline_met),
            },
            Err(ClientError::Refused(status)) => {
                let reason = status.reason().as_str_name();
                Fate::Refused(reason.trim_start_matches("REASON_").to_owned())
            }
            Err(ClientError::Unreachable { .. }) => Fate::NotTaken,
            Err(why) => Fate::Cut(why.to_string()),
        };
        Answer {
            sent,
            took: sent.elapsed(),
            fate,
        }
    }
}

/// How pairs follow each other.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Pace {
    /// So many at a time, each client its next as soon as it has an answer.
    Closed(usize),
    /// One each so often, whatever became of those before.
    Every(Duration),
}

/// Clients at work.
pub(crate) struct Clients {
    answers: Arc<Mutex<Vec<Answer>>>,
    stop: watch::Sender<bool>,
    tasks: JoinSet<Result<()>>,
}

impl Clients {
    /// Starts to send `pair` again and again.
    pub(crate) fn start(target: &Target, pair: &v1::StereoRequest, pace: Pace) -> Self {
        let answers = Arc::new(Mutex::new(Vec::new()));
        let (stop, stopped) = watch::channel(false);
        let mut tasks = JoinSet::new();
        match pace {
            Pace::Closed(count) => {
                for _ in 0..count {
                    let (target, pair) = (target.clone(), pair.clone());
                    tasks.spawn(in_turn(target, pair, Arc::clone(&answers), stopped.clone()));
                }
            }
            Pace::Every(period) => {
                let (target, pair) = (target.clone(), pair.clone());
                tasks.spawn(paced(target, pair, period, Arc::clone(&answers), stopped));
            }
        }
        Self { answers, stop, tasks }
    }

    /// Waits for a result of a pair that was sent after `since`: the time from then until it was there.
    pub(crate) async fn served_again(&self, since: Instant) -> Result<Duration> {
        self.until(|answers| {
            let is_one =
                |answer: &&Answer| answer.sent >= since && matches!(answer.fate, Fate::Result { .. });
            let first = answers
                .iter()
                .filter(is_one)
                .map(|answer| answer.sent + answer.took)
                .min();
            first.map(|at| at - since)
        })
        .await
    }

    /// The longest time without a result, between the last one before `moment` and the first one after it.
    pub(crate) fn gap_around(&self, moment: Instant) -> Duration {
        let answers = self.answers.lock().unwrap_or_else(PoisonError::into_inner);
        let results = answers
            .iter()
            .filter(|answer| matches!(answer.fate, Fate::Result { .. }));
        let times: Vec<Instant> = results.map(|answer| answer.sent + answer.took).collect();
        let before = times
            .iter()
            .copied()
            .filter(|&at| at <= moment)
            .max()
            .unwrap_or(moment);
        let after = times
            .iter()
            .copied()
            .filter(|&at| at > moment)
            .min()
            .unwrap_or(moment);
        after - before
    }

    /// Waits until so many pairs have got a result.
    pub(crate) async fn have(&self, count: usize) -> Result<()> {
        self.until(|answers| {
            let results = answers
                .iter()
                .filter(|answer| matches!(answer.fate, Fate::Result { .. }));
            (results.count() >= count).then_some(())
        })
        .await
    }

    /// Waits for the first refusal of this reason: when it came.
    pub(crate) async fn refused(&self, reason: &str) -> Result<Instant> {
        self.until(|answers| {
            let refused = |answer: &&Answer| matches!(&answer.fate, Fate::Refused(given) if given == reason);
            let first = answers.iter().find(refused);
            first.map(|answer| answer.sent + answer.took)
        })
        .await
    }

    async fn until<T>(&self, look: impl Fn(&[Answer]) -> Option<T>) -> Result<T> {
        let patience = Instant::now() + NEVER;
        loop {
            let found = look(&self.answers.lock().unwrap_or_else(PoisonError::into_inner));
            match found {
                Some(found) => return Ok(found),
                None if Instant::now() > patience => {
                    bail!("what was waited for did not come: {}", self.tally())
                }
                None => tokio::time::sleep(LOOK_EVERY).await,
            }
        }
    }

    /// What has come back until now.
    pub(crate) fn tally(&self) -> Tally {
        let answers = self.answers.lock().unwrap_or_else(PoisonError::into_inner);
        Tally::of(&answers)
    }

    /// Sends nothing more, and waits for what is under way.
    pub(crate) async fn stop(mut self) -> Result<Tally> {
        self.stop.send_replace(true);
        let rest = async {
            while let Some(ended) = self.tasks.join_next().await {
                ended??;
            }
            anyhow::Ok(())
        };
        tokio::time::timeout(NEVER, rest)
            .await
            .context("the last pairs were not answered")??;
        Ok(self.tally())
    }
}

fn keep(answers: &Mutex<Vec<Answer>>, answer: Answer) {
    answers
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .push(answer);
}

async fn in_turn(
    target: Target,
    pair: v1::StereoRequest,
    answers: Arc<Mutex<Vec<Answer>>>,
    stopped: watch::Receiver<bool>,
) -> Result<()> {
    while !*stopped.borrow() {
        let answer = target.send(&pair).await;
        let nobody = answer.fate == Fate::NotTaken;
        keep(&answers, answer);
        if nobody {
            tokio::time::sleep(AGAIN_AFTER).await;
        }
    }
    Ok(())
}

async fn paced(
    target: Target,
    pair: v1::StereoRequest,
    period: Duration,
    answers: Arc<Mutex<Vec<Answer>>>,
    mut stopped: watch::Receiver<bool>,
) -> Result<()> {
    let pair = Arc::new(pair);
    let mut ticks = interval(period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Burst);
    let mut under_way = JoinSet::new();
    loop {
        tokio::select! {
            _ = stopped.wait_for(|&stop| stop) => break,
            _ = ticks.tick() => {}
        }
        let (target, pair, answers) = (target.clone(), Arc::clone(&pair), Arc::clone(&answers));
        under_way.spawn(async move { keep(&answers, target.send(&pair).await) });
        while let Some(ended) = under_way.try_join_next() {
            ended?;
        }
    }
    while let Some(ended) = under_way.join_next().await {
        ended?;
    }
    Ok(())
}

/// What became of all pairs.
#[derive(Debug, Clone, Default)]
pub(crate) struct Tally {
    /// Results, and those of them that came after their budget.
    pub(crate) results: u64,
    pub(crate) late: u64,
    /// Refusals by reason.
    pub(crate) refused: BTreeMap<String, u64>,
    /// Pairs that nobody took.
    pub(crate) not_taken: u64,
    /// Pairs without an answer, and why.
    pub(crate) cut: u64,
    why_cut: Option<String>,
    /// How long results took, from the shortest to the longest.
    times: Vec<Duration>,
}

impl Tally {
    fn of(answers: &[Answer]) -> Self {
        let mut tally = Self::default();
        for answer in answers {
            match &answer.fate {
                Fate::Result { in_time } => {
                    tally.results += 1;
                    tally.late += u64::from(!in_time);
                    tally.times.push(answer.took);
                }
                Fate::Refused(reason) => *tally.refused.entry(reason.clone()).or_default() += 1,
                Fate::NotTaken => tally.not_taken += 1,
                Fate::Cut(why) => {
                    tally.cut += 1;
                    tally.why_cut.get_or_insert_with(|| why.clone());
                }
            }
        }
        tally.times.sort_unstable();
        tally
    }

    /// What the first pair that was cut off got to know.
    pub(crate) fn why_cut(&self) -> &str {
        self.why_cut.as_deref().unwrap_or_default()
    }

    /// The row of a fault through which everything had to be answered: nobody was cut off or turned away by the network.
    pub(crate) fn row(&self, fault: &str, recovery: Recovery) -> Row {
        Row {
            fault: fault.to_owned(),
            saw: self.to_string(),
            recovery,
            lost: self.cut + self.not_taken,
            promised: 0,
            why_lost: self.why_cut().to_owned(),
        }
    }

    /// Refusals of this reason.
    pub(crate) fn refused_as(&self, reason: &str) -> u64 {
        self.refused.get(reason).copied().unwrap_or_default()
    }

    /// Refusals of any reason.
    pub(crate) fn all_refused(&self) -> u64 {
        self.refused.values().sum()
    }

    /// How long results took.
    pub(crate) fn percentiles(&self) -> String {
        let at = |share: usize| {
            let place = (self.times.len() * share / 100).min(self.times.len().saturating_sub(1));
            let time = self.times.get(place).copied().unwrap_or_default();
            format!("{:.0} ms", 1e3 * time.as_secs_f64())
        };
        format!("results after {} (p50), {} (p99)", at(50), at(99))
    }
}

impl std::fmt::Display for Tally {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} results", self.results)?;
        if self.late > 0 {
            write!(f, ", {} of them late", self.late)?;
        }
        for (reason, count) in &self.refused {
            write!(f, ", {count} {reason}")?;
        }
        if self.cut > 0 {
            write!(f, ", {} cut off", self.cut)?;
        }
        if self.not_taken > 0 {
            write!(f, ", {} found nobody", self.not_taken)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fate_is_told() {
        let answer = |took, fate| Answer {
            sent: Instant::now(),
            took: Duration::from_millis(took),
            fate,
        };
        let tally = Tally::of(&[
            answer(10, Fate::Result { in_time: true }),
            answer(30, Fate::Result { in_time: false }),
            answer(1, Fate::Refused("EXPIRED".to_owned())),
            answer(1, Fate::NotTaken),
            answer(1, Fate::Cut("reset".to_owned())),
        ]);
        let text = tally.to_string();
        assert_eq!(
            text,
            "2 results, 1 of them late, 1 EXPIRED, 1 cut off, 1 found nobody"
        );
        assert_eq!(tally.percentiles(), "results after 30 ms (p50), 30 ms (p99)");
        assert_eq!((tally.all_refused(), tally.why_cut()), (1, "reset"));
    }
}
