//! The disparities of every rung.

use stereo::{
    Density, DisparityMap, DisparityRange, FIXED_PER_PX, Mesh, MeshParams, Params, Progress, Roi, Serial,
};

use super::{Pair, climb, matcher, share_within, share_within_half_px};

#[test]
fn a_fronto_parallel_wall_is_found_by_every_preset() {
    let pair = Pair::with_disparity(200, 120, |_| 23);
    for params in [Params::default(), Params::fast(), Params::paper()] {
        for (quality, map) in climb(&mut matcher(pair.shape(), params.clone()), &pair, &Serial) {
            assert!(quality.density > 0.8, "{:?}: {quality:?}", params.preset);
            // The leftmost 23 columns have no counterpart in the right view, and windows reach a little further.
            let right = share_within(0.75, 32, &map, |_| 23.0);
            assert!(right > 0.98, "{:?} rung {}: {right}", params.preset, quality.rung);
        }
    }
}

#[test]
fn bands_of_rows_at_different_disparities_are_told_apart() {
    let pair = Pair::with_disparity(240, 160, |y| i64::try_from(10 + y / 40 * 6).unwrap());
    let rungs = climb(&mut matcher(pair.shape(), Params::default()), &pair, &Serial);
    let right = share_within_half_px(&rungs.last().unwrap().1, |y| (10 + y / 40 * 6) as f32);
    // Within half a window of the three edges both bands explain a pixel about as well: 9 rows of 160 each.
    assert!(right > 0.85, "{right}");
}

#[test]
fn the_smallest_disparity_shifts_the_search() {
    let pair = Pair::with_disparity(260, 64, |_| 100);
    let range = DisparityRange {
        min_px: 90,
        count: 32,
    };
    let params = Params {
        range,
        ..Params::default()
    };
    let rungs = climb(&mut matcher(pair.shape(), params), &pair, &Serial);
    let (quality, map) = rungs.last().unwrap();
    assert!(share_within_half_px(map, |_| 100.0) > 0.98);
    assert!(quality.density > 0.5, "{quality:?}");
    assert!(
        map.fixed()
            .iter()
            .all(|&fixed| fixed == 0 || fixed >= 89 * FIXED_PER_PX)
    );
}

#[test]
fn a_textureless_pair_has_an_answer_of_zero_density() {
    let pair = Pair {
        left: vec![90; 80 * 60],
        right: vec![90; 80 * 60],
        width: 80,
        height: 60,
    };
    for params in [Params::default(), Params::fast(), Params::paper()] {
        let mut matcher = matcher(pair.shape(), params);
        for (quality, map) in climb(&mut matcher, &pair, &Serial) {
            assert_eq!((quality.density, quality.estimate), (0.0, 0.0));
            assert!(map.fixed().iter().all(|&fixed| fixed == 0));
        }
        let mut mesh = Mesh::default();
        matcher.mesh(&MeshParams::default(), &mut mesh);
        assert!(mesh.triangles.is_empty() && mesh.vertices.is_empty());
    }
}

#[test]
fn dense_output_has_a_disparity_everywhere_and_agrees_where_semi_dense_has_one() {
    let pair = Pair::with_disparity(150, 90, |y| 12 + i64::from(y > 45) * 9);
    let semi = climb(&mut matcher(pair.shape(), Params::default()), &pair, &Serial);
    let params = Params {
        density: Density::Dense,
        ..Params::default()
    };
    let dense = climb(&mut matcher(pair.shape(), params), &pair, &Serial);
    for ((_, semi), (_, dense)) in semi.iter().zip(&dense) {
        assert!(dense.fixed().iter().all(|&fixed| fixed > 0));
        assert!(
            semi.fixed()
                .iter()
                .zip(dense.fixed())
                .all(|(semi, dense)| *semi == 0 || semi == dense)
        );
    }
}

#[test]
fn minimum_confidence_keeps_a_subset_and_one_keeps_nothing() {
    let mut pair = Pair::with_disparity(150, 90, |_| 17);
    for (at, pixel) in pair.right.iter_mut().enumerate() {
        *pixel = pixel.wrapping_add(u8::try_from(at % 7 * (at / 150 % 5)).unwrap());
    }
    let mut last = usize::MAX;
    for min_confidence in [0.0, 0.25, 0.5, 0.75, 1.0] {
        let params = Params {
            min_confidence,
            ..Params::default()
        };
        let rungs = climb(&mut matcher(pair.shape(), params), &pair, &Serial);
        let map = &rungs.last().unwrap().1;
        let kept = map.fixed().iter().filter(|&&fixed| fixed > 0).count();
        assert!(kept <= last, "{kept} at {min_confidence}, {last} below");
        assert!(
            map.confidence()
                .iter()
                .all(|&c| c == 0 || f32::from(c) >= 255.0 * min_confidence)
        );
        last = kept;
    }
    assert_eq!(last, 0);
}

#[test]
fn a_region_of_interest_is_matched_alone_and_like_the_whole() {
    let pair = Pair::with_disparity(300, 160, |_| 21);
    let roi = Roi {
        x: 120,
        y: 50,
        width: 90,
        height: 60,
    };
    let params = Params {
        roi: Some(roi),
        ..Params::default()
    };
    let (quality, map) = climb(&mut matcher(pair.shape(), params), &pair, &Serial)
        .pop()
        .unwrap();
    let inside = |at: usize| (120..210).contains(&(at % 300)) && (50..110).contains(&(at / 300));
    assert!(
        map.fixed()
            .iter()
            .enumerate()
            .all(|(at, &fixed)| fixed == 0 || inside(at))
    );
    assert!(quality.density > 0.95, "{quality:?}");
    assert!(share_within_half_px(&map, |_| 21.0) > 0.99);
}

#[test]
fn quality_never_falls_and_rungs_are_counted() {
    let pair = Pair::with_disparity(220, 140, |y| 8 + i64::try_from(y % 37 / 12 * 11).unwrap());
    for params in [Params::default(), Params::fast(), Params::paper()] {
        let rungs = climb(&mut matcher(pair.shape(), params.clone()), &pair, &Serial);
        assert_eq!(rungs.len(), stereo::rung_names(params.preset).len());
        for (k, pair) in rungs.windows(2).enumerate() {
            assert!(
                pair[1].0.estimate >= pair[0].0.estimate,
                "{:?} after rung {}",
                params.preset,
                k + 1
            );
            assert_eq!(usize::from(pair[1].0.rung), k + 2);
            assert!(
                pair[1].0.changed > 0.001,
                "a rung that changes this much is worth it"
            );
        }
    }
}

#[test]
fn a_ladder_ends_where_no_rung_would_change_anything() {
    let same = Pair::with_disparity(220, 140, |_| 0);
    for params in [Params::default(), Params::fast(), Params::paper()] {
        let mut matcher = matcher(same.shape(), params.clone());
        let rungs = climb(&mut matcher, &same, &Serial);
        let last = rungs.last().unwrap();
        assert!(last.0.changed < 0.001, "{:?}: {:?}", params.preset, last.0);
        assert!(
            rungs.len() < stereo::rung_names(params.preset).len(),
            "{:?}",
            params.preset
        );
        let mut out = last.1.clone();
        let again = matcher.refine(same.views(), &mut out, &Serial);
        assert_eq!(
            (again, &out),
            (Progress::Converged(last.0), &last.1),
            "it stays so"
        );
        // The next frame is another matter.
        let other = Pair::with_disparity(220, 140, |y| 8 + i64::try_from(y % 37 / 12 * 11).unwrap());
        assert_eq!(
            climb(&mut matcher, &other, &Serial).len(),
            stereo::rung_names(params.preset).len()
        );
    }
}

#[test]
fn a_step_leaves_the_output_alone_until_its_rung_is_done() {
    let pair = Pair::with_disparity(640, 400, |y| 9 + i64::from(y > 200) * 14);
    let mut matcher = matcher(pair.shape(), Params::default());
    let mut out = DisparityMap::new(pair.shape());
    matcher.base(pair.views(), &mut out, &Serial).unwrap();
    let (mut steps, mut before) = (0, out.clone());
    loop {
        match matcher.refine(pair.views(), &mut out, &Serial) {
            Progress::Working => {
                steps += 1;
                assert_eq!(out, before);
            }
            Progress::Improved(_) => before = out.clone(),
            Progress::Converged(_) => break,
        }
    }
    assert!(steps > 8, "a frame of this size takes many steps, got {steps}");
    let last = out.clone();
    assert!(matches!(
        matcher.refine(pair.views(), &mut out, &Serial),
        Progress::Converged(_)
    ));
    assert_eq!(out, last);
}
