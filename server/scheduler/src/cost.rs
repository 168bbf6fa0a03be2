//! What a piece of work is going to cost: an online estimate for each stage of each kind.
//!
//! The last values of each are kept. What is *typical* is the median of the most recent ones, made more or less by the pace of the machine
//! at the moment. The *tail* is a high quantile of how much more than expected they took. What was only
//! primed is forgotten with the first real value. What was never seen costs what is nearest to it, by the unit: the same stage of the
//! same kind at another rung, then of the nearest kind, then of any.

use std::collections::{BTreeMap, HashMap};
use std::time::Duration;

use crate::pace::Pace;
use crate::running::RUNGS;
use crate::spec::{Kind, Stage};

/// Values kept of each stage of each kind.
const KEPT: usize = 64;
/// The most recent of them, of which the median is taken.
const RECENT: usize = 32;
/// The tail is the largest ratio but this many of [`KEPT`]: the 97th percentile.
const ABOVE_TAIL: usize = 2;
/// What was not measured for this long is measured anew: it may have changed.
const STALE: Duration = Duration::from_secs(1);

/// The tail of what is only like something that is known is so much higher.
const UNLIKE: f64 = 1.5;

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

/// One after the other. They are not all bad at once, nor independent: what they take beyond the typical adds up to something between
/// what independent errors would (an exponent of 2) and their sum (1).
impl std::ops::Add for Cost {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let beyond = |cost: Self| cost.tail.saturating_sub(cost.typical).as_secs_f64();
        let typical = self.typical + other.typical;
        let both = (beyond(self).powf(EXPONENT) + beyond(other).powf(EXPONENT)).powf(1.0 / EXPONENT);
        Self {
            typical,
            tail: typical + Duration::try_from_secs_f64(both).unwrap_or_default(),
        }
    }
}

impl std::iter::Sum for Cost {
    fn sum<I: Iterator<Item = Self>>(costs: I) -> Self {
        costs.fold(Self::default(), |sum, cost| sum + cost)
    }
}

/// The last values of one quantity, seconds by the unit, and how far they were from what was expected.
#[derive(Debug, Clone)]
struct Window {
    values: [f32; KEPT],
    /// Each value as a multiple of what was expected.
    ratios: [f32; KEPT],
    next: usize,
    len: usize,
    /// The latest values, of which the typical one is taken.
    recent: usize,
    typical: f32,
    /// The largest multiple of what is expected to reckon with.
    tail: f32,
}

impl Window {
    const EMPTY: Self = Self {
        values: [0.0; KEPT],
        ratios: [0.0; KEPT],
        next: 0,
        len: 0,
        recent: 0,
        typical: 0.0,
        tail: 1.0,
    };

    /// Takes a value, measured while the machine was at `pace`.
    fn record(&mut self, value: f32, pace: f32) {
        let expected = self.typical * pace;
        self.values[self.next] = value;
        self.ratios[self.next] = if expected > 0.0 { value / expected } else { 1.0 };
        self.next = (self.next + 1) % KEPT;
        self.len = (self.len + 1).min(KEPT);

        self.recent = (self.recent + 1).min(RECENT);
        let recent = self.recent;
        let mut latest = [0.0; RECENT];
        for (age, slot) in latest[..recent].iter_mut().enumerate() {
            *slot = self.values[(self.next + KEPT - 1 - age) % KEPT];
        }
        latest[..recent].sort_unstable_by(f32::total_cmp);
        self.typical = f32::midpoint(latest[(recent - 1) / 2], latest[recent / 2]);

        let mut all = self.ratios;
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
        self.tail = tail.max(1.0) * unseen;
    }

    fn cost(&self, units: u32, scale: f64) -> Cost {
        let scaled = |by_unit: f32| {
            Duration::try_from_secs_f64(f64::from(by_unit) * f64::from(units) * scale)
                .map_or(LONGEST, |cost| cost.min(LONGEST))
        };
        Cost {
            typical: scaled(self.typical),
            tail: scaled(self.typical * self.tail),
        }
    }
}

/// Whether a stage is work of a worker, and not of the network.
fn is_paced(stage: Stage) -> bool {
    stage != Stage::Reply
}

/// Of the sum of tails.
const EXPONENT: f64 = 1.2;

/// Rungs that are told apart.
#[expect(clippy::cast_possible_truncation, reason = "a few")]
const MOST_RUNGS: u8 = RUNGS as u8;

/// No stage is taken to last longer, so that sums can't overflow.
const LONGEST: Duration = Duration::from_secs(24 * 3600);

#[derive(Debug)]
struct Entry {
    window: Window,
    /// Only dummies have been measured.
    is_primed: bool,
    /// What was typical of dummies; zero if there were none.
    primed: f32,
    learned_at: Duration,
    /// When it was learned, in the order of learning; the key in `order`.
    turn: u64,
    /// If the next value is less than what is typical, it counts alone.
    is_doubted: bool,
}

/// Costs of all stages of all kinds. Remembers `capacity` of them and forgets first what was not measured for longest.
#[derive(Debug)]
pub struct CostModel<K> {
    entries: HashMap<(K, Stage), Entry>,
    order: BTreeMap<u64, (K, Stage)>,
    pace: Pace,
    /// The same stage of any kind.
    pooled: BTreeMap<Stage, Window>,
    turns: u64,
    capacity: usize,
}

impl<K: Kind> CostModel<K> {
    /// Knows nothing, and will remember at most `capacity` (at least 1) stages.
    #[must_use]
    pub fn new(capacity: usize) -> Self {
        Self {
            entries: HashMap::new(),
            order: BTreeMap::new(),
            pace: Pace::default(),
            pooled: BTreeMap::new(),
            turns: 0,
            capacity: capacity.max(1),
        }
    }

    /// `units` of `stage` took `took`, measured at `now`; nothing is learned from zero units.
    pub fn learn(&mut self, now: Duration, kind: K, stage: Stage, units: u32, took: Duration) {
        self.record(now, (kind, stage), units, took, false);
    }

    /// As [`learn`](Self::learn), of a dummy: it counts until something real of the same stage and kind is learned.
    pub fn prime(&mut self, now: Duration, kind: K, stage: Stage, units: u32, took: Duration) {
        let is_known = |entry: &Entry| !entry.is_primed;
        if !self.entries.get(&(kind, stage)).is_some_and(is_known) {
            self.record(now, (kind, stage), units, took, true);
        }
    }

    fn record(&mut self, now: Duration, key: (K, Stage), units: u32, took: Duration, is_primed: bool) {
        let (_, stage) = key;
        if units == 0 {
            return;
        }
        let value = took.as_secs_f64() / f64::from(units);
        #[expect(
            clippy::cast_possible_truncation,
            reason = "24 bits are more than any clock is good for"
        )]
        let (value, pace) = (value as f32, self.factor(now, stage) as f32);
        self.pooled
            .entry(stage)
            .or_insert(Window::EMPTY)
            .record(value, pace);

        if !self.entries.contains_key(&key)
            && self.entries.len() >= self.capacity
            && let Some((_, oldest)) = self.order.pop_first()
        {
            self.entries.remove(&oldest);
        }
        self.turns += 1;
        let entry = self.entries.entry(key).or_insert(Entry {
            window: Window::EMPTY,
            is_primed,
            primed: 0.0,
            learned_at: now,
            turn: self.turns,
            is_doubted: false,
        });
        self.order.remove(&entry.turn);
        self.order.insert(self.turns, key);
        entry.turn = self.turns;
        entry.learned_at = now;
        if entry.is_primed && !is_primed {
            entry.is_primed = false;
            entry.window = Window::EMPTY;
        }
        if entry.is_doubted {
            entry.is_doubted = false;
            if value < entry.window.typical * pace {
                entry.window.recent = 0;
            }
        }
        if !is_primed && entry.window.len > 0 {
            let typical_s = f64::from(entry.window.typical) * f64::from(units);
            if stage == Stage::Rung(0) {
                self.pace.judge(now, typical_s, took);
            }
            // Steps are parts of rungs.
            if stage != Stage::Step && is_paced(stage) {
                self.pace.note(now, typical_s, took);
            }
        }
        entry.window.record(value, pace);
        if is_primed {
            entry.primed = entry.window.typical;
        }
    }

    /// What `units` of `stage` will take at `now`; what is nearest if this was never measured; nothing if the stage is unknown for all
    /// kinds.
    #[must_use]
    pub fn cost(&self, now: Duration, kind: K, stage: Stage, units: u32) -> Cost {
        let Cost { typical, tail } = self.usual(kind, stage, units);
        let factor = self.factor(now, stage);
        Cost {
            typical: typical.mul_f64(factor),
            tail: tail.mul_f64(factor),
        }
    }

    /// What the pace of the machine makes of a stage.
    fn factor(&self, now: Duration, stage: Stage) -> f64 {
        if is_paced(stage) {
            self.pace.factor(now)
        } else {
            1.0
        }
    }

    /// As [`cost`](Self::cost), at the usual pace.
    fn usual(&self, kind: K, stage: Stage, units: u32) -> Cost {
        if let Some(entry) = self.entries.get(&(kind, stage)) {
            if entry.is_primed {
                return self.corrected(kind, stage, units, &entry.window);
            }
            return entry.window.cost(units, 1.0);
        }
        let at_another_rung = match stage {
            // Rungs themselves have nothing in common.
            Stage::Rung(_) => None,
            _ => self.at_other_rungs(kind, stage).next(),
        };
        let nearest = at_another_rung.map(|entry| &entry.window);
        if let Some(window) = nearest.or_else(|| self.of_kin(kind, stage)) {
            let Cost { typical, tail } = window.cost(units, 1.0);
            return Cost {
                typical,
                tail: tail.mul_f64(UNLIKE),
            };
        }
        let Some(window) = self.pooled.get(&stage) else {
            return Cost::default();
        };
        let tail = window.cost(units, 1.0).tail;
        Cost { typical: tail, tail }
    }

    /// What is known of `stage` of `kind` at other rungs, the nearest below first, then those above.
    fn at_other_rungs(&self, kind: K, stage: Stage) -> impl Iterator<Item = &Entry> {
        let rung = stage.rung();
        self.at_rungs(kind, stage, (0..rung).rev().chain(rung + 1..MOST_RUNGS))
    }

    fn at_rungs(
        &self,
        kind: K,
        stage: Stage,
        rungs: impl Iterator<Item = u8>,
    ) -> impl Iterator<Item = &Entry> {
        rungs.filter_map(move |rung| self.entries.get(&(kind, stage.at_rung(rung)?)))
    }

    /// What dummies took, made more or less as real frames are at the other rungs where they have been measured. An ending takes no
    /// longer than that of a better map.
    fn corrected(&self, kind: K, stage: Stage, units: u32, dummies: &Window) -> Cost {
        let is_real = |entry: &&Entry| !entry.is_primed;
        let mut real = self.at_other_rungs(kind, stage).filter(is_real);
        let both = real.find(|entry| entry.primed > 0.0);
        let scale = both.map_or(1.0, |entry| f64::from(entry.window.typical / entry.primed));
        let cost = dummies.cost(units, scale);
        let better = match stage {
            Stage::Mesh(rung) | Stage::Encode(rung) => self
                .at_rungs(kind, stage, rung + 1..MOST_RUNGS)
                .find(is_real)
                .map(|entry| entry.window.cost(units, 1.0)),
            Stage::Decode | Stage::Rung(_) | Stage::Step | Stage::Reply => None,
        };
        better.map_or(cost, |better| Cost {
            typical: cost.typical.min(better.typical),
            tail: cost.tail.min(better.tail),
        })
    }

    fn of_kin(&self, kind: K, stage: Stage) -> Option<&Window> {
        let same_stage = self.entries.iter().filter(|((_, other), _)| *other == stage);
        let known = same_stage.filter_map(|((other, _), entry)| Some((kind.distance(other)?, entry)));
        // The entries of a map come in any order; the turn makes the choice repeatable.
        let nearest = known.min_by_key(|(distance, entry)| (*distance, std::cmp::Reverse(entry.turn)));
        nearest.map(|(_, entry)| &entry.window)
    }

    /// Whether `stage` of `kind` was not measured lately.
    #[must_use]
    pub fn is_stale(&self, now: Duration, kind: K, stage: Stage) -> bool {
        self.entries
            .get(&(kind, stage))
            .is_none_or(|entry| now.saturating_sub(entry.learned_at) > STALE)
    }

    /// Doubts that `stage` of `kind` still takes as long as is known: if what is measured next is less, it counts alone. If it is not,
    /// nothing is lost: the first frame after a pause is slower than those that follow it.
    pub fn doubt(&mut self, kind: K, stage: Stage) {
        if let Some(entry) = self.entries.get_mut(&(kind, stage)) {
            entry.is_doubted = true;
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
