//! One frame by the clock: every step of the way up the ladder.

use std::time::Instant;

use anyhow::{Context, Result};
use stereo::{DisparityMap, Level, Matcher, Params, Preset, Progress, Serial, Shape, StereoPair, rung_names};
use stereo_tests::gray::GrayImage;

use crate::pairs::Pair;

/// A stretch of work that a caller can't interrupt, or, within `base`, one of its stages.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Step {
    pub(crate) rung: &'static str,
    pub(crate) stage: &'static str,
    pub(crate) ms: f64,
}

/// What one stage of the way to one rung took.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Stage {
    pub(crate) rung: &'static str,
    pub(crate) name: &'static str,
    /// All its steps together.
    pub(crate) ms: f64,
    pub(crate) steps: u32,
    /// The longest of its steps.
    pub(crate) longest_ms: f64,
}

/// The whole ladder; every step as long as the fastest of several frames made it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Frame {
    pub(crate) base: Vec<Step>,
    pub(crate) refine: Vec<Step>,
    /// Time of the fastest frame.
    pub(crate) ms: f64,
}

impl Frame {
    /// The fastest of `repeat` frames, after a first one that isn't counted.
    pub(crate) fn fastest(level: Level, pair: &Pair, params: &Params, repeat: u32) -> Result<Self> {
        let shape = Shape::new(pair.left.width_px(), pair.left.height_px())?;
        let mut matcher = Matcher::new(level, shape, params.clone())?;
        let mut map = DisparityMap::new(shape);
        let mut frame = || one_frame(&mut matcher, &mut map, (&pair.left, &pair.right), params.preset);
        frame()?;
        let mut best = frame()?;
        for _ in 1..repeat {
            best.take_faster(&frame()?);
        }
        Ok(best)
    }

    /// The same pair takes the same steps every time.
    fn take_faster(&mut self, other: &Self) {
        self.ms = self.ms.min(other.ms);
        let (mine, others) = (
            self.base.iter_mut().chain(&mut self.refine),
            other.base.iter().chain(&other.refine),
        );
        for (step, again) in mine.zip(others) {
            step.ms = step.ms.min(again.ms);
        }
    }

    /// All steps.
    pub(crate) fn steps(&self) -> impl Iterator<Item = &Step> {
        self.base.iter().chain(&self.refine)
    }

    /// The steps by stage, in the order in which stages are first met.
    pub(crate) fn stages(&self) -> Vec<Stage> {
        let mut stages: Vec<Stage> = Vec::new();
        for step in self.steps() {
            let known = stages
                .iter_mut()
                .find(|s| (s.rung, s.name) == (step.rung, step.stage));
            if let Some(stage) = known {
                stage.ms += step.ms;
                stage.steps += 1;
                stage.longest_ms = stage.longest_ms.max(step.ms);
            } else {
                stages.push(Stage {
                    rung: step.rung,
                    name: step.stage,
                    ms: step.ms,
                    steps: 1,
                    longest_ms: step.ms,
                });
            }
        }
        stages
    }
}

/// One frame through the whole ladder.
fn one_frame(
    matcher: &mut Matcher,
    map: &mut DisparityMap,
    (left, right): (&GrayImage, &GrayImage),
    preset: Preset,
) -> Result<Frame> {
    let rungs = rung_names(preset);
    let pair = StereoPair::new(left.view(), right.view())?;
    let mut frame = Frame {
        base: Vec::new(),
        refine: Vec::new(),
        ms: 0.0,
    };
    let start = Instant::now();
    let mut last = start;
    let mut step = |rung, stage| {
        let now = Instant::now();
        let ms = 1e3 * (now - last).as_secs_f64();
        last = now;
        Step { rung, stage, ms }
    };
    let mut progress = matcher.base_by_stage(pair, map, &Serial, &mut |stage| {
        frame.base.push(step(rungs[0], stage));
    })?;
    let mut rung = 0;
    loop {
        match progress {
            Progress::Working => {}
            Progress::Improved(_) => rung += 1,
            Progress::Converged(_) => break,
        }
        let name = rungs.get(rung).context("no more rungs than names")?;
        let stage = matcher.next_stage();
        progress = matcher.refine(pair, map, &Serial);
        frame.refine.push(step(name, stage));
    }
    frame.ms = 1e3 * start.elapsed().as_secs_f64();
    Ok(frame)
}

#[cfg(test)]
mod tests {
    use super::{Frame, Stage, Step};

    fn step(rung: &'static str, stage: &'static str, ms: f64) -> Step {
        Step { rung, stage, ms }
    }

    #[test]
    fn steps_of_a_stage_add_up_and_the_longest_is_kept() {
        let frame = Frame {
            base: vec![step("mesh", "search", 1.0), step("mesh", "search", 3.0)],
            refine: vec![step("half", "search", 2.0)],
            ms: 7.0,
        };
        let search = Stage {
            rung: "mesh",
            name: "search",
            ms: 4.0,
            steps: 2,
            longest_ms: 3.0,
        };
        assert_eq!(frame.stages()[0], search);
        assert_eq!(frame.stages().len(), 2);
    }

    #[test]
    fn every_step_is_as_fast_as_in_its_fastest_frame() {
        let frame = |first, second, ms| Frame {
            base: vec![step("mesh", "search", first)],
            refine: vec![step("half", "search", second)],
            ms,
        };
        let mut best = frame(1.0, 5.0, 6.0);
        best.take_faster(&frame(2.0, 3.0, 5.0));
        assert_eq!(best, frame(1.0, 3.0, 5.0));
    }
}
