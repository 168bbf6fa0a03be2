//! The bounded queue: the earliest deadline first; jobs of one deadline in order of arrival.

use std::collections::BTreeMap;
use std::time::Duration;

/// Names a waiting job, so that it can be taken back. Never reused within one queue.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticket {
    deadline: Duration,
    arrival: u64,
}

/// The queue holds as many jobs as it may; the job is handed back.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct QueueFull<J> {
    /// The job that found no place.
    pub job: J,
    /// How many jobs are waiting.
    pub capacity: usize,
}

/// Jobs waiting for a worker, at most `capacity` of them.
///
/// Every operation costs O(log n); memory grows with the jobs that wait and never beyond the capacity.
#[derive(Debug)]
pub struct DeadlineQueue<J> {
    waiting: BTreeMap<Ticket, J>,
    capacity: usize,
    arrivals: u64,
}

impl<J> DeadlineQueue<J> {
    /// An empty queue for at most `capacity` jobs.
    #[must_use]
    pub fn new(capacity: usize) -> Self {
        Self {
            waiting: BTreeMap::new(),
            capacity,
            arrivals: 0,
        }
    }

    /// Lets `job` wait for a worker until `deadline`.
    ///
    /// # Errors
    /// [`QueueFull`] with the job in it when `capacity` jobs wait already. Whether those can still be served is for the caller to
    /// find out first, with [`take_expired`](Self::take_expired).
    pub fn push(&mut self, deadline: Duration, job: J) -> Result<Ticket, QueueFull<J>> {
        if self.waiting.len() >= self.capacity {
            return Err(QueueFull {
                job,
                capacity: self.capacity,
            });
        }
        let ticket = Ticket {
            deadline,
            arrival: self.arrivals,
        };
        self.arrivals += 1;
        self.waiting.insert(ticket, job);
        Ok(ticket)
    }

    /// The job that is due first, live or not.
    pub fn pop(&mut self) -> Option<J> {
        self.waiting.pop_first().map(|(_, job)| job)
    }

    /// Takes a waiting job back; `None` if it has left the queue already.
    pub fn remove(&mut self, ticket: Ticket) -> Option<J> {
        self.waiting.remove(&ticket)
    }

    /// Takes out every job whose deadline is at or before `now`, the earliest first.
    pub fn take_expired(&mut self, now: Duration) -> Vec<J> {
        let mut expired = Vec::new();
        while let Some(first) = self.waiting.first_entry()
            && first.key().deadline <= now
        {
            expired.push(first.remove());
        }
        expired
    }

    /// How many jobs wait.
    #[must_use]
    pub fn len(&self) -> usize {
        self.waiting.len()
    }

    /// Whether no job waits.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn the_earliest_deadline_is_popped_first_and_equal_ones_in_order_of_arrival() {
        let mut queue = DeadlineQueue::new(4);
        for (deadline, job) in [(30, "late"), (10, "first"), (20, "second"), (10, "first too")] {
            queue.push(ms(deadline), job).unwrap();
        }
        let popped: Vec<_> = std::iter::from_fn(|| queue.pop()).collect();
        assert_eq!(popped, ["first", "first too", "second", "late"]);
    }

    #[test]
    fn a_full_queue_hands_the_job_back_and_has_room_again_after_a_removal() {
        let mut queue = DeadlineQueue::new(1);
        let ticket = queue.push(ms(1), 'a').unwrap();
        assert_eq!(
            queue.push(ms(1), 'b'),
            Err(QueueFull {
                job: 'b',
                capacity: 1
            })
        );
        assert_eq!(queue.remove(ticket), Some('a'));
        assert_eq!(queue.remove(ticket), None);
        assert!(queue.push(ms(1), 'b').is_ok());
    }

    #[test]
    fn a_job_expires_at_its_deadline_and_not_before() {
        let mut queue = DeadlineQueue::new(2);
        queue.push(ms(10), 'a').unwrap();
        queue.push(ms(11), 'b').unwrap();
        assert!(queue.take_expired(ms(9)).is_empty());
        assert_eq!(queue.take_expired(ms(10)), ['a']);
        assert_eq!(queue.len(), 1);
    }
}
