//! Refusals before a body is read: a request that can't be met is not worth its upload. What it will ask for is guessed from its length,
//! and from the last request of the same sender with that length, because a camera's frames are all alike.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use stereo_scheduler::{ClientId, JobSpec, Priority, Urgency};

use crate::dispatch::{Kind, least_work};
use crate::service::Service;
use crate::status::ServiceError;

/// Senders that are remembered at one time.
const CAPACITY: usize = 1024;
/// How long a guess is good. After that one body is read again, so that a sender whose requests have become cheaper is not refused
/// for ever.
const LIFETIME: Duration = Duration::from_secs(1);
/// Lengths closer than this are the same: a frame's number takes a few bytes more or less.
const LENGTH_STEP: u64 = 64;

/// An address, and the length of the body.
type Sender = (String, u64);

/// What the last requests were like.
#[derive(Default)]
pub(super) struct Hints {
    seen: Mutex<HashMap<Sender, (Instant, JobSpec<Kind>)>>,
}

impl Hints {
    /// Whether a request is worth reading: it has `budget` by its headers, and a body of a known length.
    pub(super) fn assess(
        &self,
        service: &Service,
        sender: &Sender,
        budget: Duration,
        received_at: Instant,
    ) -> Result<(), ServiceError> {
        let mut spec = self.recall(sender).unwrap_or_else(|| JobSpec {
            client: ClientId(0),
            weight: 1,
            stream: None,
            urgency: Urgency::Background,
            work: least_work(sender.1),
            half: None,
            is_mesh_optional: false,
        });
        let priority = match spec.urgency {
            Urgency::Deadline { priority, .. } => priority,
            Urgency::Background => Priority::default(),
        };
        let at = service.scheduler_time(received_at + budget);
        spec.urgency = Urgency::Deadline { at, priority };
        service.assess(&spec, budget, received_at)
    }

    /// What the sender's request turned out to be.
    pub(super) fn remember(&self, sender: Sender, spec: JobSpec<Kind>) {
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        if seen.len() >= CAPACITY {
            seen.retain(|_, (at, _)| at.elapsed() < LIFETIME);
        }
        if seen.len() < CAPACITY {
            seen.insert(rounded(&sender), (Instant::now(), spec));
        }
    }

    fn recall(&self, sender: &Sender) -> Option<JobSpec<Kind>> {
        let seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        let (at, spec) = seen.get(&rounded(sender))?;
        (at.elapsed() < LIFETIME).then_some(*spec)
    }
}

fn rounded((address, bytes): &Sender) -> Sender {
    (address.clone(), bytes / LENGTH_STEP)
}
