use proptest::prelude::*;

use super::{Before, Confidence, Maps, Published, Record, publish};
use crate::changes::{Blocks, Changes};
use crate::confidence::CostScale;
use crate::disparity::DisparityMap;
use crate::fork_join::Serial;
use crate::frame::Window;
use crate::image::{Roi, Shape};
use crate::ladder::Recipe;
use crate::params::{Density, DisparityRange, Params, Preset};
use crate::scene::Noise;
use crate::simd::Level;

/// A window's maps.
struct Scene {
    shape: Shape,
    window: Window,
    mask: Vec<u8>,
    interpolated: Vec<u16>,
    disparity: Vec<u16>,
    confidence: Vec<u8>,
}

impl Scene {
    fn new(noise: &mut Noise, shape: Shape, roi: Roi) -> Self {
        let area = roi.width * roi.height;
        Self {
            shape,
            window: Window {
                roi,
                min_disparity_px: 0,
                disparities: 64,
            },
            mask: noise.bytes(area, 2),
            interpolated: noise.words(area, 63 * 64),
            disparity: noise.words(area, 63 * 64),
            confidence: noise.bytes(area, 255),
        }
    }

    fn full(seed: u64) -> Self {
        let shape = Shape::new(64, 40).unwrap();
        Self::new(&mut Noise::new(seed), shape, Roi::full(shape))
    }

    /// Its maps, the confidences being costs.
    fn of_costs<'a>(&'a self, scale: CostScale, mask: &'a [u8]) -> Maps<'a> {
        Maps {
            window: self.window,
            mask,
            interpolated: &self.interpolated,
            disparity: &self.disparity,
            confidence: Confidence::OfCosts(scale, &self.confidence),
        }
    }

    fn publish(&self, params: &Params) -> (DisparityMap, Published) {
        let maps = Maps {
            window: self.window,
            mask: &self.mask,
            interpolated: &self.interpolated,
            disparity: &self.disparity,
            confidence: Confidence::Known(&self.confidence),
        };
        // What another frame has left behind.
        let mut out = DisparityMap::new(self.shape);
        out.parts_mut().0.fill(9);
        out.parts_mut().1.fill(9);
        let published = publish(
            Level::detect(),
            &maps,
            (self.shape, params),
            (&mut out, Before::Nothing, &mut Record::default()),
            &Serial,
        );
        (out, published)
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn each_pixel_asked_for_gets_what_is_known_of_it_and_all_others_nothing(
        (width, height) in (32usize..90, 32usize..60),
        (x, y, roi_width, roi_height) in (0usize..16, 0usize..16, 1usize..16, 1usize..16),
        (dense, with_roi) in (any::<bool>(), any::<bool>()),
        (min_px, min_confidence) in (prop_oneof![Just(0u16), 1u16..=767], prop_oneof![Just(0.0f32), 0.0f32..=1.0]),
        seed in any::<u64>(),
    ) {
        let shape = Shape::new(width, height).unwrap();
        let asked = if with_roi { Roi { x, y, width: roi_width, height: roi_height } } else { Roi::full(shape) };
        let context = Roi { x: asked.x / 2, y: asked.y / 2, width: width - asked.x / 2, height: height - asked.y / 2 };
        let scene = Scene::new(&mut Noise::new(seed), shape, context);
        let params = Params {
            range: DisparityRange { min_px, count: 64 },
            density: if dense { Density::Dense } else { Density::SemiDense },
            min_confidence,
            roi: with_roi.then_some(asked),
            ..Params::default()
        };
        let (out, published) = scene.publish(&params);
        let (mut wanted, mut given) = (0u16, 0u16);
        for (at, (u, v)) in (0..shape.area_px()).map(|at| (at, (at % width, at / width))) {
            let inside = (asked.x..asked.x + asked.width).contains(&u) && (asked.y..asked.y + asked.height).contains(&v);
            let expected = if inside {
                let here = (v - context.y) * context.width + u - context.x;
                let sure = scene.confidence[here];
                let is_valid = sure > 0;
                let is_wanted = dense || scene.mask[here] == 1;
                let is_given = is_wanted && (dense || is_valid) && f32::from(sure) >= 255.0 * min_confidence;
                wanted += u16::from(is_wanted);
                given += u16::from(is_given);
                let fixed = if is_valid { scene.disparity[here] } else { scene.interpolated[here] };
                if is_given { ((fixed + 64 * min_px).max(1), sure) } else { (0, 0) }
            } else {
                (0, 0)
            };
            prop_assert_eq!((out.fixed()[at], out.confidence()[at]), expected, "at {}, {}", u, v);
        }
        prop_assert_eq!(published.density, if wanted == 0 { 0.0 } else { f32::from(given) / f32::from(wanted) });
    }
}

#[test]
fn the_mean_confidence_is_the_masks_whatever_is_kept() {
    let mut scene = Scene::full(7);
    scene.mask.fill(0);
    assert_eq!(scene.publish(&Params::default()).1.mean_confidence, 0.0);
    for (at, confidence) in [(3, 254), (900, 254), (901, 100), (2000, 0)] {
        (scene.mask[at], scene.confidence[at]) = (1, confidence);
    }
    for density in [Density::SemiDense, Density::Dense] {
        for min_confidence in [0.0, 0.9] {
            let params = Params {
                density,
                min_confidence,
                ..Params::default()
            };
            assert_eq!(scene.publish(&params).1.mean_confidence, 152.0);
        }
    }
}

#[test]
fn a_map_of_another_shape_takes_the_shape_of_the_result() {
    let scene = Scene::full(3);
    let maps = Maps {
        window: scene.window,
        mask: &scene.mask,
        interpolated: &scene.interpolated,
        disparity: &scene.disparity,
        confidence: Confidence::Known(&scene.confidence),
    };
    let mut out = DisparityMap::new(Shape::new(33, 99).unwrap());
    publish(
        Level::detect(),
        &maps,
        (scene.shape, &Params::default()),
        (&mut out, Before::Nothing, &mut Record::default()),
        &Serial,
    );
    assert_eq!(out, scene.publish(&Params::default()).0);
}

#[test]
fn pixels_that_move_by_a_quarter_come_or_go_have_changed() {
    let mut scene = Scene::full(5);
    let params = Params::default();
    scene.mask.fill(1);
    scene.disparity.fill(640);
    scene.confidence.fill(200);
    scene.confidence[..10].fill(0);
    let (mut out, first) = scene.publish(&params);
    assert_eq!(first.changed, 1.0);
    scene.confidence[..3].fill(200);
    scene.confidence[20..24].fill(0);
    scene.disparity[30..35].fill(655);
    scene.disparity[40..45].fill(656);
    scene.disparity[50..52].fill(0);
    let maps = Maps {
        window: scene.window,
        mask: &scene.mask,
        interpolated: &scene.interpolated,
        disparity: &scene.disparity,
        confidence: Confidence::Known(&scene.confidence),
    };
    for level in Level::available() {
        let mut out = out.clone();
        let published = publish(
            level,
            &maps,
            (scene.shape, &params),
            (&mut out, Before::Result, &mut Record::default()),
            &Serial,
        );
        assert_eq!(published.changed, 14.0 / (64.0 * 40.0), "{}", level.name());
        assert_eq!(out, scene.publish(&params).0);
    }
    let unasked = vec![0; scene.mask.len()];
    let maps = Maps {
        mask: &unasked,
        ..maps
    };
    let nothing = publish(
        Level::detect(),
        &maps,
        (scene.shape, &params),
        (&mut out, Before::Result, &mut Record::default()),
        &Serial,
    );
    assert_eq!((nothing.changed, nothing.density), (0.0, 0.0));
}

#[test]
fn blocks_that_stay_are_left_alone_and_what_is_counted_is_the_same() {
    for (width, height) in [(32, 40), (100, 33), (64, 32), (300, 50)] {
        let (shape, mut noise) = (Shape::new(width, height).unwrap(), Noise::new(width as u64));
        let mut scene = Scene::new(&mut noise, shape, Roi::full(shape));
        let scale = CostScale::of(Recipe::of(Preset::Fast));
        let mut changes = Changes::default();
        changes.reset(height);
        for (density, min_confidence) in [(Density::SemiDense, 0.0), (Density::Dense, 0.6)] {
            let params = Params {
                density,
                min_confidence,
                ..Params::fast()
            };
            let of = (shape, &params);
            for level in Level::available() {
                let (mut out, mut record) = (DisparityMap::new(shape), Record::default());
                let first = (&mut out, Before::Nothing, &mut record);
                publish(level, &scene.of_costs(scale, &scene.mask), of, first, &Serial);
                changes.reset(height);
                for _ in 0..20 {
                    let (x, y) = (noise.below(width), noise.below(height));
                    changes.mark(y, x, x);
                    let at = y * width + x;
                    scene.disparity[at] = (scene.disparity[at] + 100) % 4000;
                    scene.interpolated[at] = 700;
                    scene.confidence[at] = scene.confidence[at].wrapping_add(60);
                }
                let (mut whole, mut ignored) = (out.clone(), Record::default());
                let all = (&mut whole, Before::Result, &mut ignored);
                let expected = publish(level, &scene.of_costs(scale, &scene.mask), of, all, &Serial);
                // Where nothing is marked, nothing is looked at.
                let mut mask = scene.mask.clone();
                for run in (0..height).filter(|y| changes.blocks(*y, 0) == Blocks::NONE) {
                    mask[run * width..][..width].fill(0);
                }
                let some = (&mut out, Before::ResultBut(&changes, 0), &mut record);
                let published = publish(level, &scene.of_costs(scale, &mask), of, some, &Serial);
                assert_eq!(published, expected, "{width} at {}", level.name());
                assert!(out == whole, "{width} at {}", level.name());
            }
        }
    }
}

#[test]
fn costs_are_worth_what_their_scale_says_at_every_level() {
    let shape = Shape::new(64, 40).unwrap();
    let mut scene = Scene::new(&mut Noise::new(8), shape, Roi::full(shape));
    scene.mask.fill(1);
    for (cost, number) in scene.confidence.iter_mut().zip(0usize..) {
        *cost = u8::try_from(number % 256).unwrap();
    }
    let scale = CostScale::of(Recipe::of(Preset::Default));
    let mut expected = vec![0; scene.confidence.len()];
    scale.rate(&scene.confidence, &mut expected);
    for level in Level::available() {
        let maps = scene.of_costs(scale, &scene.mask);
        let (mut out, params) = (DisparityMap::new(shape), Params::default());
        let output = (&mut out, Before::Nothing, &mut Record::default());
        publish(level, &maps, (shape, &params), output, &Serial);
        assert!(out.confidence() == expected, "{}", level.name());
    }
}
