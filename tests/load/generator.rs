//! The generator: one thread that keeps the time and one that does the network's work.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use indicatif::ProgressBar;
use tokio::runtime::Runtime;

use crate::exchange::Exchange;
use crate::pacer::{Pacer, Step};
use crate::plan::{Load, Shot};
use crate::record::{Outcome, Record};
use crate::statistics::{Decision, decide};

/// Frames that a run keeps at most, for memory's sake.
const MOST_FRAMES: usize = 2_000_000;
/// Time between two looks at whether a run has said enough.
const LOOK: Duration = Duration::from_secs(1);
/// How long a run takes to get going; nothing is due before.
const RUN_UP: Duration = Duration::from_millis(20);

/// How long a run goes on.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Until {
    /// At least so long.
    pub(crate) least: Duration,
    /// At most so long.
    pub(crate) most: Duration,
    /// The share of frames in budget that is to be proven or refuted.
    pub(crate) share: f64,
}

impl Until {
    /// A run of a fixed length.
    pub(crate) fn exactly(length: Duration) -> Self {
        Self {
            least: length,
            most: length,
            share: 0.99,
        }
    }
}

/// What a run gave.
#[derive(Debug)]
pub(crate) struct Run {
    /// Every frame that was due.
    pub(crate) records: Vec<Record>,
    /// How long frames were sent.
    pub(crate) length: Duration,
}

/// Sends frames to one server.
pub(crate) struct Generator {
    runtime: Runtime,
    exchange: Arc<Exchange>,
    limit: usize,
    done: SyncSender<Record>,
    results: Receiver<Record>,
}

impl Generator {
    /// Sends through `exchange`, with up to `limit` frames under way.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub(crate) fn new(exchange: Exchange, limit: usize) -> Result<Self> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .context("can't start the network's thread")?;
        let (done, results) = sync_channel(limit);
        Ok(Self {
            runtime,
            exchange: Arc::new(exchange),
            limit,
            done,
            results,
        })
    }

    /// Sends every frame when it is due, whatever becomes of the others.
    pub(crate) fn open(&self, load: &Load, until: Until, bar: &ProgressBar) -> Run {
        let mut pacer = Pacer::new(load.shots().take(MOST_FRAMES), self.limit);
        pacer.stop_at(until.most);
        let mut records: Vec<Record> = Vec::new();
        let mut due: Vec<Duration> = Vec::new();
        let mut length = until.most;
        let mut look = until.least;
        let start = Instant::now() + RUN_UP;
        loop {
            for record in self.results.try_iter() {
                pacer.settle();
                records.push(record);
            }
            // Saturates at zero during the run-up.
            let now = start.elapsed();
            if now >= look && look < until.most {
                look += LOOK;
                bar.set_position(millis(now.min(until.most)));
                if says_enough(
                    &records,
                    &due,
                    now.saturating_sub(load.longest_budget()),
                    until.share,
                ) {
                    length = length.min(now);
                    pacer.stop_at(now);
                }
            }
            match pacer.step(now) {
                Step::Send(shot) => {
                    due.push(shot.at);
                    self.spawn(shot, start);
                }
                Step::Skip(shot) => {
                    due.push(shot.at);
                    records.push(not_sent(shot, now));
                }
                Step::Wait(next) => {
                    let wait = (start + next).saturating_duration_since(Instant::now());
                    if let Ok(record) = self.results.recv_timeout(wait) {
                        pacer.settle();
                        records.push(record);
                    }
                }
                Step::Drain => {
                    if let Ok(record) = self.results.recv_timeout(LOOK) {
                        pacer.settle();
                        records.push(record);
                    }
                }
                Step::Done => return Run { records, length },
            }
        }
    }

    /// Keeps `count` frames under way, with the cameras and budgets of `load`, until `stop` says so of the time since
    /// the start and the number of answers.
    pub(crate) fn closed(
        &self,
        count: usize,
        load: &Load,
        mut stop: impl FnMut(Duration, usize) -> bool,
    ) -> Run {
        let start = Instant::now();
        let mut records = Vec::new();
        let mut under_way = 0;
        let mut shots = load.shots();
        let mut send = || {
            shots.next().is_some_and(|shot| {
                // Due when it is sent: there is nothing to be late for.
                self.spawn(
                    Shot {
                        at: start.elapsed(),
                        ..shot
                    },
                    start,
                );
                true
            })
        };
        for _ in 0..count.min(self.limit) {
            under_way += usize::from(send());
        }
        let mut length = None;
        while under_way > 0 {
            let Ok(record) = self.results.recv() else { break };
            records.push(record);
            under_way -= 1;
            let now = start.elapsed();
            if length.is_none() && (stop(now, records.len()) || records.len() >= MOST_FRAMES) {
                length = Some((now, records.len()));
            }
            if length.is_none() {
                under_way += usize::from(send());
            }
        }
        // What was still under way at the end is no answer of that time.
        let (length, count) = length.unwrap_or((start.elapsed(), records.len()));
        records.truncate(count);
        Run { records, length }
    }

    fn spawn(&self, shot: Shot, start: Instant) {
        let (exchange, done) = (Arc::clone(&self.exchange), self.done.clone());
        self.runtime.spawn(async move {
            // There is a place for every frame that may be under way.
            drop(done.try_send(exchange.send(shot, start).await));
        });
    }
}

/// Whether the frames that were due before `before`, and so are in budget by now or never, prove or refute the claim.
/// `due` has the times of all frames so far, in order.
fn says_enough(records: &[Record], due: &[Duration], before: Duration, share: f64) -> bool {
    let frames = due.partition_point(|at| *at < before);
    let good = records
        .iter()
        .filter(|record| record.shot.at < before && record.is_in_budget());
    let misses = frames - good.count();
    decide(share, frames as u64, misses as u64) != Decision::Open
}

fn not_sent(shot: Shot, now: Duration) -> Record {
    let lag = now.saturating_sub(shot.at);
    Record {
        shot,
        lag,
        latency: lag,
        decided: Duration::ZERO,
        outcome: Outcome::NotSent,
    }
}

/// Milliseconds, for a bar.
pub(crate) fn millis(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}
