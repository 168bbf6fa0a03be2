//! Left and right images of one camera, brought together: a pure state machine.
//!
//! ```text
//! offer(side, stamp, image):
//!   older than the last pair       -> late (or, if far older, the camera has started again: forget everything)
//!   the same as one already seen   -> duplicate
//!   fits one that waits opposite   -> a pair; whatever is older on either side has lost its other half
//!   else                           -> waits, until its patience is over or too many wait
//! ```
//!
//! Two images fit if their sequence numbers are equal, or, where not both have one, if their times differ by at most the tolerance.
//! Pairs come out in order, each image is in at most one, and every image that is in none comes out with the reason.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use crate::decode::Side;
use crate::job::{PairingKey, PairingRules};

/// Images of one side that wait at one time.
pub(super) const MOST_WAITING: usize = 8;
/// An image this many frames older than the last pair was not overtaken: its camera counts from the start again.
const FRAMES_BACK_AT_RESTART: u64 = 64;
/// The same for cameras without sequence numbers.
const TIME_BACK_AT_RESTART: Duration = Duration::from_secs(1);

/// What tells which frame an image belongs to.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Stamp {
    /// Frame number.
    pub(super) sequence: Option<u64>,
    /// When it was taken, in ns since 1970 by the camera's clock.
    pub(super) time_ns: Option<i128>,
}

impl Stamp {
    /// The distance in time to another, if both have one.
    fn apart(&self, other: &Self) -> Option<Duration> {
        let nanos = (self.time_ns? - other.time_ns?).unsigned_abs();
        Some(Duration::from_nanos(u64::try_from(nanos).unwrap_or(u64::MAX)))
    }

    /// How this lies to an earlier one of the same camera.
    fn order(&self, earlier: &Self) -> Order {
        match (self.sequence, earlier.sequence) {
            (Some(own), Some(last)) => match last.checked_sub(own) {
                None => Order::Newer,
                Some(0) => Order::Same,
                Some(back) if back <= FRAMES_BACK_AT_RESTART => Order::Older,
                Some(_) => Order::Restart,
            },
            _ => match (self.time_ns, earlier.time_ns) {
                (Some(own), Some(last)) if own < last => {
                    if self
                        .apart(earlier)
                        .is_some_and(|back| back <= TIME_BACK_AT_RESTART)
                    {
                        Order::Older
                    } else {
                        Order::Restart
                    }
                }
                (Some(own), Some(last)) if own == last => Order::Same,
                _ => Order::Newer,
            },
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Order {
    Newer,
    Same,
    Older,
    Restart,
}

/// The part of a stamp that counts.
fn relevant(key: PairingKey, stamp: Stamp) -> Stamp {
    match key {
        PairingKey::Either => stamp,
        PairingKey::Sequence => Stamp {
            time_ns: None,
            ..stamp
        },
        PairingKey::Time => Stamp {
            sequence: None,
            ..stamp
        },
    }
}

fn fits(tolerance: Duration, a: &Stamp, b: &Stamp) -> bool {
    match (a.sequence, b.sequence) {
        (Some(a), Some(b)) => a == b,
        _ => a.apart(b).is_some_and(|apart| apart <= tolerance),
    }
}

/// What became of an offered image, and of others because of it.
#[derive(Debug)]
pub(super) struct Offered<T> {
    /// The left and the right image.
    pub(super) pair: Option<(T, T)>,
    /// Images that will be in no pair.
    pub(super) dropped: Vec<Dropped<T>>,
}

/// An image without its other half.
#[derive(Debug)]
pub(super) struct Dropped<T> {
    pub(super) side: Side,
    pub(super) image: T,
    pub(super) why: Unpaired,
    /// How far away in time the nearest image of the other side was, if there was one with a time.
    pub(super) nearest: Option<Duration>,
}

/// Why an image is in no pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Unpaired {
    /// Its other half did not come.
    Alone,
    /// Newer images were a pair already.
    Late,
    /// The same image had come before.
    Duplicate,
    /// It says neither which frame it is of nor when it was taken.
    Unstamped,
}

impl Unpaired {
    /// As metrics and people have it.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Alone => "alone",
            Self::Late => "late",
            Self::Duplicate => "duplicate",
            Self::Unstamped => "unstamped",
        }
    }
}

/// The images of one camera that wait for their other half.
#[derive(Debug)]
pub(super) struct Pairer<T> {
    rules: PairingRules,
    left: VecDeque<Waiting<T>>,
    right: VecDeque<Waiting<T>>,
    /// Stamps of the last pair.
    last: Option<(Stamp, Stamp)>,
}

#[derive(Debug)]
struct Waiting<T> {
    stamp: Stamp,
    since: Instant,
    nearest: Option<Duration>,
    image: T,
}

impl<T> Pairer<T> {
    pub(super) fn new(rules: PairingRules) -> Self {
        Self {
            rules,
            left: VecDeque::new(),
            right: VecDeque::new(),
            last: None,
        }
    }

    /// Other rules from now on. What waits is judged by them.
    pub(super) fn set_rules(&mut self, rules: PairingRules) {
        if rules.key != self.rules.key {
            self.last = None;
        }
        self.rules = rules;
    }

    /// An image has come.
    pub(super) fn offer(&mut self, side: Side, stamp: Stamp, image: T, now: Instant) -> Offered<T> {
        let stamp = relevant(self.rules.key, stamp);
        let mut dropped = self.expire(now);
        let refused = |why, nearest, image, mut dropped: Vec<Dropped<T>>| {
            dropped.push(Dropped {
                side,
                image,
                why,
                nearest,
            });
            Offered { pair: None, dropped }
        };
        if stamp == Stamp::default() {
            return refused(Unpaired::Unstamped, None, image, dropped);
        }
        match self.order(side, &stamp) {
            Order::Newer => {}
            Order::Same => return refused(Unpaired::Duplicate, None, image, dropped),
            Order::Older => {
                let nearest = self.nearest(side, &stamp);
                return refused(Unpaired::Late, nearest, image, dropped);
            }
            Order::Restart => {
                self.last = None;
                dropped.extend(self.give_up());
            }
        }
        let (own, opposite) = self.sides(side);
        if own
            .iter()
            .any(|waiting| waiting.stamp.order(&stamp) == Order::Same)
        {
            return refused(Unpaired::Duplicate, None, image, dropped);
        }
        let mut nearest = None;
        for waiting in opposite.iter_mut() {
            let apart = stamp.apart(&waiting.stamp);
            waiting.nearest = waiting.nearest.into_iter().chain(apart).min();
            nearest = nearest.into_iter().chain(apart).min();
        }
        let tolerance = self.rules.tolerance;
        let (_, opposite) = self.sides(side);
        let fitting = opposite
            .iter()
            .enumerate()
            .filter(|(_, waiting)| fits(tolerance, &stamp, &waiting.stamp))
            .min_by_key(|(_, waiting)| stamp.apart(&waiting.stamp))
            .map(|(index, _)| index);
        if let Some(other) = fitting.and_then(|index| opposite.remove(index)) {
            let (left, right) = match side {
                Side::Left => ((stamp, image), (other.stamp, other.image)),
                Side::Right => ((other.stamp, other.image), (stamp, image)),
            };
            self.last = Some((left.0, right.0));
            let is_older =
                |than: Stamp| move |waiting: &Waiting<T>| waiting.stamp.order(&than) != Order::Newer;
            dropped.extend(self.forget(Side::Left, is_older(left.0)));
            dropped.extend(self.forget(Side::Right, is_older(right.0)));
            return Offered {
                pair: Some((left.1, right.1)),
                dropped,
            };
        }
        let (own, _) = self.sides(side);
        own.push_back(Waiting {
            stamp,
            since: now,
            nearest,
            image,
        });
        if own.len() > MOST_WAITING {
            let oldest = own.pop_front();
            dropped.extend(oldest.map(|waiting| waiting.alone(side)));
        }
        Offered { pair: None, dropped }
    }

    /// Gives up the images that have waited too long.
    pub(super) fn expire(&mut self, now: Instant) -> Vec<Dropped<T>> {
        let patience = self.rules.patience;
        let is_over = |waiting: &Waiting<T>| now.saturating_duration_since(waiting.since) >= patience;
        let mut dropped = self.forget(Side::Left, is_over);
        dropped.extend(self.forget(Side::Right, is_over));
        dropped
    }

    /// Gives up all images that wait.
    pub(super) fn give_up(&mut self) -> Vec<Dropped<T>> {
        let mut dropped = self.forget(Side::Left, |_| true);
        dropped.extend(self.forget(Side::Right, |_| true));
        dropped
    }

    /// When the next image has to be given up.
    pub(super) fn next_expiry(&self) -> Option<Instant> {
        let oldest = self
            .left
            .iter()
            .chain(&self.right)
            .map(|waiting| waiting.since)
            .min();
        oldest.map(|since| since + self.rules.patience)
    }

    fn sides(&mut self, side: Side) -> (&mut VecDeque<Waiting<T>>, &mut VecDeque<Waiting<T>>) {
        match side {
            Side::Left => (&mut self.left, &mut self.right),
            Side::Right => (&mut self.right, &mut self.left),
        }
    }

    /// How an image lies to the last pair.
    fn order(&self, side: Side, stamp: &Stamp) -> Order {
        match (&self.last, side) {
            (None, _) => Order::Newer,
            (Some((left, _)), Side::Left) => stamp.order(left),
            (Some((_, right)), Side::Right) => stamp.order(right),
        }
    }

    /// The distance of the last pair's image on the other side.
    fn nearest(&self, side: Side, stamp: &Stamp) -> Option<Duration> {
        let (left, right) = self.last.as_ref()?;
        stamp.apart(match side {
            Side::Left => right,
            Side::Right => left,
        })
    }

    fn forget(&mut self, side: Side, is_lost: impl Fn(&Waiting<T>) -> bool) -> Vec<Dropped<T>> {
        let (own, _) = self.sides(side);
        let (lost, kept) = std::mem::take(own)
            .into_iter()
            .partition(|waiting| is_lost(waiting));
        *own = kept;
        let lost: VecDeque<Waiting<T>> = lost;
        lost.into_iter().map(|waiting| waiting.alone(side)).collect()
    }
}

impl<T> Waiting<T> {
    fn alone(self, side: Side) -> Dropped<T> {
        Dropped {
            side,
            image: self.image,
            why: Unpaired::Alone,
            nearest: self.nearest,
        }
    }
}

#[cfg(test)]
mod tests;
