//! The overload ladder: what is given up first when more is asked for than can be done.
//!
//! For each level there is an account of what would have to be done at it, of everything offered lately. The level goes up as far
//! as it must at once, and down one at a time, when the level below would have been enough for a while, with room to spare.

use std::time::Duration;

use crate::rate::Rate;

/// State of the overload ladder; each level includes those before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub enum Level {
    /// Everything asked for can be done.
    #[default]
    Full,
    /// Rungs are cut where others need the time.
    FewerRungs,
    /// Frames whose client allows it are matched at half resolution.
    HalfResolution,
    /// Optional meshes are left out.
    NoMesh,
    /// Frames of best-effort class are turned away.
    DropBestEffort,
    /// More than the mandatory part of everything is offered: some is refused.
    Refuse,
}

impl Level {
    /// All levels, the mildest first.
    pub const ALL: [Self; 6] = [
        Self::Full,
        Self::FewerRungs,
        Self::HalfResolution,
        Self::NoMesh,
        Self::DropBestEffort,
        Self::Refuse,
    ];
}

/// Load above which a level is not enough.
const ENOUGH: f64 = 0.95;
/// Load below which a level would be enough with room to spare.
const AMPLE: f64 = 0.8;
/// How long a lower level must have been enough.
const PATIENCE: Duration = Duration::from_millis(100);

/// Where the ladder stands. Offered work in, level out; nothing else changes it.
#[derive(Debug, Clone, Copy, Default)]
pub struct Ladder {
    offered: [Rate; 5],
    level: usize,
    /// Since when the level below has been ample.
    ample_since: Option<Duration>,
}

impl Ladder {
    /// Work was offered that would take these shares of a second of all workers at the levels before [`Level::Refuse`].
    pub fn offer(&mut self, now: Duration, work: [f64; 5]) {
        for (rate, work) in self.offered.iter_mut().zip(work) {
            rate.add(now, work);
        }
        self.update(now);
    }

    /// The level at `now`.
    pub fn level(&mut self, now: Duration) -> Level {
        self.update(now);
        Level::ALL[self.level]
    }

    /// Load offered lately, as it would be at `level`; 1 = all that the workers can do.
    #[must_use]
    pub fn load(&self, now: Duration, level: Level) -> f64 {
        self.offered[(level as usize).min(self.offered.len() - 1)].get(now)
    }

    fn update(&mut self, now: Duration) {
        let lowest_within = |limit: f64| {
            let found = self.offered.iter().position(|rate| rate.get(now) <= limit);
            found.unwrap_or(self.offered.len())
        };
        let needed = lowest_within(ENOUGH);
        if needed > self.level {
            self.level = needed;
            self.ample_since = None;
        } else if lowest_within(AMPLE) < self.level {
            let since = *self.ample_since.get_or_insert(now);
            if now.saturating_sub(since) >= PATIENCE {
                self.level -= 1;
                self.ample_since = Some(now);
            }
        } else {
            self.ample_since = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    /// A load of `factor` of what the workers can do at full quality; each level halves the work.
    fn offer(ladder: &mut Ladder, from_ms: u64, until_ms: u64, factor: f64) -> Vec<Level> {
        (from_ms..until_ms)
            .map(|t| {
                let work =
                    std::array::from_fn(|level| factor * 1e-3 * 0.5_f64.powi(i32::try_from(level).unwrap()));
                ladder.offer(ms(t), work);
                ladder.level(ms(t))
            })
            .collect()
    }

    #[test]
    fn the_level_is_the_mildest_that_is_enough() {
        for (factor, level) in [
            (0.7, Level::Full),
            (1.5, Level::FewerRungs),
            (7.0, Level::NoMesh),
            (40.0, Level::Refuse),
        ] {
            let mut ladder = Ladder::default();
            let seen = offer(&mut ladder, 0, 2000, factor);
            assert_eq!(seen.last(), Some(&level), "load {factor}");
        }
    }

    #[test]
    fn after_a_burst_it_goes_down_one_level_at_a_time_and_only_after_a_while() {
        let mut ladder = Ladder::default();
        offer(&mut ladder, 0, 1000, 40.0);
        let mut seen = offer(&mut ladder, 1000, 4000, 0.1);
        assert_eq!(seen.last(), Some(&Level::Full));
        seen.dedup();
        assert!(
            seen.windows(2)
                .all(|pair| pair[0] as usize == pair[1] as usize + 1),
            "{seen:?}"
        );
    }

    #[test]
    fn a_load_near_a_threshold_does_not_make_it_flutter() {
        let mut ladder = Ladder::default();
        offer(&mut ladder, 0, 1000, 1.0);
        let mut seen: Vec<Level> = (0..40)
            .flat_map(|round| {
                offer(
                    &mut ladder,
                    1000 + 50 * round,
                    1050 + 50 * round,
                    if round % 2 == 0 { 0.85 } else { 1.0 },
                )
            })
            .collect();
        seen.dedup();
        assert_eq!(seen, [Level::FewerRungs]);
    }
}
