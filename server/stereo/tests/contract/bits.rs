//! The same bits, whatever the level, the threads and what the matcher did before.

use stereo::{Density, DisparityRange, Level, Matcher, Params, Serial};

use super::common::ThreeThreads;
use super::{Pair, climb, matcher};

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
