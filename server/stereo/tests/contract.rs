//! What a caller may rely on, whatever the images: the contract of `Matcher`.
#![expect(clippy::unwrap_used, reason = "tests")]

use proptest::prelude::*;
use stereo::{
    Density, DisparityMap, DisparityRange, FIXED_PER_PX, Focus, ForkJoin, GrayView, Level, MatchError,
    Matcher, Mesh, MeshParams, Params, Preset, Progress, Quality, Roi, Serial, Shape, StereoPair,
};

/// A textured pair: what the left view shows at `x`, the right shows at `x - disparity(y)`.
struct Pair {
    left: Vec<u8>,
    right: Vec<u8>,
    width: usize,
    height: usize,
}

/// Smooth noise: whole-number hashes of a 3 px grid, with lines between.
fn texture(x: i64, y: i64) -> u8 {
    let hash = |x: i64, y: i64| {
        let mut v =
            (x.wrapping_mul(0x9E37_79B9) ^ y.wrapping_mul(0x85EB_CA6B)).wrapping_mul(0x27D4_EB2F_1656_67C5);
        v ^= v >> 29;
        (v.wrapping_mul(0x1656_67B1_9E37_79F9) >> 40) & 0xFF
    };
    let (cx, cy, fx, fy) = (x.div_euclid(3), y.div_euclid(3), x.rem_euclid(3), y.rem_euclid(3));
    let row = |cy| hash(cx, cy) * (3 - fx) + hash(cx + 1, cy) * fx;
    u8::try_from((row(cy) * (3 - fy) + row(cy + 1) * fy) / 9).unwrap()
}

impl Pair {
    fn with_disparity(width: usize, height: usize, disparity: impl Fn(usize) -> i64) -> Self {
        let pixels = |shifted: bool| {
            (0..width * height)
                .map(|at| {
                    let (x, y) = (at % width, at / width);
                    let shift = if shifted { disparity(y) } else { 0 };
                    texture(i64::try_from(x).unwrap() + shift, i64::try_from(y).unwrap())
                })
                .collect()
        };
        Self {
            left: pixels(false),
            right: pixels(true),
            width,
            height,
        }
    }

    fn shape(&self) -> Shape {
        Shape::new(self.width, self.height).unwrap()
    }

    fn views(&self) -> StereoPair<'_> {
        let view = |data| GrayView::new(data, self.width, self.height, self.width).unwrap();
        StereoPair::new(view(&self.left), view(&self.right)).unwrap()
    }
}

fn matcher(shape: Shape, params: Params) -> Matcher {
    Matcher::new(Level::detect(), shape, params).unwrap()
}

/// The result of every rung.
fn climb(matcher: &mut Matcher, pair: &Pair, join: &dyn ForkJoin) -> Vec<(Quality, DisparityMap)> {
    let mut out = DisparityMap::new(pair.shape());
    let mut rungs = Vec::new();
    let mut progress = matcher.base(pair.views(), &mut out, join).unwrap();
    loop {
        match progress {
            Progress::Working => {}
            Progress::Improved(quality) => rungs.push((quality, out.clone())),
            Progress::Converged(quality) => {
                rungs.push((quality, out));
                return rungs;
            }
        }
        progress = matcher.refine(pair.views(), &mut out, join);
    }
}

fn share_within_half_px(map: &DisparityMap, truth: impl Fn(usize) -> f32) -> f32 {
    share_within(0.5, 0, map, truth)
}

/// Of the columns from `first` on.
fn share_within(tolerance_px: f32, first: usize, map: &DisparityMap, truth: impl Fn(usize) -> f32) -> f32 {
    let width = map.shape().width_px();
    let (mut returned, mut right) = (0.0, 0.0);
    for (at, disparity) in map
        .iter_px()
        .enumerate()
        .filter(|(_, disparity)| !disparity.is_nan())
    {
        if at % width < first {
            continue;
        }
        returned += 1.0;
        right += f32::from(u8::from((disparity - truth(at / width)).abs() < tolerance_px));
    }
    right / returned
}

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

#[test]
fn a_used_matcher_answers_like_a_new_one() {
    let first = Pair::with_disparity(180, 100, |_| 40);
    let second = Pair::with_disparity(180, 100, |y| 5 + i64::from(y > 30) * 20);
    let small = Pair::with_disparity(64, 48, |_| 7);
    for params in [Params::default(), Params::fast(), Params::paper()] {
        let fresh = climb(&mut matcher(second.shape(), params.clone()), &second, &Serial);
        let mut used = matcher(first.shape(), params.clone());
        climb(&mut used, &first, &Serial);
        assert_eq!(climb(&mut used, &second, &Serial), fresh);
        used.reconfigure(
            small.shape(),
            Params {
                range: DisparityRange { min_px: 0, count: 16 },
                ..Params::paper()
            },
        )
        .unwrap();
        climb(&mut used, &small, &Serial);
        used.reconfigure(second.shape(), params).unwrap();
        assert_eq!(climb(&mut used, &second, &Serial), fresh);
    }
}

#[test]
fn a_matcher_made_smaller_answers_like_a_new_one() {
    let large = Pair::with_disparity(300, 120, |y| 5 + i64::from(y > 30) * 20);
    // Any padding of rows, at every resolution.
    for width in 200..216 {
        let small = Pair::with_disparity(width, 90, |y| 9 + i64::from(y > 40) * 22);
        for params in [Params::default(), Params::fast()] {
            let fresh = climb(&mut matcher(small.shape(), params.clone()), &small, &Serial);
            let mut used = matcher(large.shape(), params.clone());
            climb(&mut used, &large, &Serial);
            used.reconfigure(small.shape(), params).unwrap();
            assert_eq!(climb(&mut used, &small, &Serial), fresh, "{width} columns");
        }
    }
}

/// Runs pieces backwards on scoped threads.
struct ThreeThreads;

impl ForkJoin for ThreeThreads {
    fn threads(&self) -> usize {
        3
    }

    fn run(&self, n: usize, piece: &(dyn Fn(usize) + Sync)) {
        std::thread::scope(|scope| {
            for k in (0..n).rev() {
                scope.spawn(move || piece(k));
            }
        });
    }
}

/// Every level of this machine gives the same bits for every preset.
fn assert_levels_agree(width: usize, height: usize, count: u16) {
    let pair = Pair::with_disparity(width, height, |y| i64::try_from(3 + y / 9 % 5 * 21).unwrap());
    for mut params in [Params::default(), Params::fast(), Params::paper()] {
        params.range.count = count;
        params.density = Density::Dense;
        let results = |level| {
            climb(
                &mut Matcher::new(level, pair.shape(), params.clone()).unwrap(),
                &pair,
                &Serial,
            )
        };
        let expected = results(Level::SCALAR);
        for level in Level::available() {
            assert!(
                results(level) == expected,
                "{} with {:?}",
                level.name(),
                params.preset
            );
        }
    }
}

#[test]
fn every_level_of_this_machine_gives_the_same_bits_for_jumps_wider_than_any_table() {
    assert_levels_agree(333, 130, 256);
}

#[test]
fn every_level_of_this_machine_gives_the_same_bits_for_images_narrower_than_a_vector() {
    assert_levels_agree(47, 61, 64);
    assert_levels_agree(32, 32, 16);
}

#[test]
fn several_threads_give_the_same_bits_as_one() {
    // The smallest image, halves of unlike height, and steps that end within a half.
    for (width, height) in [(32, 32), (70, 37), (333, 210), (120, 611)] {
        let pair = Pair::with_disparity(width, height, |y| 6 + i64::try_from(y / 50 * 2).unwrap());
        for params in [Params::default(), Params::fast(), Params::paper()] {
            let one = climb(&mut matcher(pair.shape(), params.clone()), &pair, &Serial);
            let three = climb(&mut matcher(pair.shape(), params), &pair, &ThreeThreads);
            assert_eq!(one, three, "{width}x{height}");
        }
    }
}

#[test]
fn the_mesh_lies_on_the_wall_and_faces_the_camera() {
    let pair = Pair::with_disparity(200, 120, |_| 23);
    let mut matcher = matcher(pair.shape(), Params::default());
    climb(&mut matcher, &pair, &Serial);
    let mut mesh = Mesh::default();
    matcher.mesh(&MeshParams::default(), &mut mesh);
    assert!(!mesh.triangles.is_empty());
    let mut used = vec![false; mesh.vertices.len()];
    let mut area = 0.0;
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|index| mesh.vertices[index as usize]);
        triangle.iter().for_each(|&index| used[index as usize] = true);
        let twice_area = (b.u - a.u) * (c.v - a.v) - (b.v - a.v) * (c.u - a.u);
        assert!(
            twice_area < 0.0,
            "counter-clockwise with y up is negative with v down: {twice_area}"
        );
        area -= twice_area / 2.0;
        // The leftmost 23 columns have no counterpart in the right view, and windows reach a little further.
        assert!(
            [a, b, c]
                .iter()
                .all(|vertex| vertex.u < 32.0 || (vertex.disparity - 23.0).abs() < 1.5)
        );
    }
    assert!(used.iter().all(|&used| used), "every vertex is used");
    assert!(area > 0.6 * 200.0 * 120.0, "{area}");
}

#[test]
fn no_rungs_mesh_has_more_triangles_than_its_budget_and_a_larger_one_is_used() {
    let pair = Pair::with_disparity(320, 200, |y| 8 + i64::try_from(y / 10 % 4 * 5).unwrap());
    for params in [Params::default(), Params::fast(), Params::paper()] {
        let mut matcher = matcher(pair.shape(), params);
        let mut out = DisparityMap::new(pair.shape());
        let mut progress = matcher.base(pair.views(), &mut out, &Serial).unwrap();
        loop {
            if progress != Progress::Working {
                let mut mesh = Mesh::default();
                let counts = [100, 150, 400, 100_000].map(|max_triangles| {
                    let limits = MeshParams {
                        max_triangles,
                        keep_rejected: true,
                        ..MeshParams::default()
                    };
                    limits.validate().unwrap();
                    matcher.mesh(&limits, &mut mesh);
                    assert!(mesh.triangles.len() <= max_triangles as usize);
                    mesh.triangles.len()
                });
                // Ties at the end of a budget are left out together.
                assert!(counts[0] > 50 && counts[2] > 200 && counts[3] > 300, "{counts:?}");
            }
            if matches!(progress, Progress::Converged(_)) {
                break;
            }
            progress = matcher.refine(pair.views(), &mut out, &Serial);
        }
    }
}

#[test]
fn a_rungs_mesh_is_confirmed_by_its_own_frame() {
    let wall = Pair::with_disparity(240, 160, |_| 17);
    let noise = Pair::with_disparity(240, 160, |y| 7 * i64::try_from(y % 9).unwrap());
    for params in [Params::default(), Params::fast(), Params::paper()] {
        let first_mesh = |before: Option<&Pair>| {
            let mut matcher = matcher(wall.shape(), params.clone());
            if let Some(before) = before {
                climb(&mut matcher, before, &Serial);
            }
            let mut out = DisparityMap::new(wall.shape());
            matcher.base(wall.views(), &mut out, &Serial).unwrap();
            let mut mesh = Mesh::default();
            matcher.mesh(&MeshParams::default(), &mut mesh);
            mesh
        };
        let alone = first_mesh(None);
        // All but the part that the right view does not see.
        assert!(
            alone.triangles.len() > 20,
            "{:?}: {}",
            params.preset,
            alone.triangles.len()
        );
        assert_eq!(alone, first_mesh(Some(&noise)), "{:?}", params.preset);
    }
}

#[test]
fn nonsense_about_meshes_is_refused() {
    let is_refused = |change: fn(&mut MeshParams)| {
        let mut params = MeshParams::default();
        change(&mut params);
        params.validate().is_err()
    };
    assert_eq!(MeshParams::default().validate(), Ok(()));
    assert!(is_refused(|params| params.tolerance_px = 0.09));
    assert!(is_refused(|params| params.tolerance_px = f32::NAN));
    assert!(is_refused(|params| params.max_triangles = 99));
    assert!(is_refused(|params| params.max_triangles = 1_000_001));
    assert!(is_refused(|params| params.max_disparity_step_px = 65.0));
    assert!(is_refused(|params| params.min_valid_share = -0.1));
}

#[test]
fn triangles_across_a_jump_are_left_out_unless_asked_for() {
    let pair = Pair::with_disparity(240, 160, |y| if y < 80 { 5 } else { 45 });
    let mut matcher = matcher(pair.shape(), Params::default());
    climb(&mut matcher, &pair, &Serial);
    let (mut kept, mut all) = (Mesh::default(), Mesh::default());
    matcher.mesh(&MeshParams::default(), &mut kept);
    matcher.mesh(
        &MeshParams {
            keep_rejected: true,
            ..MeshParams::default()
        },
        &mut all,
    );
    let spread = |mesh: &Mesh| {
        mesh.triangles.iter().fold(0.0f32, |most, triangle| {
            let d = triangle.map(|index| mesh.vertices[index as usize].disparity);
            most.max(d.iter().fold(f32::MIN, |a, &b| a.max(b)) - d.iter().fold(f32::MAX, |a, &b| a.min(b)))
        })
    };
    assert!(spread(&all) > 35.0, "the whole mesh spans the jump");
    assert!(spread(&kept) < 20.0, "{}", spread(&kept));
}

#[test]
fn wrong_sizes_and_parameters_are_refused() {
    let pair = Pair::with_disparity(64, 48, |_| 5);
    let mut matcher = matcher(Shape::new(64, 64).unwrap(), Params::default());
    let mut out = DisparityMap::new(matcher.shape());
    let refused = matcher.base(pair.views(), &mut out, &Serial);
    assert_eq!(
        refused,
        Err(MatchError::WrongShape {
            expected: (64, 64),
            got: (64, 48)
        })
    );
    assert!(Shape::new(31, 100).is_err() && Shape::new(100, 4097).is_err() && Shape::new(4096, 32).is_ok());
    let with_count = |count| Params {
        range: DisparityRange { min_px: 0, count },
        ..Params::default()
    };
    for count in [0, 15, 17, 250, 272] {
        assert!(with_count(count).validate(pair.shape()).is_err(), "{count}");
    }
    for min_confidence in [f32::NAN, -0.1, 1.1] {
        assert!(
            Params {
                min_confidence,
                ..Params::default()
            }
            .validate(pair.shape())
            .is_err()
        );
    }
    for roi in [(0, 0, 0, 5), (60, 0, 5, 5), (0, 47, 1, 2), (usize::MAX, 0, 2, 2)] {
        let roi = Some(Roi {
            x: roi.0,
            y: roi.1,
            width: roi.2,
            height: roi.3,
        });
        assert!(
            Params {
                roi,
                ..Params::default()
            }
            .validate(pair.shape())
            .is_err(),
            "{roi:?}"
        );
    }
    let short = [0u8; 100];
    assert!(GrayView::new(&short, 10, 11, 10).is_err() && GrayView::new(&short, 10, 10, 9).is_err());
    assert!(GrayView::new(&short, 10, usize::MAX, usize::MAX).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    /// Any size, stride, range, region and content: no panic, and disparities within the range.
    #[test]
    fn anything_can_be_matched(
        (width, height, padding) in (32usize..150, 32usize..90, 0usize..9),
        (min_px, sixteenths) in (prop_oneof![Just(0u16), 1u16..60, Just(767)], 1u16..=16),
        (preset, dense, focuses) in (prop_oneof![Just(Preset::Default), Just(Preset::Fast), Just(Preset::Paper)], any::<bool>(), any::<bool>()),
        roi in proptest::option::of((0.0..1.0f64, 0.0..1.0f64, 0.0..1.0f64, 0.0..1.0f64)),
        seed in any::<u64>(),
        contrast in prop_oneof![Just(0u32), Just(3), Just(8)],
    ) {
        let stride = width + padding;
        let mut state = seed | 1;
        let mut noise = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            u8::try_from((state >> 33) & 0xFF).unwrap() & u8::try_from((1u32 << contrast) - 1).unwrap()
        };
        let (left, right): (Vec<u8>, Vec<u8>) = (0..stride * height).map(|_| (noise(), noise())).unzip();
        let view = |data| GrayView::new(data, width, height, stride).unwrap();
        let pair = StereoPair::new(view(&left), view(&right)).unwrap();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the image")]
        let roi = roi.map(|(x, y, w, h)| {
            let at = |share: f64, n: usize| (share * n as f64) as usize;
            let (x, y) = (at(x, width), at(y, height));
            Roi { x, y, width: 1 + at(w, width - x).min(width - x - 1), height: 1 + at(h, height - y).min(height - y - 1) }
        });
        let params = Params {
            preset,
            range: DisparityRange { min_px, count: 16 * sixteenths },
            density: if dense { Density::Dense } else { Density::SemiDense },
            min_confidence: 0.0,
            focus: roi.into_iter().map(|region| Focus { region, weight: 1.0 }).filter(|_| focuses).collect(),
            roi,
        };
        let shape = Shape::new(width, height).unwrap();
        let mut matcher = matcher(shape, params);
        let mut out = DisparityMap::new(shape);
        let mut progress = matcher.base(pair, &mut out, &Serial).unwrap();
        while !matches!(progress, Progress::Converged(_)) {
            progress = matcher.refine(pair, &mut out, &Serial);
        }
        let most = (min_px + 16 * sixteenths) * FIXED_PER_PX;
        prop_assert!(out.fixed().iter().all(|&fixed| fixed == 0 || (fixed >= (min_px * FIXED_PER_PX).max(1) && fixed <= most)));
        let mut mesh = Mesh::default();
        matcher.mesh(&MeshParams { keep_rejected: true, ..MeshParams::default() }, &mut mesh);
        let vertices = u32::try_from(mesh.vertices.len()).unwrap();
        prop_assert!(mesh.triangles.iter().flatten().all(|&index| index < vertices));
        matcher.mesh(&MeshParams { keep_rejected: true, max_triangles: 100, ..MeshParams::default() }, &mut mesh);
        prop_assert!(mesh.triangles.len() <= 100);
    }
}

#[test]
fn fast_forgets_the_views_and_finds_in_them_what_default_does() {
    // More rows than are taken in at a time, and not a multiple of them.
    let pair = Pair::with_disparity(333, 151, |y| 8 + i64::try_from(y % 37 / 12 * 11).unwrap());
    let first = |params| {
        climb(&mut matcher(pair.shape(), params), &pair, &Serial)
            .swap_remove(0)
            .1
    };
    assert!(first(Params::fast()) == first(Params::default()));
}
