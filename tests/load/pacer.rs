//! Which frame goes out now: pure, with time as an argument.
//!
//! A frame keeps the time it was due, however late it can be sent: a server that stalls the sender makes the frames
//! behind it late too, and hiding that would be coordinated omission.

use std::iter::Peekable;
use std::time::Duration;

use crate::plan::Shot;

/// Hands out frames when they are due, and never has more than a number of them under way.
pub(crate) struct Pacer<I: Iterator<Item = Shot>> {
    shots: Peekable<I>,
    end: Duration,
    under_way: usize,
    limit: usize,
}

/// What to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Step {
    /// Send this frame now.
    Send(Shot),
    /// This one is due, and too many are under way.
    Skip(Shot),
    /// Nothing is due before this moment.
    Wait(Duration),
    /// All frames have been sent; some are still under way.
    Drain,
    /// All frames have been sent and settled.
    Done,
}

impl<I: Iterator<Item = Shot>> Pacer<I> {
    /// Hands out `shots`, with up to `limit` under way.
    pub(crate) fn new(shots: I, limit: usize) -> Self {
        Self {
            shots: shots.peekable(),
            end: Duration::MAX,
            under_way: 0,
            limit,
        }
    }

    /// What to do at `now`.
    pub(crate) fn step(&mut self, now: Duration) -> Step {
        let Some(&next) = self.shots.peek().filter(|shot| shot.at < self.end) else {
            return if self.under_way == 0 {
                Step::Done
            } else {
                Step::Drain
            };
        };
        if next.at > now {
            return Step::Wait(next.at);
        }
        self.shots.next();
        if self.under_way == self.limit {
            return Step::Skip(next);
        }
        self.under_way += 1;
        Step::Send(next)
    }

    /// A frame that was sent is no longer under way.
    pub(crate) fn settle(&mut self) {
        self.under_way -= 1;
    }

    /// Sends nothing that is due at `end` or later.
    pub(crate) fn stop_at(&mut self, end: Duration) {
        self.end = self.end.min(end);
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::{Pacer, Step};
    use crate::plan::Shot;

    const MS: Duration = Duration::from_millis(1);

    fn every_10_ms(count: u32) -> impl Iterator<Item = Shot> {
        (0..count).map(|i| Shot {
            at: 10 * i * MS,
            camera: 0,
            budget: 50 * MS,
        })
    }

    #[test]
    fn frames_go_out_when_they_are_due_whatever_is_under_way() {
        let mut pacer = Pacer::new(every_10_ms(3), 100);
        let mut now = Duration::ZERO;
        let mut sent = Vec::new();
        loop {
            match pacer.step(now) {
                Step::Send(shot) => sent.push((now, shot.at)),
                Step::Wait(until) => now = until,
                other => {
                    assert_eq!(other, Step::Drain, "three are under way");
                    break;
                }
            }
        }
        assert_eq!(sent, [0, 10, 20].map(|ms| (ms * MS, ms * MS)));
        for _ in 0..3 {
            pacer.settle();
        }
        assert_eq!(pacer.step(now), Step::Done);
    }

    #[test]
    fn a_sender_that_was_held_up_catches_up_and_the_frames_keep_the_time_they_were_due() {
        let mut pacer = Pacer::new(every_10_ms(4), 100);
        // Held up for 25 ms: three frames are due at once, and the latency of each counts from its own time.
        let due: Vec<Step> = (0..4).map(|_| pacer.step(25 * MS)).collect();
        let send = |ms| {
            Step::Send(Shot {
                at: ms * MS,
                camera: 0,
                budget: 50 * MS,
            })
        };
        assert_eq!(due, [send(0), send(10), send(20), Step::Wait(30 * MS)]);
    }

    #[test]
    fn what_exceeds_the_limit_is_skipped_and_said_so() {
        let mut pacer = Pacer::new(every_10_ms(4), 2);
        let late = 100 * MS;
        assert!(matches!(pacer.step(late), Step::Send(_)));
        assert!(matches!(pacer.step(late), Step::Send(_)));
        assert!(matches!(pacer.step(late), Step::Skip(shot) if shot.at == 20 * MS));
        pacer.settle();
        assert!(matches!(pacer.step(late), Step::Send(shot) if shot.at == 30 * MS));
    }

    #[test]
    fn nothing_is_sent_after_the_end() {
        let mut pacer = Pacer::new(every_10_ms(1_000_000), 9);
        pacer.stop_at(10 * MS);
        assert!(matches!(pacer.step(100 * MS), Step::Send(_)));
        assert_eq!(pacer.step(100 * MS), Step::Drain);
        pacer.stop_at(50 * MS);
        assert_eq!(pacer.step(100 * MS), Step::Drain, "an end is never put off");
    }
}
