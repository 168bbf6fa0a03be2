//! A matcher and the buffers it works with: everything that belongs to one frame under way.

use std::time::Instant;

use stereo::{DisparityMap, ForkJoin, GrayView, Level, Matcher, Mesh, Params, Progress, Shape, StereoPair};

use super::half;
use crate::decode::{self, GrayScratch, Side};
use crate::job::FrameRequest;
use crate::status::ServiceError;

/// Reused from frame to frame; as large as the largest one it has seen.
#[derive(Default)]
pub(super) struct Rig {
    matcher: Option<Matcher>,
    left: GrayScratch,
    right: GrayScratch,
    /// Both images at half resolution, and their map.
    half: Option<half::Half>,
    map: Option<DisparityMap>,
    pub(super) mesh: Mesh,
    is_half: bool,
    largest_px: usize,
}

impl Rig {
    /// Makes both images gray, and small if they are to be matched so; then everything is ready for [`base`](Self::base).
    pub(super) fn load(
        &mut self,
        level: Level,
        request: &FrameRequest,
        is_half: bool,
    ) -> Result<(), ServiceError> {
        let left = decode::gray(Side::Left, &request.left, &mut self.left)?;
        let right = decode::gray(Side::Right, &request.right, &mut self.right)?;
        // Sizes have been compared when the request came in, but a file may hold something else than its header says.
        StereoPair::new(left, right).map_err(unmatchable)?;
        let shape = Shape::new(left.width_px(), left.height_px()).map_err(unmatchable)?;
        self.largest_px = self.largest_px.max(shape.area_px());
        self.is_half = is_half;
        let params = &request.options.params;
        if is_half {
            let half = self.half.get_or_insert_with(half::Half::default);
            half.load(left, right)?;
            fit(
                &mut self.matcher,
                level,
                half.shape()?,
                half::params(params, half.shape()?),
            )?;
        } else {
            fit(&mut self.matcher, level, shape, params.clone())?;
        }
        match &mut self.map {
            Some(map) if map.shape() == shape => {}
            Some(map) => map.reset(shape),
            None => self.map = Some(DisparityMap::new(shape)),
        }
        Ok(())
    }

    /// Pixels of the largest frame it has seen.
    pub(super) fn largest_px(&self) -> usize {
        self.largest_px
    }

    /// The first rung, or one more step after it.
    pub(super) fn step(
        &mut self,
        request: &FrameRequest,
        is_first: bool,
        join: &dyn ForkJoin,
    ) -> Result<Progress, ServiceError> {
        let missing = || ServiceError::Internal("a frame was matched before it was loaded".to_owned());
        let matcher = self.matcher.as_mut().ok_or_else(missing)?;
        let full;
        let (pair, map) = if self.is_half {
            self.half.as_mut().ok_or_else(missing)?.pair_and_map()?
        } else {
            let left = decode::decoded(Side::Left, &request.left, &self.left)?;
            full = StereoPair::new(left, decode::decoded(Side::Right, &request.right, &self.right)?)
                .map_err(unmatchable)?;
            (full, self.map.as_mut().ok_or_else(missing)?)
        };
        match is_first {
            true => matcher.base(pair, map, join).map_err(unmatchable),
            false => Ok(matcher.refine(pair, map, join)),
        }
    }

    /// Brings the map, and the mesh if one is wanted, to the size of the images; when the mesh was made.
    pub(super) fn finish(&mut self, request: &FrameRequest, has_mesh: bool) -> Option<Instant> {
        let params = &request.options.params;
        if self.is_half
            && let (Some(half), Some(map)) = (&self.half, &mut self.map)
        {
            half.enlarge_map(params, map);
        }
        let matcher = self.matcher.as_mut().filter(|_| has_mesh)?;
        let mesh = &request.options.mesh;
        if self.is_half {
            matcher.mesh(&half::mesh_params(mesh), &mut self.mesh);
            half::enlarge_mesh(&mut self.mesh);
        } else {
            matcher.mesh(mesh, &mut self.mesh);
        }
        Some(Instant::now())
    }

    /// The left image in gray and the final map.
    pub(super) fn result<'a>(
        &'a self,
        request: &'a FrameRequest,
    ) -> Result<(GrayView<'a>, &'a DisparityMap), ServiceError> {
        let map = self.map.as_ref();
        let map = map.ok_or_else(|| ServiceError::Internal("a frame has no map".to_owned()))?;
        Ok((decode::decoded(Side::Left, &request.left, &self.left)?, map))
    }
}

/// Makes the matcher one for `shape` and `params`; nothing is allocated if it is already.
fn fit(slot: &mut Option<Matcher>, level: Level, shape: Shape, params: Params) -> Result<(), ServiceError> {
    match slot {
        Some(matcher) if matcher.shape() == shape && *matcher.params() == params => Ok(()),
        Some(matcher) => matcher.reconfigure(shape, params).map_err(unmatchable),
        None => {
            *slot = Some(Matcher::new(level, shape, params).map_err(unmatchable)?);
            Ok(())
        }
    }
}

/// Sizes and parameters that the core refuses, in its own words.
pub(super) fn unmatchable(error: impl ToString) -> ServiceError {
    ServiceError::Unmatchable(error.to_string())
}
