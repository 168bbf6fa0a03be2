//! Places in the queue: who takes one, and who gives his up.

use std::time::Duration;

use super::{Item, JobSpec, Kind, Priority, Scheduler, Ticket, Urgency, Waiting};
use crate::answer::{DropReason, Dropped};
use crate::timeline::Load;

/// A job that is out of the queue for a moment.
pub(super) type Lifted<K, J> = (Ticket, Load, Waiting<K, J>);

impl<K: Kind, J> Scheduler<K, J> {
    /// Drops the waiting job of the same stream, and ends the refinement of the running one.
    pub(super) fn supersede(&mut self, spec: &JobSpec<K>, dropped: &mut Vec<Dropped<J>>) {
        let older = spec.stream.and_then(|stream| self.streams.get(&stream).copied());
        if let Some(ticket) = older
            && let Some(waiting) = self.take(ticket, true)
        {
            dropped.push(Dropped {
                ticket,
                job: waiting.job,
                reason: DropReason::Superseded,
            });
        }
        self.stop_older(spec);
    }

    pub(super) fn stop_older(&mut self, spec: &JobSpec<K>) {
        if spec.stream.is_some() {
            for running in self.begun().filter(|running| running.stream == spec.stream) {
                running.is_superseded = true;
            }
        }
    }

    /// Takes a job out of the queue for a moment.
    pub(super) fn lift(&mut self, ticket: Ticket) -> Option<Lifted<K, J>> {
        let load = self.timeline.load(ticket)?;
        let waiting = self.remove(ticket)?;
        self.best_effort.remove(&ticket);
        if let Some(stream) = waiting.spec.stream {
            self.streams.remove(&stream);
        }
        Some((ticket, load, waiting))
    }

    pub(super) fn insert(&mut self, key: Ticket, load: Load, waiting: Waiting<K, J>) {
        if let Some(stream) = waiting.spec.stream {
            self.streams.insert(stream, key);
        }
        if matches!(
            waiting.spec.urgency,
            Urgency::Deadline {
                priority: Priority::BestEffort,
                ..
            }
        ) {
            self.best_effort.insert(key, ());
        }
        self.arrivals = self.arrivals.max(key.arrival + 1);
        self.timeline.insert(key, load, Item::Waiting(waiting));
    }

    /// The key of a job that comes now.
    pub(super) fn key(&self, order: Duration) -> Ticket {
        Ticket {
            order,
            arrival: self.arrivals,
        }
    }
}
