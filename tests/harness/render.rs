//! Renders both views of a scene by ray casting, with exact ground truth.
//!
//! A ray through every sub-pixel sample meets the nearest surface; its texture is a continuous function of the point
//! that was hit, so the views agree at any sub-pixel disparity. The true disparity is the left ray's through the pixel's
//! centre, and the pixel is non-occluded when the right camera's ray to the same point meets nothing before it.

use crate::degrade::{Degradation, quantized};
use crate::gray::GrayImage;
use crate::scene::{Rig, Scene};
use crate::truth::TruthMap;

/// Sub-pixel samples in each direction.
const SAMPLES: u32 = 3;

/// A rendered pair with its ground truth.
#[derive(Debug, Clone, PartialEq)]
pub struct RenderedPair {
    /// The left view.
    pub left: GrayImage,
    /// The right view.
    pub right: GrayImage,
    /// Exact disparity of every pixel of the left view that the right view sees too.
    pub truth: TruthMap,
    /// Exact disparity of every pixel of the left view.
    pub truth_with_occluded: TruthMap,
}

impl RenderedPair {
    /// Renders a clean pair.
    #[must_use]
    pub fn clean(scene: &Scene) -> Self {
        Self::new(scene, &Degradation::NONE)
    }

    /// Renders a pair and degrades it.
    #[must_use]
    #[expect(
        clippy::missing_panics_doc,
        reason = "it can't: all buffers have the rig's size"
    )]
    pub fn new(scene: &Scene, degradation: &Degradation) -> Self {
        let rig = &scene.rig;
        let mut left = render_view(
            scene,
            &View {
                x_m: 0.0,
                lower_px: 0.0,
            },
        );
        let mut right = render_view(
            scene,
            &View {
                x_m: rig.baseline_m,
                lower_px: degradation.misaligned_px,
            },
        );
        degradation.degrade(&mut left, &mut right, rig.width_px);
        let (all, seen) = true_disparities(scene);
        let map = |px| TruthMap::new(rig.width_px, rig.height_px, px).expect("one disparity a pixel");
        let image = |gray: &[f64]| {
            GrayImage::new(
                rig.width_px,
                rig.height_px,
                gray.iter().map(|&g| quantized(g)).collect(),
            )
            .expect("one gray value a pixel")
        };
        Self {
            left: image(&left),
            right: image(&right),
            truth: map(seen),
            truth_with_occluded: map(all),
        }
    }
}

/// One of the two cameras.
struct View {
    x_m: f64,
    lower_px: f64,
}

impl View {
    fn origin(&self) -> [f64; 3] {
        [self.x_m, 0.0, 0.0]
    }
}

/// The ray through column `x`, row `y`; its z is 1, so a hit's `t` is its depth.
fn ray(rig: &Rig, x: f64, y: f64) -> [f64; 3] {
    let (cx, cy) = rig.principal_px();
    [(x - cx) / rig.focal_px, (y - cy) / rig.focal_px, 1.0]
}

fn render_view(scene: &Scene, view: &View) -> Vec<f64> {
    let rig = &scene.rig;
    let mut pixels = Vec::with_capacity(rig.width_px * rig.height_px);
    let offset = |sample: u32| (f64::from(sample) + 0.5) / f64::from(SAMPLES) - 0.5;
    for y in 0..rig.height_px {
        for x in 0..rig.width_px {
            let mut sum = 0.0;
            for sample in 0..SAMPLES * SAMPLES {
                let direction = ray(
                    rig,
                    x as f64 + offset(sample % SAMPLES),
                    y as f64 + offset(sample / SAMPLES) - view.lower_px,
                );
                sum += gray_along(scene, view.origin(), direction);
            }
            pixels.push(sum / f64::from(SAMPLES * SAMPLES));
        }
    }
    pixels
}

fn gray_along(scene: &Scene, origin: [f64; 3], direction: [f64; 3]) -> f64 {
    nearest(scene, origin, direction).map_or(0.0, |(depth_m, solid)| {
        let point = std::array::from_fn(|i| origin[i] + depth_m * direction[i]);
        scene.solids[solid].1.gray(point, depth_m / scene.rig.focal_px)
    })
}

/// Depth in metres and index of the nearest surface along a ray.
fn nearest(scene: &Scene, origin: [f64; 3], direction: [f64; 3]) -> Option<(f64, usize)> {
    scene
        .solids
        .iter()
        .enumerate()
        .filter_map(|(i, (surface, _))| Some((surface.first_hit(origin, direction)?, i)))
        .min_by(|a, b| a.0.total_cmp(&b.0))
}

/// The disparities of all pixels, and of those the right camera sees.
fn true_disparities(scene: &Scene) -> (Vec<f32>, Vec<f32>) {
    let rig = &scene.rig;
    let right = View {
        x_m: rig.baseline_m,
        lower_px: 0.0,
    };
    let mut all = Vec::with_capacity(rig.width_px * rig.height_px);
    let mut seen = Vec::with_capacity(rig.width_px * rig.height_px);
    for y in 0..rig.height_px {
        for x in 0..rig.width_px {
            let (x, y) = (x as f64, y as f64);
            let Some((depth_m, _)) = nearest(scene, [0.0; 3], ray(rig, x, y)) else {
                all.push(0.0);
                seen.push(0.0);
                continue;
            };
            let disparity = rig.disparity_px(depth_m);
            let x_right = x - disparity;
            let first_m = nearest(scene, right.origin(), ray(rig, x_right, y)).map(|(m, _)| m);
            let visible = x_right >= 0.0 && first_m.is_some_and(|m| m > depth_m * (1.0 - 1e-6));
            all.push(single(disparity));
            seen.push(if visible { single(disparity) } else { 0.0 });
        }
    }
    (all, seen)
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "ground truth needs no more than single precision"
)]
fn single(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests {
    use super::RenderedPair;
    use crate::degrade::Degradation;
    use crate::scene::Scene;
    use crate::score::high_gradient;

    /// Mean absolute gray difference between the left view and the right view warped by `shift_px` + truth.
    fn warp_error(pair: &RenderedPair, shift_px: f32) -> f64 {
        let (width, mut sum, mut count) = (pair.left.width_px(), 0.0, 0.0);
        for (i, &d) in pair
            .truth
            .disparity_px
            .iter()
            .enumerate()
            .filter(|(_, d)| **d > 0.0)
        {
            let x_right = (i % width) as f32 - d + shift_px;
            if x_right < 0.0 || x_right + 1.0 >= width as f32 {
                continue;
            }
            let row = &pair.right.pixels()[i / width * width..][..width];
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "checked above"
            )]
            let (at, t) = (x_right as usize, f64::from(x_right.fract()));
            let warped = f64::from(row[at]) * (1.0 - t) + f64::from(row[at + 1]) * t;
            sum += (warped - f64::from(pair.left.pixels()[i])).abs();
            count += 1.0;
        }
        sum / count
    }

    #[test]
    fn the_right_view_warped_by_the_truth_is_the_left_view() {
        for scene in Scene::all() {
            let pair = RenderedPair::clean(&scene);
            let right = warp_error(&pair, 0.0);
            assert!(right < 6.0, "{}: {right}", scene.name);
            for shift_px in [-1.0, 1.0] {
                assert!(
                    warp_error(&pair, shift_px) > 1.5 * right,
                    "{}: {shift_px}",
                    scene.name
                );
            }
        }
    }

    #[test]
    fn every_scene_has_texture_and_non_occluded_truth_inside_the_searched_range() {
        for scene in Scene::all() {
            let pair = RenderedPair::clean(&scene);
            let share = |n: usize| n as f64 / pair.left.pixels().len() as f64;
            let strong = share(high_gradient(&pair.left).iter().filter(|s| **s).count());
            let known = share(pair.truth.disparity_px.iter().filter(|d| **d > 0.0).count());
            assert!(strong > 0.25, "{}: {strong}", scene.name);
            assert!((0.75..0.99).contains(&known), "{}: {known}", scene.name);
            assert!(
                pair.truth.disparity_px.iter().all(|d| *d < 120.0),
                "{}",
                scene.name
            );
        }
    }

    #[test]
    fn analytic_visibility_agrees_with_the_z_buffer() {
        for scene in Scene::all() {
            let pair = RenderedPair::clean(&scene);
            let buffered = pair.truth_with_occluded.visible_in_right();
            let differ = pair
                .truth
                .disparity_px
                .iter()
                .zip(&buffered)
                .filter(|(d, seen)| (**d > 0.0) != **seen)
                .count();
            assert!(differ * 100 < buffered.len(), "{}: {differ} pixels", scene.name);
        }
    }

    #[test]
    fn rendering_twice_gives_the_same_bytes() {
        let degraded = Degradation {
            noise_sigma: 4.0,
            gain: 1.2,
            ..Degradation::NONE
        };
        let scene = Scene::sphere();
        assert_eq!(
            RenderedPair::new(&scene, &degraded),
            RenderedPair::new(&scene, &degraded)
        );
    }

    #[test]
    fn misalignment_moves_the_right_view_down() {
        let lower = Degradation {
            misaligned_px: 2.0,
            ..Degradation::NONE
        };
        let (clean, low) = (
            RenderedPair::clean(&Scene::sphere()),
            RenderedPair::new(&Scene::sphere(), &lower),
        );
        let rows = clean.right.width_px();
        assert_eq!(
            clean.right.pixels()[..100 * rows],
            low.right.pixels()[2 * rows..102 * rows]
        );
        assert_eq!(clean.left, low.left);
    }
}
