//! Accuracy bounds of the core: on rendered scenes always, on real ones where they are.

mod degraded;
mod options;
mod real;
mod rendered;

use std::sync::LazyLock;

use stereo::{Params, Quality};
use stereo_tests::matching::Bench;
use stereo_tests::render::RenderedPair;
use stereo_tests::scene::Scene;
use stereo_tests::score::{self, Score};

/// Every named scene, rendered once for all tests.
static CLEAN: LazyLock<Vec<(Scene, RenderedPair)>> = LazyLock::new(|| {
    Scene::all()
        .into_iter()
        .map(|scene| {
            let pair = RenderedPair::clean(&scene);
            (scene, pair)
        })
        .collect()
});

fn clean(name: &str) -> &'static RenderedPair {
    let (_, pair) = CLEAN
        .iter()
        .find(|(scene, _)| scene.name == name)
        .expect("a named scene");
    pair
}

/// What one match gave.
struct Outcome {
    score: Score,
    /// Share of the returned pixels with ground truth that are within 1 px, in percent.
    within_1_px: f64,
    quality: Quality,
    disparity_px: Vec<f32>,
}

fn matched(pair: &RenderedPair, params: Params, max_rungs: u8) -> Outcome {
    let mut bench = Bench::new(&pair.left, params).expect("good parameters");
    let run = bench
        .run(&pair.left, &pair.right, max_rungs)
        .expect("a pair of the bench's size");
    let returned: Vec<bool> = (run.disparity_px.iter().zip(&pair.truth.disparity_px))
        .filter(|(got, truth)| got.is_finite() && **truth > 0.0)
        .map(|(got, truth)| (got - truth).abs() < 1.0)
        .collect();
    let good = returned.iter().filter(|good| **good).count();
    Outcome {
        score: score::score(&run.disparity_px, &pair.left, &pair.truth.disparity_px),
        within_1_px: 100.0 * good as f64 / returned.len().max(1) as f64,
        quality: *run.rungs.last().expect("the base is always a rung"),
        disparity_px: run.disparity_px,
    }
}
