//! The waiting jobs in the order they will be served, and how much room each of them leaves.
//!
//! A balanced search tree (treap) in which every subtree knows the sum of its work and the least slack in it, so that "would
//! everybody still be in time if this job came in here?" is answered on the way down: O(log n).
//!
//! Job i starts at the latest when the workers have done what runs now and what is due before it (list scheduling; Graham 1969):
//! `start_i <= now + (running + sum of work_j before i) / workers`, whatever the division among the workers. With
//! `share_j = work_j / workers` and `tail_i` the time i itself takes nearly always,
//! `slack_i = due_i - tail_i - (now + running / workers + sum of share_j before i)`.
//!
//! Slack is kept at four headrooms: at headroom h the time until the deadline counts only `1 - h/4`. Work that is not promised is
//! let in only where that shortened time is enough, and the rest is left to those who come later.

use std::time::Duration;

use crate::nanos::nanos;
use crate::spec::Ticket;

/// Headrooms at which slack is known: 0, 1/4, 1/2, 3/4 of the time until the deadline.
pub(crate) const HEADROOMS: usize = 4;
const NONE: u32 = u32::MAX;
/// More slack than there ever is.
const PLENTY: i64 = i64::MAX / 2;
/// The last start of a job that has started, or that no policy gives up.
pub(crate) const NEVER: i64 = PLENTY;

/// The part of `moment` that counts at `headroom`.
pub(crate) fn at_headroom(moment: i64, headroom: usize) -> i64 {
    match headroom {
        0 => moment,
        1 => moment / 4 * 3,
        2 => moment / 2,
        _ => moment / 4,
    }
}

/// What the tree knows of a job's time, in nanoseconds.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Load {
    /// The deadline.
    pub(crate) due: i64,
    /// What it takes nearly always, once it runs.
    pub(crate) tail: i64,
    /// What the jobs after it wait for it.
    pub(crate) share: i64,
    /// The last moment at which it makes sense to start it.
    pub(crate) last_start: i64,
    /// It has begun and needs its ending, which asks for no headroom.
    pub(crate) is_begun: bool,
}

impl Load {
    fn room(&self) -> [i64; HEADROOMS] {
        std::array::from_fn(|h| match h {
            1.. if self.is_begun => PLENTY,
            _ => at_headroom(self.due, h) - self.tail,
        })
    }
}

#[derive(Debug)]
struct Node<T> {
    key: Ticket,
    balance: u64,
    left: u32,
    right: u32,
    load: Load,
    /// Of the subtree: work, least room after the subtree's own earlier work, earliest last start.
    sum: i64,
    least: [i64; HEADROOMS],
    last_start: i64,
    /// `None` only in free nodes.
    item: Option<T>,
}

/// What a newcomer would find.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Probe {
    /// Work of those before it.
    pub(crate) before: i64,
    /// Least room of those after it, as it is without the newcomer.
    pub(crate) after: [i64; HEADROOMS],
}

/// Waiting jobs by [`Ticket`].
#[derive(Debug)]
pub(crate) struct Timeline<T> {
    nodes: Vec<Node<T>>,
    free: Vec<u32>,
    root: u32,
    len: usize,
    dice: u64,
}

impl<T> Timeline<T> {
    pub(crate) fn new() -> Self {
        Self {
            nodes: Vec::new(),
            free: Vec::new(),
            root: NONE,
            len: 0,
            dice: 0x9e37_79b9_7f4a_7c15,
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.len
    }

    pub(crate) fn insert(&mut self, key: Ticket, load: Load, item: T) {
        // xorshift64: a treap wants priorities that have nothing to do with the keys, nothing more.
        self.dice ^= self.dice << 13;
        self.dice ^= self.dice >> 7;
        self.dice ^= self.dice << 17;
        let node = Node {
            key,
            balance: self.dice,
            left: NONE,
            right: NONE,
            load,
            sum: load.share,
            least: load.room(),
            last_start: load.last_start,
            item: Some(item),
        };
        let index = if let Some(index) = self.free.pop() {
            self.nodes[index as usize] = node;
            index
        } else {
            self.nodes.push(node);
            // The capacity of the queue is far below 2^32.
            u32::try_from(self.nodes.len() - 1).unwrap_or(NONE)
        };
        let (before, after) = self.split(self.root, key);
        let before = self.merge(before, index);
        self.root = self.merge(before, after);
        self.len += 1;
    }

    pub(crate) fn remove(&mut self, key: Ticket) -> Option<T> {
        let (before, rest) = self.split(self.root, key);
        // `rest` starts with the key itself, if it is there.
        let first = self.leftmost(rest);
        if first == NONE || self.nodes[first as usize].key != key {
            self.root = self.merge(before, rest);
            return None;
        }
        let after = self.without_leftmost(rest);
        self.root = self.merge(before, after);
        self.len -= 1;
        self.free.push(first);
        self.nodes[first as usize].item.take()
    }

    /// What the tree knows of the time of a job.
    pub(crate) fn load(&self, key: Ticket) -> Option<Load> {
        self.find(key).map(|node| node.load)
    }

    fn find(&self, key: Ticket) -> Option<&Node<T>> {
        let mut at = self.root;
        while at != NONE {
            let node = &self.nodes[at as usize];
            match key.cmp(&node.key) {
                std::cmp::Ordering::Less => at = node.left,
                std::cmp::Ordering::Greater => at = node.right,
                std::cmp::Ordering::Equal => return Some(node),
            }
        }
        None
    }

    /// The job that is served first.
    pub(crate) fn first(&self) -> Option<Ticket> {
        let first = self.leftmost(self.root);
        (first != NONE).then(|| self.nodes[first as usize].key)
    }

    /// The job that is served next after `key`.
    pub(crate) fn after(&self, key: Ticket) -> Option<Ticket> {
        let (mut at, mut found) = (self.root, None);
        while at != NONE {
            let node = &self.nodes[at as usize];
            if node.key > key {
                found = Some(node.key);
                at = node.left;
            } else {
                at = node.right;
            }
        }
        found
    }

    /// The job of this key.
    pub(crate) fn get(&self, key: Ticket) -> Option<&T> {
        self.find(key).and_then(|node| node.item.as_ref())
    }

    /// A job that it makes no sense to start any more.
    pub(crate) fn hopeless(&self, now: Duration) -> Option<Ticket> {
        let now = nanos(now);
        let mut at = self.root;
        while at != NONE && self.nodes[at as usize].last_start < now {
            let node = &self.nodes[at as usize];
            if node.load.last_start < now {
                return Some(node.key);
            }
            let left = node.left;
            let is_left = left != NONE && self.nodes[left as usize].last_start < now;
            at = if is_left { left } else { node.right };
        }
        None
    }

    /// The earliest moment after which [`hopeless`](Self::hopeless) finds one.
    pub(crate) fn earliest_last_start(&self) -> Option<i64> {
        (self.root != NONE)
            .then(|| self.nodes[self.root as usize].last_start)
            .filter(|&last| last < NEVER)
    }

    /// Work of all together.
    pub(crate) fn total(&self) -> i64 {
        self.sum_of(self.root)
    }

    /// The least room of any job, at each headroom.
    pub(crate) fn least(&self) -> [i64; HEADROOMS] {
        self.least_of(self.root)
    }

    /// What a job would find that came in at `key`.
    pub(crate) fn probe(&self, key: Ticket) -> Probe {
        let mut probe = Probe {
            before: 0,
            after: [PLENTY; HEADROOMS],
        };
        let mut at = self.root;
        while at != NONE {
            let node = &self.nodes[at as usize];
            let before_node = probe.before + self.sum_of(node.left);
            if key < node.key {
                let behind = self.least_of(node.right);
                let own = node.load.room();
                for h in 0..HEADROOMS {
                    let right = behind[h].saturating_sub(before_node + node.load.share);
                    probe.after[h] = probe.after[h].min(own[h] - before_node).min(right);
                }
                at = node.left;
            } else {
                probe.before = before_node + node.load.share;
                at = node.right;
            }
        }
        probe
    }

    /// The last job that has less room than `room`, at no headroom.
    pub(crate) fn last_with_less_room_than(&self, room: i64) -> Option<Ticket> {
        let mut at = self.root;
        let mut before = 0;
        while at != NONE {
            let node = &self.nodes[at as usize];
            let before_node = before + self.sum_of(node.left);
            let before_right = before_node + node.load.share;
            if self.least_of(node.right)[0].saturating_sub(before_right) < room {
                before = before_right;
                at = node.right;
            } else if node.load.room()[0] - before_node < room {
                return Some(node.key);
            } else {
                at = node.left;
            }
        }
        None
    }

    fn sum_of(&self, at: u32) -> i64 {
        if at == NONE {
            0
        } else {
            self.nodes[at as usize].sum
        }
    }

    fn least_of(&self, at: u32) -> [i64; HEADROOMS] {
        if at == NONE {
            [PLENTY; HEADROOMS]
        } else {
            self.nodes[at as usize].least
        }
    }

    fn last_start_of(&self, at: u32) -> i64 {
        if at == NONE {
            PLENTY
        } else {
            self.nodes[at as usize].last_start
        }
    }

    fn leftmost(&self, mut at: u32) -> u32 {
        while at != NONE && self.nodes[at as usize].left != NONE {
            at = self.nodes[at as usize].left;
        }
        at
    }

    /// Recomputes what `at` knows of its subtree.
    fn refresh(&mut self, at: u32) {
        let Node {
            left, right, load, ..
        } = self.nodes[at as usize];
        let before = self.sum_of(left);
        let through = before + load.share;
        let (in_left, in_right, own) = (self.least_of(left), self.least_of(right), load.room());
        let last_start = load
            .last_start
            .min(self.last_start_of(left))
            .min(self.last_start_of(right));
        let sum = through + self.sum_of(right);
        let node = &mut self.nodes[at as usize];
        node.sum = sum;
        node.last_start = last_start;
        for h in 0..HEADROOMS {
            node.least[h] = in_left[h]
                .min(own[h] - before)
                .min(in_right[h].saturating_sub(through));
        }
    }

    /// Those before `key`, and the others.
    fn split(&mut self, at: u32, key: Ticket) -> (u32, u32) {
        if at == NONE {
            return (NONE, NONE);
        }
        if self.nodes[at as usize].key < key {
            let (before, after) = self.split(self.nodes[at as usize].right, key);
            self.nodes[at as usize].right = before;
            self.refresh(at);
            (at, after)
        } else {
            let (before, after) = self.split(self.nodes[at as usize].left, key);
            self.nodes[at as usize].left = after;
            self.refresh(at);
            (before, at)
        }
    }

    /// `first`, all of whose keys are before those of `second`, and `second`.
    fn merge(&mut self, first: u32, second: u32) -> u32 {
        if first == NONE {
            return second;
        }
        if second == NONE {
            return first;
        }
        if self.nodes[first as usize].balance > self.nodes[second as usize].balance {
            let merged = self.merge(self.nodes[first as usize].right, second);
            self.nodes[first as usize].right = merged;
            self.refresh(first);
            first
        } else {
            let merged = self.merge(first, self.nodes[second as usize].left);
            self.nodes[second as usize].left = merged;
            self.refresh(second);
            second
        }
    }

    fn without_leftmost(&mut self, at: u32) -> u32 {
        let left = self.nodes[at as usize].left;
        if left == NONE {
            return self.nodes[at as usize].right;
        }
        let left = self.without_leftmost(left);
        self.nodes[at as usize].left = left;
        self.refresh(at);
        at
    }
}

#[cfg(test)]
mod tests;
