//! Regions that climb the ladder by themselves (see `focus`): a small frame for each in turn, whose result is kept.

use super::{Frame, Stage, Window};
use crate::confidence::{CostScale, rate_costs};
use crate::disparity::DisparityMap;
use crate::focus::Focus;
use crate::fork_join::ForkJoin;
use crate::image::{Roi, Shape, StereoPair};
use crate::ladder::Recipe;
use crate::params::Params;
use crate::publish::{self, Before, Record};
use crate::simd::Level;

/// The regions of a frame, and how far they are.
#[derive(Debug, Default)]
pub(crate) struct Regions {
    /// The frame's.
    shape: Option<Shape>,
    window: Window,
    /// The parameters of the region under way.
    params: Params,
    /// The heaviest first.
    order: Vec<Roi>,
    /// For each rung, how many of them are then done.
    ends: Vec<usize>,
    /// What works on one of them.
    inset: Frame,
    /// Regions done.
    done: usize,
    /// Rung and stage of the one under way.
    under_way: Option<(usize, Stage)>,
    /// Rungs of regions that are finished.
    rungs_done: usize,
    /// The results, as maps of the frame's window; elsewhere they mean nothing.
    maps: Maps,
    /// Scratch of the mesh.
    composed: Maps,
    published: Record,
}

/// Planes, disparities and confidences of a window.
#[derive(Debug, Default)]
pub(super) struct Maps {
    pub(super) interpolated: Vec<u16>,
    pub(super) disparity: Vec<u16>,
    pub(super) confidence: Vec<u8>,
}

impl Maps {
    /// Room for as many pixels.
    fn reshape(&mut self, pixels: usize) {
        self.interpolated.resize(pixels, 0);
        self.disparity.resize(pixels, 0);
        self.confidence.resize(pixels, 0);
    }
}

impl Regions {
    /// For frames of `shape`, of which none has been seen.
    pub(crate) fn reshape(&mut self, shape: Shape, params: &Params, recipe: &Recipe) {
        self.forget();
        (self.order, self.ends) = Focus::turns(&params.focus, recipe.rungs.len());
        if self.order.is_empty() {
            return;
        }
        self.shape = Some(shape);
        self.window = Window::of(shape, params);
        self.params = Params {
            focus: Vec::new(),
            ..params.clone()
        };
        self.maps.reshape(self.window.roi.area_px());
    }

    /// Forgets what was done.
    pub(crate) fn forget(&mut self) {
        (self.done, self.under_way, self.rungs_done) = (0, None, 0);
    }

    /// Whether there is something left to do.
    pub(crate) fn are_left(&self) -> bool {
        self.rungs_done < self.ends.len()
    }

    /// Rungs of regions that are finished.
    pub(crate) fn rungs_done(&self) -> usize {
        self.rungs_done
    }

    /// The next step's stage.
    pub(crate) fn stage(&self) -> Stage {
        self.under_way.map_or(Stage::Choose, |(_, stage)| stage)
    }

    /// One step towards the next of their rungs, and whether that is reached.
    pub(crate) fn step(
        &mut self,
        level: Level,
        pair: StereoPair<'_>,
        recipe: &Recipe,
        join: &dyn ForkJoin,
    ) -> bool {
        let (Some(shape), Some(region)) = (self.shape, self.order.get(self.done)) else {
            return true;
        };
        let Some((rung, stage)) = self.under_way else {
            self.params.roi = Some(*region);
            self.inset.reshape(level, shape, &self.params, recipe);
            self.inset.begin(pair, recipe, join);
            self.under_way = Some((0, Stage::Choose));
            return false;
        };
        if let Some(next) = self.inset.step(stage, &recipe.rungs[rung], recipe, join) {
            self.under_way = Some((rung, next));
            return false;
        }
        if rung + 1 < recipe.rungs.len() {
            self.under_way = Some((rung + 1, Stage::Choose));
            return false;
        }
        self.keep(*region, rung, recipe, join);
        self.under_way = None;
        self.done += 1;
        let is_rung = self.ends.get(self.rungs_done) == Some(&self.done);
        self.rungs_done += usize::from(is_rung);
        is_rung
    }

    /// Keeps the result of a region that is done.
    fn keep(&mut self, region: Roi, rung: usize, recipe: &Recipe, join: &dyn ForkJoin) {
        let (inset, scale) = (&mut self.inset, CostScale::of(recipe));
        if super::is_dense(&recipe.rungs[rung]) {
            inset.rate_dense(&recipe.rungs[rung], scale, join);
        } else {
            rate_costs(inset.level, scale, &inset.cost, &mut inset.confidence);
        }
        for y in region.y..region.y + region.height {
            let from = columns(&inset.window, region, y);
            let to = columns(&self.window, region, y);
            self.maps.interpolated[to.clone()].copy_from_slice(&inset.interpolated[from.clone()]);
            self.maps.disparity[to.clone()].copy_from_slice(&inset.disparity[from.clone()]);
            self.maps.confidence[to].copy_from_slice(&inset.confidence[from]);
        }
    }

    /// Writes the results of the regions done over those of `frame` in `out`; the answer is the share of `asked` pixels that
    /// have a disparity then.
    pub(crate) fn publish(
        &mut self,
        frame: &Frame,
        out: &mut DisparityMap,
        asked: u32,
        join: &dyn ForkJoin,
    ) -> f32 {
        let Some(shape) = self.shape else { return 0.0 };
        let done = self.ends[..self.rungs_done].last().copied().unwrap_or(0);
        for region in &self.order[..done] {
            self.params.roi = Some(*region);
            let maps = publish::Maps {
                window: self.window,
                mask: &frame.gradient.mask,
                interpolated: &self.maps.interpolated,
                disparity: &self.maps.disparity,
                confidence: publish::Confidence::Known(&self.maps.confidence),
            };
            let out = (&mut *out, Before::Result, &mut self.published);
            publish::publish(frame.level, &maps, (shape, &self.params), out, join);
        }
        let answered = out.fixed().iter().filter(|&&fixed| fixed > 0).count();
        answered as f32 / asked.max(1) as f32
    }

    /// The maps of `frame` with the results of the regions done in them, for a mesh: the planes are what it is made from, a
    /// confidence of 1 confirms. `is_dense` as the frame's last rung.
    pub(super) fn compose(&mut self, frame: &Frame, is_dense: bool, recipe: &Recipe) -> &Maps {
        let Self { composed, .. } = self;
        let planes = if is_dense {
            &frame.disparity
        } else {
            &frame.interpolated
        };
        composed.interpolated.clone_from(planes);
        composed.disparity.clone_from(&frame.disparity);
        composed.confidence.clone_from(&frame.confidence);
        let confirm = |confidence: &mut [u8], is_dense| {
            let from = super::confirmed_from(is_dense);
            confidence.iter_mut().for_each(|c| *c = u8::from(*c >= from));
        };
        confirm(&mut composed.confidence, is_dense);
        let is_dense = recipe.rungs.last().is_some_and(super::is_dense);
        for region in &self.order[..self.ends[..self.rungs_done].last().copied().unwrap_or(0)] {
            for y in region.y..region.y + region.height {
                let row = columns(&self.window, *region, y);
                let (from, to) = (&self.maps, &mut self.composed);
                let planes = if is_dense {
                    &from.disparity
                } else {
                    &from.interpolated
                };
                to.interpolated[row.clone()].copy_from_slice(&planes[row.clone()]);
                to.disparity[row.clone()].copy_from_slice(&from.disparity[row.clone()]);
                to.confidence[row.clone()].copy_from_slice(&from.confidence[row.clone()]);
                confirm(&mut to.confidence[row], is_dense);
            }
        }
        &self.composed
    }
}

/// Row `y` of `region` in a map of `window`.
fn columns(window: &Window, region: Roi, y: usize) -> std::ops::Range<usize> {
    let start = (y - window.roi.y) * window.roi.width + region.x - window.roi.x;
    start..start + region.width
}
