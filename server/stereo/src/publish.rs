//! Writes a rung's result: disparities of the pixels asked for, their confidence, and what is known about the whole.

use crate::confidence;
use crate::disparity::{DisparityMap, FIXED_PER_PX};
use crate::frame::Window;
use crate::image::{Roi, Shape};
use crate::ladder::Recipe;
use crate::params::{Density, Params};

/// The window's maps.
#[derive(Debug)]
pub(crate) struct Maps<'a> {
    pub(crate) window: Window,
    pub(crate) mask: &'a [u8],
    pub(crate) interpolated: &'a [u16],
    pub(crate) disparity: &'a [u16],
    pub(crate) cost: &'a [u8],
}

/// See [`Quality`](crate::Quality).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Published {
    pub(crate) density: f32,
    pub(crate) estimate: f32,
}

/// Fills `out`: in the region of interest, pixels that are validated get their disparity; dense output gets the mesh's
/// plane, with confidence 0, where there is none.
pub(crate) fn publish(
    maps: &Maps<'_>,
    shape: Shape,
    params: &Params,
    recipe: &Recipe,
    out: &mut DisparityMap,
) -> Published {
    let valid_up_to = recipe.valid_up_to;
    let roi = params.roi.unwrap_or(Roi::full(shape));
    if roi == Roi::full(shape) && out.shape() == shape {
        // Every pixel is written below.
    } else {
        out.reset(shape);
    }
    let window = maps.window.roi;
    let dense = params.density == Density::Dense;
    let offset = params.range.min_px * FIXED_PER_PX;
    #[expect(clippy::cast_possible_truncation, reason = "between 0 and 255")]
    #[expect(clippy::cast_sign_loss, reason = "between 0 and 255")]
    let least_confidence = (255.0 * params.min_confidence).ceil() as u8;
    let confidence_of: [u8; 256] = std::array::from_fn(|cost| {
        confidence::confidence(
            u8::try_from(cost).unwrap_or(u8::MAX),
            recipe.half_confidence_at,
            valid_up_to,
        )
    });
    let (fixed, confidence) = out.parts_mut();
    let (mut asked, mut answered) = (0usize, 0usize);
    // Mask pixels by cost, for the estimate.
    let mut histogram = [0u32; 256];
    for y in roi.y..roi.y + roi.height {
        let from = (y - window.y) * window.width + roi.x - window.x;
        let span = from..from + roi.width;
        let (mask, cost) = (&maps.mask[span.clone()], &maps.cost[span.clone()]);
        let (interpolated, disparity) = (&maps.interpolated[span.clone()], &maps.disparity[span]);
        let target = y * shape.width_px() + roi.x;
        let fixed = &mut fixed[target..target + roi.width];
        let confidence = &mut confidence[target..target + roi.width];
        for x in 0..roi.width {
            let valid = cost[x] <= valid_up_to;
            let sure = if valid {
                confidence_of[usize::from(cost[x])]
            } else {
                0
            };
            let wanted = dense || mask[x] != 0;
            let kept = wanted && (dense || valid) && sure >= least_confidence;
            let value = (if valid { disparity[x] } else { interpolated[x] } + offset).max(1);
            fixed[x] = if kept { value } else { 0 };
            confidence[x] = if kept { sure } else { 0 };
            asked += usize::from(wanted);
            answered += usize::from(kept);
            histogram[usize::from(cost[x])] += u32::from(mask[x]);
        }
    }
    Published {
        density: share(answered, asked),
        estimate: estimate(&histogram, recipe),
    }
}

/// Mean probability of being right over the mask's pixels; what is not validated counts as wrong.
fn estimate(histogram: &[u32; 256], recipe: &Recipe) -> f32 {
    let (mut all, mut right) = (0.0, 0.0);
    for (&pixels, cost) in histogram.iter().zip(0..=u8::MAX) {
        let pixels = pixels as f32;
        all += pixels;
        if cost <= recipe.valid_up_to {
            right += pixels * confidence::at(recipe.probability, cost);
        }
    }
    if all > 0.0 { right / all } else { 0.0 }
}

fn share(part: usize, whole: usize) -> f32 {
    if whole == 0 {
        0.0
    } else {
        part as f32 / whole as f32
    }
}

#[cfg(test)]
mod tests;
