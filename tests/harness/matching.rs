//! Matching in process, without any server.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use stereo::{DisparityMap, ForkJoin, Level, Matcher, Params, Progress, Quality, Serial, Shape, StereoPair};

use crate::gray::GrayImage;

/// A matcher with its result map.
#[derive(Debug)]
pub struct Bench {
    matcher: Matcher,
    map: DisparityMap,
}

/// What one match gave.
#[derive(Debug, Clone, PartialEq)]
pub struct Matched {
    /// Disparity of every pixel in px, NaN where there is none.
    pub disparity_px: Vec<f32>,
    /// The quality of every rung that was finished.
    pub rungs: Vec<Quality>,
    /// Time from gray views to the final map.
    pub elapsed: Duration,
}

impl Bench {
    /// A matcher for pairs of `left`'s size at the machine's best SIMD level.
    ///
    /// # Errors
    /// If the size or `params` are refused.
    pub fn new(left: &GrayImage, params: Params) -> Result<Self> {
        Self::at_level(Level::detect(), left, params)
    }

    /// The same at a given SIMD level.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn at_level(level: Level, left: &GrayImage, params: Params) -> Result<Self> {
        let shape = Shape::new(left.width_px(), left.height_px())?;
        let matcher = Matcher::new(level, shape, params)?;
        Ok(Self {
            matcher,
            map: DisparityMap::new(shape),
        })
    }

    /// The same bench for pairs of another size or with other parameters.
    ///
    /// # Errors
    /// If the size or `params` are refused.
    pub fn reconfigure(&mut self, left: &GrayImage, params: Params) -> Result<()> {
        let shape = Shape::new(left.width_px(), left.height_px())?;
        self.matcher
            .reconfigure(shape, params)
            .context("the matcher refuses the new parameters")
    }

    /// Matches a pair until `max_rungs` rungs are finished or nothing is left to do.
    ///
    /// # Errors
    /// If the pair has another size than the matcher.
    pub fn run(&mut self, left: &GrayImage, right: &GrayImage, max_rungs: u8) -> Result<Matched> {
        self.run_with(left, right, max_rungs, &Serial)
    }

    /// The same on the threads of `join`.
    ///
    /// # Errors
    /// As [`Self::run`].
    pub fn run_with(
        &mut self,
        left: &GrayImage,
        right: &GrayImage,
        max_rungs: u8,
        join: &dyn ForkJoin,
    ) -> Result<Matched> {
        let pair = StereoPair::new(left.view(), right.view())?;
        let start = Instant::now();
        let mut rungs = Vec::new();
        let mut progress = self.matcher.base(pair, &mut self.map, join)?;
        loop {
            match progress {
                Progress::Working => {}
                Progress::Improved(quality) => rungs.push(quality),
                Progress::Converged(quality) => {
                    // The last rung may already have been reported as `Improved`.
                    if rungs.last().is_none_or(|last| last.rung < quality.rung) {
                        rungs.push(quality);
                    }
                    break;
                }
            }
            if rungs.len() >= usize::from(max_rungs) {
                break;
            }
            progress = self.matcher.refine(pair, &mut self.map, join);
        }
        let elapsed = start.elapsed();
        Ok(Matched {
            disparity_px: self.map.iter_px().collect(),
            rungs,
            elapsed,
        })
    }

    /// The last result.
    #[must_use]
    pub fn map(&self) -> &DisparityMap {
        &self.map
    }
}
