//! Regions that matter more: what a caller may rely on.
#![expect(clippy::unwrap_used, reason = "tests")]

mod common;

use common::ThreeThreads;
use stereo::{
    Density, DisparityMap, FIXED_PER_PX, Focus, ForkJoin, GrayView, Level, Matcher, Mesh, MeshParams, Params,
    ParamsError, Preset, Progress, Quality, Roi, Serial, Shape, StereoPair,
};

const WIDTH: usize = 360;
const HEIGHT: usize = 220;

/// The height of a surface of steps at `x`, `y`, in px of disparity: what no triangle fits at the steps.
fn disparity(x: usize, y: usize) -> usize {
    12 + (x / 36 * 5 + y / 30 * 4) % 11
}

/// A textured left view, and the right one in which nearer pixels hide farther ones.
fn pair() -> [Vec<u8>; 2] {
    let hash = |x: usize, y: usize| {
        let mut v = (x as u64).wrapping_mul(0x9E37_79B9) ^ (y as u64).wrapping_mul(0x85EB_CA6B);
        v = v.wrapping_mul(0x27D4_EB2F_1656_67C5);
        v ^= v >> 29;
        (v.wrapping_mul(0x1656_67B1_9E37_79F9) >> 40) & 0xFF
    };
    let left: Vec<u8> = (0..WIDTH * HEIGHT)
        .map(|at| {
            let (x, y) = (at % WIDTH, at / WIDTH);
            let sum: u64 = (0..2)
                .flat_map(|dy| (0..2).map(move |dx| (dx, dy)))
                .map(|(dx, dy)| hash(x + dx, y + dy))
                .sum();
            u8::try_from(sum / 4).unwrap()
        })
        .collect();
    let (mut right, mut nearest) = (vec![90; WIDTH * HEIGHT], vec![0; WIDTH * HEIGHT]);
    for (at, gray) in left.iter().enumerate() {
        let (x, y) = (at % WIDTH, at / WIDTH);
        let d = disparity(x, y);
        if x >= d && nearest[at - d] <= d {
            (right[at - d], nearest[at - d]) = (*gray, d);
        }
    }
    [left, right]
}

/// The quality and the result of every rung.
fn climb(level: Level, params: &Params, join: &dyn ForkJoin) -> Vec<(Quality, DisparityMap)> {
    let shape = Shape::new(WIDTH, HEIGHT).unwrap();
    let images = pair();
    let [left, right] = images
        .each_ref()
        .map(|data| GrayView::new(data, WIDTH, HEIGHT, WIDTH).unwrap());
    let pair = StereoPair::new(left, right).unwrap();
    let mut matcher = Matcher::new(level, shape, params.clone()).unwrap();
    let mut rungs = Vec::new();
    // The second time, everything has been used before.
    for _ in 0..2 {
        rungs.clear();
        let mut out = DisparityMap::new(shape);
        let mut progress = matcher.base(pair, &mut out, join).unwrap();
        loop {
            if let Progress::Improved(quality) | Progress::Converged(quality) = progress {
                rungs.push((quality, out.clone()));
            }
            if matches!(progress, Progress::Converged(_)) {
                break;
            }
            progress = matcher.refine(pair, &mut out, join);
        }
    }
    rungs
}

const LIGHT: Roi = Roi {
    x: 60,
    y: 20,
    width: 90,
    height: 70,
};
const HEAVY: Roi = Roi {
    x: 190,
    y: 101,
    width: 111,
    height: 80,
};

fn presets() -> [Params; 3] {
    [Preset::Default, Preset::Fast, Preset::Paper].map(|preset| Params {
        preset,
        density: Density::Dense,
        ..Params::default()
    })
}

fn focused(params: &Params) -> Params {
    let focus = |region, weight| Focus { region, weight };
    Params {
        focus: vec![focus(LIGHT, 1.0), focus(HEAVY, 2.5)],
        ..params.clone()
    }
}

/// Share of the pixels that are within a pixel of the truth, where the right view can see them.
fn share_right(map: &DisparityMap, counts: impl Fn(usize, usize) -> bool) -> f64 {
    let pixels: Vec<bool> = (0..WIDTH * HEIGHT)
        .map(|at| (at % WIDTH, at / WIDTH))
        .filter(|&(x, y)| x > 50 && counts(x, y))
        .map(|(x, y)| {
            map.disparity_px(x, y)
                .is_some_and(|px| (f64::from(px) - disparity(x, y) as f64).abs() < 1.0)
        })
        .collect();
    pixels.iter().filter(|right| **right).count() as f64 / pixels.len() as f64
}

fn is_in(region: Roi, x: usize, y: usize) -> bool {
    (region.x..region.x + region.width).contains(&x) && (region.y..region.y + region.height).contains(&y)
}

/// Whether both maps are the same in `region`.
fn agree_in(region: Roi, a: &DisparityMap, b: &DisparityMap) -> bool {
    (region.y..region.y + region.height).all(|y| {
        let row = y * WIDTH + region.x..y * WIDTH + region.x + region.width;
        a.fixed()[row.clone()] == b.fixed()[row.clone()] && a.confidence()[row.clone()] == b.confidence()[row]
    })
}

#[test]
fn regions_come_first_and_the_end_is_the_same_as_without_them() {
    for params in presets() {
        let name = params.preset;
        let plain = climb(Level::detect(), &params, &Serial);
        let with = climb(Level::detect(), &focused(&params), &Serial);
        let names = focused(&params).rung_names();
        assert_eq!(with.len(), names.len(), "{name:?}");
        assert_eq!(names[..4], [names[0], "focus", "focus", plain_names(&params)[1]]);
        assert!(
            with.iter()
                .zip(1..)
                .all(|((quality, _), rung)| quality.rung == rung)
        );
        let alone = |region| {
            let params = Params {
                roi: Some(region),
                ..params.clone()
            };
            climb(Level::detect(), &params, &Serial).pop().unwrap().1
        };
        let (heavy, light) = (alone(HEAVY), alone(LIGHT));
        for (rung, (quality, map)) in with.iter().enumerate().skip(1).take(with.len() - 2) {
            assert!(agree_in(HEAVY, map, &heavy), "{name:?} rung {rung}");
            assert_eq!(agree_in(LIGHT, map, &light), rung >= 2, "{name:?} rung {rung}");
            assert!(quality.density > 0.999, "{quality:?}");
        }
        let rest = |x, y| !is_in(HEAVY, x, y) && !is_in(LIGHT, x, y);
        for (x, y) in (0..WIDTH * HEIGHT)
            .map(|at| (at % WIDTH, at / WIDTH))
            .filter(|&(x, y)| rest(x, y))
        {
            assert_eq!(with[2].1.disparity_px(x, y), plain[0].1.disparity_px(x, y));
        }
        assert_eq!(with.last().unwrap().1, plain.last().unwrap().1, "{name:?}");
    }
}

fn plain_names(params: &Params) -> Vec<&'static str> {
    stereo::rung_names(params.preset)
}

#[test]
fn a_budget_that_cuts_leaves_the_regions_better_than_the_rest() {
    for params in &presets()[..2] {
        let rungs = climb(Level::detect(), &focused(params), &Serial);
        let in_regions = |map| share_right(map, |x, y| is_in(HEAVY, x, y) || is_in(LIGHT, x, y));
        let in_rest = |map| share_right(map, |x, y| !is_in(HEAVY, x, y) && !is_in(LIGHT, x, y));
        let (base, cut) = (&rungs[0].1, &rungs[2].1);
        assert!(
            in_regions(cut) > in_regions(base) + 0.1,
            "{} after {}",
            in_regions(cut),
            in_regions(base)
        );
        assert!(
            in_regions(cut) > in_rest(cut) + 0.1,
            "{} beside {}",
            in_regions(cut),
            in_rest(cut)
        );
    }
}

#[test]
fn threads_and_levels_give_the_same_bits() {
    for params in presets() {
        let params = focused(&params);
        let expected = climb(Level::SCALAR, &params, &Serial);
        for level in Level::available() {
            assert!(
                climb(level, &params, &Serial) == expected,
                "{} with {:?}",
                level.name(),
                params.preset
            );
        }
        assert!(
            climb(Level::detect(), &params, &ThreeThreads) == expected,
            "threads with {:?}",
            params.preset
        );
    }
}

#[test]
fn the_mesh_is_better_where_regions_are_ahead() {
    let images = pair();
    let [left, right] = images
        .each_ref()
        .map(|data| GrayView::new(data, WIDTH, HEIGHT, WIDTH).unwrap());
    let pair = StereoPair::new(left, right).unwrap();
    let shape = Shape::new(WIDTH, HEIGHT).unwrap();
    let mut matcher = Matcher::new(Level::detect(), shape, focused(&Params::default())).unwrap();
    let mut out = DisparityMap::new(shape);
    let mut progress = matcher.base(pair, &mut out, &Serial).unwrap();
    let mut regions = 0;
    while regions < 2 {
        progress = matcher.refine(pair, &mut out, &Serial);
        regions += usize::from(matches!(progress, Progress::Improved(_)));
    }
    assert!(matches!(progress, Progress::Improved(_)));
    let mut mesh = Mesh::default();
    matcher.mesh(&MeshParams::default(), &mut mesh);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "within the image"
    )]
    let right: Vec<(bool, bool)> = mesh
        .vertices
        .iter()
        .map(|vertex| (vertex.u as usize, vertex.v as usize, vertex.disparity))
        .filter(|&(x, _, _)| x > 50)
        .map(|(x, y, px)| {
            let is_right = (px - disparity(x, y) as f32).abs() < 1.0;
            (is_in(HEAVY, x, y) || is_in(LIGHT, x, y), is_right)
        })
        .collect();
    let share = |inside| {
        let counted = right.iter().filter(|(is_inside, _)| *is_inside == inside);
        counted.clone().filter(|(_, is_right)| *is_right).count() as f64 / counted.count() as f64
    };
    assert!(
        share(true) > share(false) + 0.1,
        "{} beside {}",
        share(true),
        share(false)
    );
    // A mesh made on the way takes nothing from what follows.
    while !matches!(progress, Progress::Converged(_)) {
        progress = matcher.refine(pair, &mut out, &Serial);
        matcher.mesh(&MeshParams::default(), &mut mesh);
    }
    let plain = climb(Level::detect(), &Params::default(), &Serial);
    assert_eq!(out, plain.last().unwrap().1);
}

#[test]
fn regions_are_checked() {
    let shape = Shape::new(WIDTH, HEIGHT).unwrap();
    let check = |focus: Vec<Focus>, roi| {
        let params = Params {
            focus,
            roi,
            ..Params::default()
        };
        params.validate(shape)
    };
    let one = |region, weight| vec![Focus { region, weight }];
    assert_eq!(check(one(HEAVY, 1.0), None), Ok(()));
    assert_eq!(check(one(HEAVY, Focus::MAX_WEIGHT), Some(HEAVY)), Ok(()));
    for weight in [0.0, -1.0, f32::NAN, f32::INFINITY, 1001.0] {
        let refused = check(one(HEAVY, weight), None);
        assert!(
            matches!(
                refused,
                Err(ParamsError::OutOfRange {
                    name: "focus.weight",
                    ..
                })
            ),
            "{weight}: {refused:?}"
        );
    }
    let outside = Err(ParamsError::FocusOutside {
        region: HEAVY,
        within: LIGHT,
    });
    assert_eq!(check(one(HEAVY, 1.0), Some(LIGHT)), outside);
    let leaving = Roi {
        x: usize::MAX,
        ..HEAVY
    };
    let empty = Roi { width: 0, ..HEAVY };
    for region in [leaving, empty] {
        assert!(matches!(
            check(one(region, 1.0), None),
            Err(ParamsError::FocusOutside { .. })
        ));
    }
    let many = vec![
        Focus {
            region: LIGHT,
            weight: 1.0
        };
        17
    ];
    assert_eq!(
        check(many, None),
        Err(ParamsError::TooManyRegions { most: 16, got: 17 })
    );
    let large = vec![
        Focus {
            region: Roi::full(shape),
            weight: 1.0
        };
        2
    ];
    assert!(matches!(
        check(large, None),
        Err(ParamsError::FocusTooLarge { .. })
    ));
}

#[test]
fn no_size_or_place_of_a_region_is_too_small() {
    let shape = Shape::new(WIDTH, HEIGHT).unwrap();
    for (x, y, width, height) in [
        (0, 0, 1, 1),
        (WIDTH - 1, HEIGHT - 1, 1, 1),
        (0, 7, WIDTH, 3),
        (31, 0, 2, HEIGHT),
    ] {
        let region = Roi { x, y, width, height };
        for params in presets() {
            let params = Params {
                focus: vec![Focus { region, weight: 1.0 }],
                ..params
            };
            params.validate(shape).unwrap();
            let rungs = climb(Level::detect(), &params, &Serial);
            let most = 128 * FIXED_PER_PX;
            assert!(
                rungs
                    .iter()
                    .all(|(_, map)| map.fixed().iter().all(|&fixed| fixed <= most))
            );
        }
    }
}
