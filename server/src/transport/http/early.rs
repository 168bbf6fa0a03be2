//! Refusals before a body is read: a request that can't be met is not worth its upload.
//!
//! By its length alone a request may want next to nothing (a tiny region of a large image), so a stranger is refused only for what is
//! promised to others. A camera's frames are all alike: if the same sender has lately sent bodies of exactly this length, this one is
//! taken to be like one of those, and is refused if none of them could be met. A body with other options has another length, nearly
//! always.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use stereo_scheduler::{ClientId, JobSpec, Priority, Urgency};

use crate::dispatch::{Kind, least_work};
use crate::service::Service;
use crate::status::ServiceError;

/// Senders and lengths that are remembered at one time.
const CAPACITY: usize = 1024;
/// Kinds of requests that are remembered of each.
const KINDS: usize = 4;
/// How long a guess is good. After that one body is read again, so that a sender whose requests have become cheaper is not refused
/// for ever.
const LIFETIME: Duration = Duration::from_secs(1);

/// Whose share a request without a camera counts against, and the length of the body.
pub(super) type Sender = (String, u64);
/// What a request was like, and when.
type Seen = (Instant, JobSpec<Kind>);

/// What the last requests were like.
#[derive(Default)]
pub(super) struct Hints {
    seen: Mutex<HashMap<Sender, Vec<Seen>>>,
}

impl Hints {
    /// Whether a request is worth reading: it has `budget` by its headers, and a body of a known length.
    ///
    /// # Errors
    /// Why not.
    pub(super) fn assess(
        &self,
        service: &Service,
        sender: &Sender,
        budget: Duration,
        received_at: Instant,
    ) -> Result<(), ServiceError> {
        let at = service.scheduler_time(received_at + budget);
        self.assess_each(sender, |mut spec| {
            let priority = match spec.urgency {
                Urgency::Deadline { priority, .. } => priority,
                Urgency::Background => Priority::default(),
            };
            spec.urgency = Urgency::Deadline { at, priority };
            service.assess(&spec, budget, received_at)
        })
    }

    /// Whether any of what the request may be is fine with `assess`.
    fn assess_each(
        &self,
        sender: &Sender,
        assess: impl Fn(JobSpec<Kind>) -> Result<(), ServiceError>,
    ) -> Result<(), ServiceError> {
        let known = self.recall(sender);
        if known.is_empty() {
            return assess(JobSpec {
                client: ClientId(0),
                weight: 1,
                stream: None,
                urgency: Urgency::Background,
                work: least_work(),
                half: None,
                is_mesh_optional: false,
            });
        }
        let mut outcome = Ok(());
        for spec in known {
            outcome = assess(spec);
            if outcome.is_ok() {
                break;
            }
        }
        outcome
    }

    /// What the sender's request turned out to be.
    pub(super) fn remember(&self, sender: Sender, spec: JobSpec<Kind>) {
        // One without a deadline can be met at any time.
        if spec.urgency == Urgency::Background {
            return;
        }
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        if seen.len() >= CAPACITY {
            seen.retain(|_, kinds| kinds.iter().any(is_fresh));
        }
        if seen.len() >= CAPACITY && !seen.contains_key(&sender) {
            return;
        }
        let kinds = seen.entry(sender).or_default();
        kinds.retain(|kind| is_fresh(kind) && kind.1.work != spec.work);
        if kinds.len() >= KINDS {
            kinds.remove(0);
        }
        kinds.push((Instant::now(), spec));
    }

    fn recall(&self, sender: &Sender) -> Vec<JobSpec<Kind>> {
        let seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        let kinds = seen.get(sender).into_iter().flatten();
        kinds
            .filter(|kind| is_fresh(kind))
            .map(|&(_, spec)| spec)
            .collect()
    }
}

fn is_fresh((at, _): &Seen) -> bool {
    at.elapsed() < LIFETIME
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dispatch::work;
    use crate::job::FrameRequest;
    use crate::pool::dummy_request;

    const WHOLE_PX: u32 = 640 * 480;

    fn sender() -> Sender {
        ("192.0.2.1".to_owned(), 614_400)
    }

    /// A request of class deadline, as the scheduler has it.
    fn spec(request: &FrameRequest) -> JobSpec<Kind> {
        JobSpec {
            client: ClientId(0),
            weight: 1,
            stream: None,
            urgency: Urgency::Deadline {
                at: Duration::from_secs(1),
                priority: Priority::Normal,
            },
            work: work(request, false),
            half: None,
            is_mesh_optional: false,
        }
    }

    /// A server that has time for everything but whole frames.
    fn busy(spec: JobSpec<Kind>) -> Result<(), ServiceError> {
        match spec.work.units < WHOLE_PX {
            true => Ok(()),
            false => Err(ServiceError::Superseded),
        }
    }

    #[test]
    fn a_stranger_is_not_refused_for_what_it_may_not_want() {
        assert_eq!(Hints::default().assess_each(&sender(), busy), Ok(()));
    }

    #[test]
    fn a_body_like_one_that_can_not_be_met_is_refused_and_a_tiny_region_is_not() {
        let hints = Hints::default();
        let whole = spec(&dummy_request());
        hints.remember(sender(), whole);
        assert!(hints.assess_each(&sender(), busy).is_err());
        // The same with a region in its options is longer by that.
        let mut longer = sender();
        longer.1 += 6;
        assert_eq!(hints.assess_each(&longer, busy), Ok(()));
        // And even at the same length the cheapest of the sender's requests counts.
        let tiny = JobSpec {
            work: least_work(),
            ..whole
        };
        hints.remember(sender(), tiny);
        hints.remember(sender(), whole);
        assert_eq!(hints.assess_each(&sender(), busy), Ok(()));
    }

    #[test]
    fn what_is_remembered_is_bounded_and_says_nothing_of_the_background_class() {
        let hints = Hints::default();
        let mut request = dummy_request();
        for rungs in 1..8 {
            request.options.max_iterations = Some(rungs);
            for bytes in 0..2000 {
                hints.remember((String::new(), bytes), spec(&request));
            }
        }
        let seen = hints.seen.lock().unwrap();
        assert!(seen.len() <= CAPACITY && seen.values().all(|kinds| kinds.len() <= KINDS));
        drop(seen);
        let background = JobSpec {
            urgency: Urgency::Background,
            ..spec(&request)
        };
        hints.remember(sender(), background);
        assert_eq!(hints.recall(&sender()).len(), 0);
    }
}
