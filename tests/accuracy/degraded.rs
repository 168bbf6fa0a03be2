//! What cameras do to a pair costs accuracy, but never all of it.

use stereo::Params;
use stereo_tests::degrade::Degradation;
use stereo_tests::render::RenderedPair;
use stereo_tests::scene::Scene;

use crate::{clean, matched};

/// The scenes with the least and the most depth discontinuities.
fn scenes() -> [Scene; 2] {
    [Scene::step_edge(), Scene::road()]
}

/// Asserts that the whole ladder loses at most `loss` points of all <3 px against the clean pair.
fn assert_loses_at_most(loss: f64, degradation: &Degradation) {
    for scene in scenes() {
        let pair = RenderedPair::new(&scene, degradation);
        let before = matched(clean(scene.name), Params::default(), u8::MAX)
            .score
            .edges
            .all[1];
        let after = matched(&pair, Params::default(), u8::MAX).score.edges.all[1];
        assert!(
            after >= before - loss,
            "{}: {before:.2} -> {after:.2} with {degradation:?}",
            scene.name
        );
    }
}

#[test]
fn an_exposure_difference_costs_less_than_a_point() {
    assert_loses_at_most(
        1.0,
        &Degradation {
            gain: 1.3,
            offset: 15.0,
            ..Degradation::NONE
        },
    );
    assert_loses_at_most(
        1.0,
        &Degradation {
            gain: 0.7,
            offset: -20.0,
            ..Degradation::NONE
        },
    );
}

#[test]
fn noise_of_sigma_8_costs_less_than_three_points() {
    assert_loses_at_most(
        3.0,
        &Degradation {
            noise_sigma: 8.0,
            ..Degradation::NONE
        },
    );
}

#[test]
fn blur_in_one_view_costs_less_than_two_points() {
    assert_loses_at_most(
        2.0,
        &Degradation {
            blur_sigma_px: 1.0,
            ..Degradation::NONE
        },
    );
}

#[test]
fn vertical_misalignment_declines_gracefully() {
    assert_loses_at_most(
        7.0,
        &Degradation {
            misaligned_px: 1.0,
            ..Degradation::NONE
        },
    );
    assert_loses_at_most(
        28.0,
        &Degradation {
            misaligned_px: 2.0,
            ..Degradation::NONE
        },
    );
}

#[test]
fn a_textureless_pair_is_an_answer_with_zero_density() {
    let pair = RenderedPair::clean(&Scene::textureless());
    let got = matched(&pair, Params::default(), u8::MAX);
    assert_eq!(got.quality.density, 0.0);
    assert!(got.disparity_px.iter().all(|d| d.is_nan()));
}
