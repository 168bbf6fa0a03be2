use proptest::prelude::*;

use super::{CIRCLE, Corners, PER_BIN};
use crate::plane::MARGIN_X;
use crate::scene::{Image, Noise};
use crate::simd::Level;
use crate::support::Candidate;

/// The same at every level, whatever rows are looked at in one go, and whatever was found before.
fn corners(image: &Image) -> Vec<(usize, usize)> {
    let plane = image.padded(MARGIN_X, MARGIN_X);
    let mut corners = Corners::default();
    let mut results = Level::available()
        .into_iter()
        .flat_map(|level| [1, 7, 1000].map(|rows| (level, rows)));
    let mut find = |(level, rows)| {
        let mut found = vec![Candidate { x: 1, y: 1 }];
        corners.begin(&plane);
        let mut next = Some(0);
        while let Some(row) = next {
            next = corners.find(level, &plane, row, rows);
        }
        corners.best(&mut found);
        found
    };
    let first = results
        .next()
        .map(&mut find)
        .expect("the scalar level is always there");
    assert!(results.all(|way| find(way) == first));
    first.iter().map(|corner| (corner.x, corner.y)).collect()
}

fn square(x: usize, y: usize) -> bool {
    (20..44).contains(&x) && (20..44).contains(&y)
}

#[test]
fn the_four_corners_of_a_square_are_found_bright_or_dark() {
    for (inside, outside) in [(200, 50), (50, 200)] {
        let found = corners(&Image::from_fn(64, 64, |x, y| {
            if square(x, y) { inside } else { outside }
        }));
        for corner in [(20, 20), (43, 20), (20, 43), (43, 43)] {
            // Along an edge some pixels are corners as good as the very corner; the first one is taken.
            let near = |&(x, y): &(usize, usize)| x.abs_diff(corner.0) <= 2 && y.abs_diff(corner.1) <= 2;
            assert!(found.iter().any(near), "{corner:?} in {found:?}");
        }
        assert_eq!(found.len(), 4);
    }
}

#[test]
fn edges_flat_areas_and_faint_corners_are_no_corners() {
    assert_eq!(corners(&Image::from_fn(64, 64, |_, _| 128)), []);
    assert_eq!(
        corners(&Image::from_fn(64, 64, |x, _| if x < 30 { 0 } else { 255 })),
        []
    );
    assert_eq!(
        corners(&Image::from_fn(64, 64, |_, y| if y < 30 { 0 } else { 255 })),
        []
    );
    assert_eq!(
        corners(&Image::from_fn(64, 64, |x, y| if square(x, y) {
            110
        } else {
            100
        })),
        []
    );
}

/// The largest threshold by which 9 contiguous circle pixels are all brighter or all darker; 0 up to 10.
fn score(image: &Image, x: usize, y: usize) -> i32 {
    let at = |dx: i8, dy: i8| {
        i32::from(image.at(
            x.cast_signed() + isize::from(dx),
            y.cast_signed() + isize::from(dy),
        ))
    };
    let is_corner = |threshold: i32| {
        [1, -1].iter().any(|sign| {
            let beyond = |k: usize| sign * (at(CIRCLE[k % 16].0, CIRCLE[k % 16].1) - at(0, 0)) >= threshold;
            (0..16).any(|first| (first..first + 9).all(beyond))
        })
    };
    (11..=255)
        .rev()
        .find(|&threshold| is_corner(threshold))
        .unwrap_or(0)
}

/// Per bin of 12x10, the 8 best of those that are the (first) best of their neighbourhood.
fn expected(image: &Image) -> Vec<(usize, usize)> {
    let (width, height) = (image.width, image.height);
    let inside = |x: usize, y: usize| (4..width - 4).contains(&x) && (4..height - 4).contains(&y);
    let scores: Vec<i32> = (0..width * height)
        .map(|at| (at % width, at / width))
        .map(|(x, y)| if inside(x, y) { score(image, x, y) } else { 0 })
        .collect();
    let is_best = |x: usize, y: usize| {
        let own = scores[y * width + x];
        let others = (y - 1..=y + 1).flat_map(|v| (x - 1..=x + 1).map(move |u| v * width + u));
        own > 0
            && others
                .filter(|&at| at != y * width + x)
                .all(|at| scores[at] < own || (scores[at] == own && at > y * width + x))
    };
    let mut bins = vec![Vec::new(); 120];
    for (y, x) in (4..height - 4).flat_map(|y| (4..width - 4).map(move |x| (y, x))) {
        if is_best(x, y) {
            bins[y / height.div_ceil(10) * 12 + x / width.div_ceil(12)].push((x, y));
        }
    }
    for bin in &mut bins {
        bin.sort_by_key(|&(x, y)| -scores[y * width + x]);
        bin.truncate(8);
    }
    bins.concat()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn corners_are_the_best_of_their_neighbourhood_and_bin_by_largest_threshold(
        (width, height) in (32usize..150, 32usize..70),
        block in 1usize..7,
        (levels, seed) in (prop_oneof![Just(2usize), Just(40), Just(256)], any::<u64>()),
    ) {
        let coarse = Image::noise(&mut Noise::new(seed), width, height, levels);
        let gain = if levels == 2 { 60 } else { 1 };
        let image = Image::from_fn(width, height, |x, y| {
            gain * coarse.at((x / block).cast_signed(), (y / block).cast_signed())
        });
        prop_assert_eq!(corners(&image), expected(&image));
    }
}

#[test]
fn a_bin_gives_8_corners_at_most() {
    let image = Image::noise(&mut Noise::new(3), 480, 300, 256);
    let mut bins = [0; 120];
    for (x, y) in corners(&image) {
        bins[y / 30 * 12 + x / 40] += 1;
    }
    assert_eq!(bins.iter().max(), Some(&PER_BIN));
    assert!(bins.iter().all(|&corners| corners > 0));
}
