//! What a piece of work is going to cost: an online estimate for each stage of each kind.
//!
//! The last values of each are kept. What is *typical* is the median of the most recent ones, which follows a machine that gets
//! slower within a few frames and doesn't follow a single hiccup. The *tail* is a high quantile of all that are kept. A kind
//! that was never seen costs what that stage costs for other kinds, by the unit.

use std::collections::{BTreeMap, HashMap};
use std::hash::Hash;
use std::time::Duration;

use crate::spec::Stage;

/// Values kept of each stage of each kind.
const KEPT: usize = 64;
/// The most recent of them, of which the median is taken.
const RECENT: usize = 16;
/// The tail is the largest value but this many of [`KEPT`]: the 97th percentile.
const ABOVE_TAIL: usize = 2;
/// What was not measured for this long is measured anew: it may have changed.
const STALE: Duration = Duration::from_secs(1);

/// What something costs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Cost {
    /// As often more as less.
    pub typical: Duration,
    /// Rarely more.
    pub tail: Duration,
}

impl Cost {
    /// What to reckon with when several of these follow each other: above typical, since costs are skewed, and below the tail,
    /// since they are not all bad at once.
    #[must_use]
    pub fn charge(self) -> Duration {
        self.typical + self.tail.saturating_sub(self.typical) / 4
    }
}

impl std::ops::Add for Cost {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            typical: self.typical + other.typical,
            tail: self.tail + other.tail,
        }
    }
}

impl std::iter::Sum for Cost {
    fn sum<I: Iterator<Item = Self>>(costs: I) -> Self {
        costs.fold(Self::default(), |sum, cost| sum + cost)
    }
}

/// The last values of one quantity, seconds by the unit.
#[derive(Debug, Clone)]
struct Window {
    values: [f32; KEPT],
    next: usize,
    len: usize,
    typical: f32,
    tail: f32,
}

impl Window {
    const EMPTY: Self = Self {
        values: [0.0; KEPT],
        next: 0,
        len: 0,
        typical: 0.0,
        tail: 0.0,
    };

    fn record(&mut self, value: f32) {
        self.values[self.next] = value;
        self.next = (self.next + 1) % KEPT;
        self.len = (self.len + 1).min(KEPT);

        let recent = self.len.min(RECENT);
        let mut latest = [0.0; RECENT];
        for (age, slot) in latest[..recent].iter_mut().enumerate() {
            *slot = self.values[(self.next + KEPT - 1 - age) % KEPT];
        }
        latest[..recent].sort_unstable_by(f32::total_cmp);
        self.typical = f32::midpoint(latest[(recent - 1) / 2], latest[recent / 2]);

        let mut all = self.values;
        let all = &mut all[..self.len];
        let rank = self.len - 1 - ABOVE_TAIL * self.len / KEPT;
        let (_, tail, _) = all.select_nth_unstable_by(rank, f32::total_cmp);
        // The largest of a few values is less than the largest of many will be.
        let unseen = match self.len {
            0..=3 => 1.5,
            4..=15 => 1.2,
            16..KEPT => 1.1,
            _ => 1.0,
        };
        self.tail = tail.max(self.typical) * unseen;
    }

    fn cost(&self, units: u32) -> Cost {
        let scaled = |by_unit: f32| {
            Duration::try_from_secs_f64(f64::from(by_unit) * f64::from(units))
                .map_or(LONGEST, |cost| cost.min(LONGEST))
        };
        Cost {
            typical: scaled(self.typical),
            tail: scaled(self.tail),
        }
    }
}

/// No stage is taken to last longer, so that sums can't overflow.
const LONGEST: Duration = Duration::from_secs(24 * 3600);

#[derive(Debug)]
struct Entry {
    window: Window,
    learned_at: Duration,
    /// When it was learned, in the order of learning; the key in `order`.
    turn: u64,
}

/// Costs of all stages of all kinds. Remembers `capacity` of them and forgets first what was not measured for longest.
#[derive(Debug)]
pub struct CostModel<K> {
    entries: HashMap<(K, Stage), Entry>,
    order: BTreeMap<u64, (K, Stage)>,
    /// The same stage of any kind.
    pooled: BTreeMap<Stage, Window>,
    turns: u64,
    capacity: usize,
}

impl<K: Copy + Eq + Hash> CostModel<K> {
    /// Knows nothing, and will remember at most `capacity` (at least 1) stages.
    #[must_use]
    pub fn new(capacity: usize) -> Self {
        Self {
            entries: HashMap::new(),
            order: BTreeMap::new(),
            pooled: BTreeMap::new(),
            turns: 0,
            capacity: capacity.max(1),
        }
    }

    /// `units` of `stage` took `took`, measured at `now`; nothing is learned from zero units.
    pub fn learn(&mut self, now: Duration, kind: K, stage: Stage, units: u32, took: Duration) {
        if units == 0 {
            return;
        }
        let value = took.as_secs_f64() / f64::from(units);
        #[expect(
            clippy::cast_possible_truncation,
            reason = "24 bits are more than any clock is good for"
        )]
        let value = value as f32;
        self.pooled.entry(stage).or_insert(Window::EMPTY).record(value);

        let key = (kind, stage);
        if !self.entries.contains_key(&key)
            && self.entries.len() >= self.capacity
            && let Some((_, oldest)) = self.order.pop_first()
        {
            self.entries.remove(&oldest);
        }
        self.turns += 1;
        let entry = self.entries.entry(key).or_insert(Entry {
            window: Window::EMPTY,
            learned_at: now,
            turn: self.turns,
        });
        self.order.remove(&entry.turn);
        self.order.insert(self.turns, key);
        entry.turn = self.turns;
        entry.learned_at = now;
        entry.window.record(value);
    }

    /// What `units` of `stage` will take; of another kind if this one is unknown, by its tail; nothing if no kind is known.
    #[must_use]
    pub fn cost(&self, kind: K, stage: Stage, units: u32) -> Cost {
        if let Some(entry) = self.entries.get(&(kind, stage)) {
            return entry.window.cost(units);
        }
        let Some(window) = self.pooled.get(&stage) else {
            return Cost::default();
        };
        let tail = window.cost(units).tail;
        Cost { typical: tail, tail }
    }

    /// Whether `stage` of `kind` was not measured lately.
    #[must_use]
    pub fn is_stale(&self, now: Duration, kind: K, stage: Stage) -> bool {
        self.entries
            .get(&(kind, stage))
            .is_none_or(|entry| now.saturating_sub(entry.learned_at) > STALE)
    }

    /// Forgets what is known of `stage` of `kind`, so that what is measured next counts alone.
    pub fn forget(&mut self, kind: K, stage: Stage) {
        if let Some(entry) = self.entries.remove(&(kind, stage)) {
            self.order.remove(&entry.turn);
        }
    }

    /// How many stages are remembered.
    #[must_use]
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether nothing is known.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }
}
