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

/// Posts before a wall, too thin for half the resolution and too far from the wall for a correction by a pixel.
#[test]
fn what_half_the_resolution_loses_is_recovered() {
    let (width, height, post_px, apart) = (480, 96, 7, 80);
    let [wall, posts] = [12, 13].map(|seed| Image::noise(&mut Noise::new(seed), width + 64, height, 256));
    let (far, near) = (6, 52u16);
    let is_post = |x: usize| x % apart >= 60 && x % apart < 60 + post_px;
    let see = |shift: [usize; 2]| {
        Image::from_fn(width, height, |x, y| {
            let [x_wall, x_posts] = shift.map(|shift| x + shift);
            let image = if is_post(x_posts) { &posts } else { &wall };
            let x = if is_post(x_posts) { x_posts } else { x_wall };
            image.at(x.cast_signed(), y.cast_signed())
        })
    };
    let (left, right) = (see([0, 0]), see([far, near.into()]));
    let params = Params {
        range: DisparityRange { min_px: 0, count: 64 },
        ..Params::default()
    };
    let (recipe, mut frame) = (Recipe::of(Preset::Default), Frame::default());
    let shape = Shape::new(width, height).unwrap();
    frame.reshape(Level::detect(), shape, &params, recipe);
    frame.begin(
        StereoPair::new(left.view(), right.view()).unwrap(),
        recipe,
        &Serial,
    );
    // Share of the posts' pixels that are right within a pixel, after every rung.
    let shares = recipe.rungs.iter().map(|rung| {
        let mut stage = Some(Stage::Choose);
        while let Some(next) = stage {
            stage = frame.step(next, rung, recipe, &Serial);
        }
        let (mut right, mut all) = (0u32, 0u32);
        for (at, &disparity) in frame.disparity.iter().enumerate() {
            let (x, y) = (at % width, at / width);
            if is_post(x) && x > 64 && (8..height - 8).contains(&y) {
                all += 1;
                right += u32::from(disparity.abs_diff(near * 64) <= 64);
            }
        }
        f64::from(right) / f64::from(all)
    });
    let shares: Vec<f64> = shares.collect();
    assert!(shares[1] < 0.05 && shares[2] > 0.6, "{shares:?}");
}
