//! The matcher: a base result, then bounded steps that improve it, as long as the caller likes.
//!
//! ```text
//! base:    gradient, census of both views
//!          walk to the first rung
//! refine:  one step on the way to the next rung; at its end, publish
//!
//! the way to a rung (what of it applies is the ladder's business):
//!     choose candidates -> search them along their epipolar lines -> insert them into the mesh
//!     -> interpolate what changed -> evaluate costs, keep the better of old and new -> publish
//! ```
//! With regions to focus on, these climb the ladder between the first rung and the rest (see `focus`).
//! The caller may stop after any step: the output always holds the last finished rung.

use crate::confidence;
use crate::convergence;
use crate::disparity::DisparityMap;
use crate::error::{MatchError, ParamsError};
use crate::fork_join::ForkJoin;
use crate::frame::{Frame, Regions, Stage};
use crate::image::{Shape, StereoPair};
use crate::ladder::Recipe;
use crate::mesh::{Mesh, MeshParams};
use crate::params::Params;
use crate::publish::Published;
use crate::simd::Level;

/// What is known about a published result.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quality {
    /// Rungs finished, the first included (1..).
    pub rung: u8,
    /// Share of the pixels asked for (the mask's, or all) that have a disparity, 0..=1.
    pub density: f32,
    /// Estimated share of the mask's pixels that are right within 3 px, 0..=1; never falls from rung to rung.
    pub estimate: f32,
    /// Share of the pixels asked for that the rung changed: that have got or lost a disparity, or one that differs by 1/4 px
    /// or more from the rung before. 1 after the first rung and those of regions; 0 if no pixel is asked for.
    pub changed: f32,
}

/// What a call achieved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Progress {
    /// A step towards the next rung is done; the output is untouched.
    Working,
    /// A rung was finished and written to the output.
    Improved(Quality),
    /// Nothing left worth doing: the ladder's end, or no further rung would change 0.1 % of the pixels. The output is final.
    Converged(Quality),
}

/// Owns all scratch memory for one shape.
#[derive(Debug)]
pub struct Matcher {
    level: Level,
    shape: Shape,
    params: Params,
    recipe: &'static Recipe,
    frame: Frame,
    /// Regions that come before the rest.
    regions: Regions,
    /// Rungs finished for the current pair; 0 before `base`.
    rungs_done: usize,
    /// Whether there is nothing left worth doing.
    is_done: bool,
    stage: Stage,
    quality: Quality,
    /// Pixels asked for, as counted at the first rung.
    asked: u32,
}

const NOTHING_YET: Quality = Quality {
    rung: 0,
    density: 0.0,
    estimate: 0.0,
    changed: 0.0,
};

impl Matcher {
    /// A matcher for images of `shape`; allocates all scratch.
    ///
    /// # Errors
    /// [`ParamsError`] if `params` don't validate.
    pub fn new(level: Level, shape: Shape, params: Params) -> Result<Self, ParamsError> {
        params.validate(shape)?;
        let recipe = Recipe::of(params.preset);
        let mut frame = Frame::default();
        frame.reshape(level, shape, &params, recipe);
        let mut regions = Regions::default();
        regions.reshape(shape, &params, recipe);
        Ok(Self {
            level,
            shape,
            params,
            recipe,
            frame,
            regions,
            rungs_done: 0,
            is_done: false,
            stage: Stage::Choose,
            quality: NOTHING_YET,
            asked: 0,
        })
    }

    /// The same matcher for another shape or other parameters; allocates only what has to grow.
    ///
    /// # Errors
    /// [`ParamsError`] if `params` don't validate; the matcher is then unchanged.
    pub fn reconfigure(&mut self, shape: Shape, params: Params) -> Result<(), ParamsError> {
        params.validate(shape)?;
        self.recipe = Recipe::of(params.preset);
        self.frame.reshape(self.level, shape, &params, self.recipe);
        self.regions.reshape(shape, &params, self.recipe);
        (self.shape, self.params) = (shape, params);
        (self.rungs_done, self.quality) = (0, NOTHING_YET);
        Ok(())
    }

    /// The shape it is made for.
    #[must_use]
    pub fn shape(&self) -> Shape {
        self.shape
    }

    /// The parameters it is made for.
    #[must_use]
    pub fn params(&self) -> &Params {
        &self.params
    }

    /// The instruction-set level its kernels run at.
    #[must_use]
    pub fn level(&self) -> Level {
        self.level
    }

    /// A valid, publishable result for `pair`: the ladder's first rung. Forgets the previous frame.
    ///
    /// # Errors
    /// [`MatchError::WrongShape`] if `pair` has another size than [`Self::shape`]; `out` is then untouched.
    pub fn base(
        &mut self,
        pair: StereoPair<'_>,
        out: &mut DisparityMap,
        join: &dyn ForkJoin,
    ) -> Result<Progress, MatchError> {
        self.base_by_stage(pair, out, join, &mut |_| ())
    }

    /// The same, calling `after` with the name of every stage when it is done: for benchmarks, which have a clock.
    ///
    /// # Errors
    /// As [`Self::base`].
    pub fn base_by_stage(
        &mut self,
        pair: StereoPair<'_>,
        out: &mut DisparityMap,
        join: &dyn ForkJoin,
        after: &mut dyn FnMut(&'static str),
    ) -> Result<Progress, MatchError> {
        let got = (pair.left().width_px(), pair.left().height_px());
        let expected = (self.shape.width_px(), self.shape.height_px());
        if got != expected {
            return Err(MatchError::WrongShape { expected, got });
        }
        (self.rungs_done, self.stage, self.quality) = (0, Stage::Choose, NOTHING_YET);
        self.is_done = false;
        self.regions.forget();
        self.frame.begin(pair, self.recipe, join);
        after("take in");
        loop {
            let stage = self.next_stage();
            let progress = self.step(pair, out, join);
            after(stage);
            if progress != Progress::Working {
                return Ok(progress);
            }
        }
    }

    /// Name of the stage that the next step belongs to.
    #[must_use]
    pub fn next_stage(&self) -> &'static str {
        if self.rungs_done > 0 && self.regions.are_left() {
            self.regions.stage().name()
        } else {
            self.stage.name()
        }
    }

    /// One bounded step towards the next rung. `pair` is the one given to [`Self::base`], and `out` holds its last result; without a `base` before, nothing
    /// is done and the answer is `Converged`; so it is for a pair of another size.
    pub fn refine(&mut self, pair: StereoPair<'_>, out: &mut DisparityMap, join: &dyn ForkJoin) -> Progress {
        let size = (pair.left().width_px(), pair.left().height_px());
        let is_same = size == (self.shape.width_px(), self.shape.height_px());
        if self.rungs_done == 0 || self.is_done || !is_same {
            return Progress::Converged(self.quality);
        }
        self.step(pair, out, join)
    }

    /// Rungs of the preset's ladder that the whole image has climbed.
    fn whole_rungs_done(&self) -> usize {
        self.rungs_done - self.regions.rungs_done()
    }

    /// Whether regions are further than the rest of the image.
    fn are_regions_ahead(&self) -> bool {
        self.regions.rungs_done() > 0 && self.whole_rungs_done() < self.recipe.rungs.len()
    }

    /// Triangulates the current result into `mesh`; empty before `base`.
    pub fn mesh(&mut self, params: &MeshParams, mesh: &mut Mesh) {
        mesh.vertices.clear();
        mesh.triangles.clear();
        if self.rungs_done > 0 {
            let rung = &self.recipe.rungs[self.whole_rungs_done() - 1];
            let is_ahead = self.are_regions_ahead();
            let regions = is_ahead.then_some(&mut self.regions);
            self.frame.write_mesh((rung, self.recipe), regions, params, mesh);
        }
    }

    fn step(&mut self, pair: StereoPair<'_>, out: &mut DisparityMap, join: &dyn ForkJoin) -> Progress {
        if self.rungs_done > 0 && self.regions.are_left() {
            if !self.regions.step(self.level, pair, self.recipe, join) {
                return Progress::Working;
            }
            let density = self.regions.publish(&self.frame, out, self.asked, join);
            self.rungs_done += 1;
            self.quality.rung += 1;
            self.quality.density = density;
            self.quality.changed = 1.0;
            return Progress::Improved(self.quality);
        }
        let rung = &self.recipe.rungs[self.whole_rungs_done()];
        if let Some(next) = self.frame.step(self.stage, rung, self.recipe, join) {
            self.stage = next;
            return Progress::Working;
        }
        let (of_frame, out_before) = ((self.shape, &self.params), (&mut *out, self.rungs_done > 0));
        let mut published = self.frame.publish(rung, self.recipe, of_frame, out_before, join);
        self.asked = published.asked;
        self.rungs_done += 1;
        if self.are_regions_ahead() {
            published.density = self.regions.publish(&self.frame, out, self.asked, join);
        }
        self.finish_rung(&published)
    }

    fn finish_rung(&mut self, published: &Published) -> Progress {
        self.stage = Stage::Choose;
        self.quality = Quality {
            rung: u8::try_from(self.rungs_done).unwrap_or(u8::MAX),
            density: published.density,
            // Confidences of one kind of rung never fall; between kinds the scale may.
            estimate: confidence::at(self.recipe.estimate, published.mean_confidence)
                .max(self.quality.estimate),
            changed: published.changed,
        };
        let left = &self.recipe.rungs[self.whole_rungs_done()..];
        let changed = published.changed;
        self.is_done = convergence::has_converged(left, changed, || self.frame.failed_share());
        if self.is_done {
            Progress::Converged(self.quality)
        } else {
            Progress::Improved(self.quality)
        }
    }
}
