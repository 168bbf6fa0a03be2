//! What is no pair or makes no sense, and that anything else has an answer.

use proptest::prelude::*;
use stereo::{
    Density, DisparityMap, DisparityRange, FIXED_PER_PX, Focus, GrayView, MatchError, Mesh, MeshParams,
    Params, Preset, Progress, Roi, Serial, Shape, StereoPair,
};

use super::{Pair, matcher};

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
