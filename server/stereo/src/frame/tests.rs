use super::{Frame, Stage};
use crate::fork_join::Serial;
use crate::image::{Shape, StereoPair};
use crate::ladder::Recipe;
use crate::params::{DisparityRange, Params, Preset};
use crate::scene::{Image, Noise};
use crate::simd::Level;

/// A wall that comes nearer to the right, until it is beyond the range.
#[test]
fn disparities_stay_within_the_range_where_the_scene_leaves_it() {
    let (width, height) = (400, 64);
    let texture = Image::noise(&mut Noise::new(11), width, height, 256);
    let right = Image::from_fn(width, height, |x, y| texture.at(x.cast_signed(), y.cast_signed()));
    let left = Image::from_fn(width, height, |x, y| {
        texture.at(x.cast_signed() - (x / 12).cast_signed(), y.cast_signed())
    });
    for preset in [Preset::Default, Preset::Fast, Preset::Paper] {
        let params = Params {
            preset,
            range: DisparityRange { min_px: 0, count: 16 },
            ..Params::default()
        };
        let (recipe, mut frame) = (Recipe::of(preset), Frame::default());
        frame.reshape(
            Level::detect(),
            Shape::new(width, height).unwrap(),
            &params,
            recipe,
        );
        frame.begin(
            StereoPair::new(left.view(), right.view()).unwrap(),
            recipe,
            &Serial,
        );
        for rung in recipe.rungs {
            let mut stage = Some(Stage::Choose);
            while let Some(next) = stage {
                stage = frame.step(next, rung, recipe, &Serial);
            }
            let most = frame.disparity.iter().max();
            assert!(most <= Some(&(16 * 64)), "{most:?} after {}", rung.name);
        }
    }
}
