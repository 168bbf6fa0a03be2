//! Clean rendered scenes.

use stereo::{Density, Params, Preset, rung_names};

use crate::{CLEAN, matched};

/// Least percentages for one scene at the default preset.
struct Bounds {
    scene: &'static str,
    /// All <3 px after the first rung and after the whole ladder.
    all_3_px: (f64, f64),
    /// Returned <1 px after the first rung and after the whole ladder.
    returned_1_px: (f64, f64),
    /// Largest share of wrong pixels (D1) of the whole ladder's dense map.
    dense_d1: f64,
}

const DEFAULT: [Bounds; 5] = [
    Bounds {
        scene: "slanted planes",
        all_3_px: (99.3, 99.6),
        returned_1_px: (98.0, 98.5),
        dense_d1: 0.5,
    },
    Bounds {
        scene: "road with boxes and poles",
        all_3_px: (88.5, 95.5),
        returned_1_px: (83.0, 93.0),
        dense_d1: 4.0,
    },
    Bounds {
        scene: "step edge",
        all_3_px: (97.0, 99.0),
        returned_1_px: (94.5, 97.0),
        dense_d1: 1.0,
    },
    Bounds {
        scene: "sphere",
        all_3_px: (90.0, 97.5),
        returned_1_px: (88.5, 96.0),
        dense_d1: 2.0,
    },
    Bounds {
        scene: "repeated texture",
        all_3_px: (99.0, 99.0),
        returned_1_px: (98.5, 98.5),
        dense_d1: 1.0,
    },
];

fn ladder(preset: Preset) -> u8 {
    u8::try_from(rung_names(preset).len()).expect("a ladder has at most 8 rungs")
}

#[test]
fn the_default_preset_keeps_its_bounds_on_every_scene() {
    let whole = ladder(Preset::Default);
    for bounds in DEFAULT {
        let (_, pair) = CLEAN
            .iter()
            .find(|(s, _)| s.name == bounds.scene)
            .expect("a named scene");
        for (rungs, all_3_px, returned_1_px) in [
            (1, bounds.all_3_px.0, bounds.returned_1_px.0),
            (whole, bounds.all_3_px.1, bounds.returned_1_px.1),
        ] {
            let got = matched(pair, Params::default(), rungs);
            let all = got.score.edges.all[1];
            assert!(
                all >= all_3_px,
                "{}, {rungs} rungs: all <3 px {all:.2}",
                bounds.scene
            );
            assert!(
                got.within_1_px >= returned_1_px,
                "{}, {rungs} rungs: {:.2}",
                bounds.scene,
                got.within_1_px
            );
        }
    }
}

#[test]
fn dense_maps_have_every_pixel_and_few_wrong_ones() {
    for bounds in DEFAULT {
        let (_, pair) = CLEAN
            .iter()
            .find(|(s, _)| s.name == bounds.scene)
            .expect("a named scene");
        let params = Params {
            density: Density::Dense,
            ..Params::default()
        };
        let got = matched(pair, params, u8::MAX);
        assert!(
            got.disparity_px.iter().all(|d| *d > 0.0),
            "{}: a pixel is missing",
            bounds.scene
        );
        let d1 = got.score.dense.d1;
        assert!(d1 <= bounds.dense_d1, "{}: D1 {d1:.2}", bounds.scene);
    }
}

#[test]
fn the_paper_preset_matches_every_scene() {
    for (scene, pair) in CLEAN.iter() {
        let got = matched(pair, Params::paper(), u8::MAX);
        let all = got.score.edges.all[1];
        assert!(all >= 94.5, "{}: all <3 px {all:.2}", scene.name);
    }
}

#[test]
fn more_rungs_never_lower_the_estimate_and_hardly_ever_the_accuracy() {
    for (scene, pair) in CLEAN.iter() {
        for preset in [Preset::Default, Preset::Fast, Preset::Paper] {
            let params = Params {
                preset,
                ..Params::default()
            };
            let mut before: Option<crate::Outcome> = None;
            for rungs in 1..=ladder(preset) {
                let got = matched(pair, params.clone(), rungs);
                let name = format!("{}, {preset:?}, rung {rungs}", scene.name);
                assert!(
                    (0.0..=1.0).contains(&got.quality.estimate),
                    "{name}: {}",
                    got.quality.estimate
                );
                if let Some(before) = &before {
                    assert!(got.quality.estimate >= before.quality.estimate, "{name}");
                    let (was, is) = (before.score.edges.all[1], got.score.edges.all[1]);
                    assert!(is >= was - 0.2, "{name}: {was:.2} -> {is:.2}");
                }
                before = Some(got);
            }
        }
    }
}

#[test]
fn the_whole_ladder_beats_the_first_rung_where_depth_jumps() {
    for name in ["road with boxes and poles", "step edge", "sphere"] {
        let pair = crate::clean(name);
        let first = matched(pair, Params::default(), 1).score.edges.all[1];
        let last = matched(pair, Params::default(), u8::MAX).score.edges.all[1];
        assert!(last >= first + 1.0, "{name}: {first:.2} -> {last:.2}");
    }
}
