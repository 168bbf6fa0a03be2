//! What became of everything that was sent, counted where it is sent.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use stereo_client::{ClientError, v1};

/// Kinds of failures that are kept by their text.
const MOST_KINDS: usize = 20;

/// Counts since the start.
#[derive(Debug, Default)]
pub(super) struct Tally {
    offered: AtomicU64,
    in_budget: AtomicU64,
    batched: AtomicU64,
    filmed: AtomicU64,
    refused_as_bad: AtomicU64,
    broken: AtomicU64,
    why_broken: Mutex<BTreeMap<String, u64>>,
}

/// The counts at one moment.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Counts {
    /// Single pairs with a deadline, over HTTP and Zenoh.
    pub(super) offered: u64,
    /// Those that got a result within it, by the server's clock.
    pub(super) in_budget: u64,
    /// Pairs of batches that got a result.
    pub(super) batched: u64,
    /// Frames that cameras sent.
    pub(super) filmed: u64,
    /// Bodies that are none, and were refused as such.
    pub(super) refused_as_bad: u64,
    /// Whatever was answered as nothing should be, or not at all.
    pub(super) broken: u64,
}

impl Tally {
    /// A pair was sent, and this came back.
    pub(super) fn single(&self, answer: Result<v1::StereoResult, ClientError>) {
        add(&self.offered);
        match answer {
            Ok(result) if result.report.as_ref().is_some_and(|report| report.deadline_met) => {
                add(&self.in_budget)
            }
            Ok(_) => {}
            // Too late or too much: not in budget, and said so.
            Err(ClientError::Refused(status)) if status.code != 500 && status.code != 400 => {}
            Err(why) => self.broke(&why),
        }
    }

    /// A pair was due while too many were under way.
    pub(super) fn not_sent(&self) {
        add(&self.offered);
    }

    /// A pair of a batch was answered.
    pub(super) fn batched(&self, reply: Result<v1::BatchReply, ClientError>) {
        match reply.map(|reply| reply.outcome) {
            Ok(Some(v1::batch_reply::Outcome::Result(_))) => add(&self.batched),
            Ok(other) => self.broke(&format!("a pair of a batch: {other:?}")),
            Err(why) => self.broke(&why),
        }
    }

    /// A camera sent a frame.
    pub(super) fn filmed(&self) {
        add(&self.filmed);
    }

    /// A body that is none was refused.
    pub(super) fn refused_as_bad(&self) {
        add(&self.refused_as_bad);
    }

    /// Something failed that must not.
    pub(super) fn broke(&self, why: &dyn std::fmt::Display) {
        add(&self.broken);
        let mut kinds = self.why_broken.lock().unwrap_or_else(PoisonError::into_inner);
        let why = why.to_string();
        if kinds.len() < MOST_KINDS || kinds.contains_key(&why) {
            *kinds.entry(why).or_default() += 1;
        }
    }

    /// What failed, and how often.
    pub(super) fn why_broken(&self) -> BTreeMap<String, u64> {
        self.why_broken
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    pub(super) fn counts(&self) -> Counts {
        let now = |count: &AtomicU64| count.load(Ordering::Relaxed);
        Counts {
            offered: now(&self.offered),
            in_budget: now(&self.in_budget),
            batched: now(&self.batched),
            filmed: now(&self.filmed),
            refused_as_bad: now(&self.refused_as_bad),
            broken: now(&self.broken),
        }
    }
}

fn add(count: &AtomicU64) {
    count.fetch_add(1, Ordering::Relaxed);
}
