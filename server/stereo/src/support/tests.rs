use proptest::prelude::*;

use super::{Buckets, Candidate, Consistency, Scratch, Support, Unexplained, strongest_per_cell, thin};
use crate::gradient::Gradient;
use crate::plane::MARGIN_X;
use crate::scene::{Image, Noise};
use crate::simd::Level;

fn gradient(noise: &mut Noise, width: usize, height: usize, strengths: usize) -> Gradient {
    let mut gradient = Gradient::default();
    gradient.reshape(width, height);
    gradient.strength = noise.bytes(width * height, strengths);
    gradient
}

/// Cell by cell, even rows of cells from left to right and odd ones back.
fn expected(
    strength: &[u8],
    (width, height): (usize, usize),
    cell_px: usize,
    counts: impl Fn(usize) -> bool,
    enough: usize,
) -> Vec<Candidate> {
    let mut found = Vec::new();
    for row in 0..height.div_ceil(cell_px) {
        let mut columns: Vec<usize> = (0..width.div_ceil(cell_px)).collect();
        if row % 2 == 1 {
            columns.reverse();
        }
        for column in columns {
            let pixels =
                (0..cell_px * cell_px).map(|k| (column * cell_px + k % cell_px, row * cell_px + k / cell_px));
            let eligible: Vec<_> = pixels
                .filter(|(x, y)| (4..width - 4).contains(x) && (4..height - 4).contains(y))
                .filter(|(x, y)| strength[y * width + x] >= 4 && counts(y * width + x))
                .collect();
            // Of equals, the first: `max_by_key` would return the last.
            let best = eligible.iter().rev().max_by_key(|(x, y)| strength[y * width + x]);
            found.extend(
                best.filter(|_| eligible.len() >= enough)
                    .map(|&(x, y)| Candidate { x, y }),
            );
        }
    }
    found
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn each_cell_gives_its_strongest_pixel_in_snake_order(
        (width, height) in (32usize..120, 32usize..70),
        cell_px in prop_oneof![Just(2usize), Just(4), Just(8), Just(16)],
        (strengths, seed) in (prop_oneof![Just(5usize), Just(8), Just(256)], any::<u64>()),
        explained_up_to in proptest::option::of(prop_oneof![Just(62u8), Just(180), Just(250)]),
        few in 1usize..=3,
    ) {
        let mut noise = Noise::new(seed);
        let gradient = gradient(&mut noise, width, height, strengths);
        let cost = noise.bytes(width * height, 256);
        let mut found = vec![Candidate { x: 1, y: 1 }];
        let enough = if explained_up_to.is_some() { few * cell_px } else { 1 };
        let unexplained = explained_up_to.map(|explained_up_to| Unexplained { cost: &cost, explained_up_to, enough });
        strongest_per_cell(Level::detect(), &gradient, (width, height), cell_px, unexplained, (&mut Scratch::default(), &mut found));
        let counts = |at: usize| explained_up_to.is_none_or(|up_to| cost[at] > up_to);
        prop_assert_eq!(found, expected(&gradient.strength, (width, height), cell_px, counts, enough));
    }

    #[test]
    fn supports_stay_if_enough_others_near_them_agree(
        (width, height) in (32usize..300, 32usize..200),
        (fresh, known) in (0usize..120, 0usize..120),
        (radius_px, supporters, tolerance_px) in (0usize..90, 0usize..5, 0.0f32..8.0),
        seed in any::<u64>(),
    ) {
        let mut noise = Noise::new(seed);
        // Each at a pixel of its own: a support does not support itself.
        let mut taken = vec![false; width * height];
        let mut draw = |count: usize| -> Vec<Support> {
            (0..count)
                .filter_map(|_| {
                    let (x, y) = (noise.below(width), noise.below(height));
                    let disparity_px = f32::from(u8::try_from(noise.below(40)).unwrap()) / 2.0;
                    (!std::mem::replace(&mut taken[y * width + x], true)).then_some(Support { x, y, disparity_px })
                })
                .collect()
        };
        let (mut fresh, known) = (draw(fresh), draw(known));
        let all: Vec<Support> = fresh.iter().chain(&known).copied().collect();
        let expected: Vec<Support> = fresh
            .iter()
            .filter(|one| {
                let agreeing = all.iter().filter(|other| {
                    (other.x, other.y) != (one.x, one.y)
                        && other.x.abs_diff(one.x) <= radius_px
                        && other.y.abs_diff(one.y) <= radius_px
                        && (other.disparity_px - one.disparity_px).abs() <= tolerance_px
                });
                agreeing.count() >= supporters
            })
            .copied()
            .collect();
        let mut buckets = Buckets::default();
        buckets.reshape(width, height);
        let consistency = Consistency { radius_px, tolerance_px, supporters };
        // Twice: what the buckets held before must not matter.
        consistency.retain(&mut all.clone(), &known, &mut buckets);
        consistency.retain(&mut fresh, &known, &mut buckets);
        prop_assert_eq!(fresh, expected);
    }
}

#[test]
fn a_flat_image_has_no_candidates() {
    let (width, height) = (64, 48);
    let mut gradient = Gradient::default();
    gradient.reshape(width, height);
    gradient.compute(
        Level::detect(),
        &Image::from_fn(width, height, |_, _| 90).padded(MARGIN_X, MARGIN_X),
        0..height,
    );
    let mut found = Vec::new();
    strongest_per_cell(
        Level::detect(),
        &gradient,
        (width, height),
        8,
        None,
        (&mut Scratch::default(), &mut found),
    );
    assert!(found.is_empty());
}

/// What is left of supports in the middles of 5x5 cells, of which (2, 1) may go.
fn thinned(disparity_px: impl Fn(usize, usize) -> Option<f32>) -> Vec<(usize, usize)> {
    let cells = (0..5).flat_map(|row| (0..5).map(move |column| (column, row)));
    let mut supports: Vec<Support> = cells
        .filter_map(|(column, row)| {
            disparity_px(column, row).map(|disparity_px| Support {
                x: 16 * column + 8,
                y: 16 * row + 8,
                disparity_px,
            })
        })
        .collect();
    // What another frame has left behind.
    let mut cells = vec![supports.first().copied(); 40];
    thin(&mut supports, (80, 80), 16, &mut cells);
    supports
        .iter()
        .map(|support| (support.x / 16, support.y / 16))
        .collect()
}

#[test]
fn of_a_plane_every_second_support_but_those_at_the_border_is_enough() {
    let left = thinned(|column, row| Some(3.0 * column as f32 + 5.0 * row as f32));
    let dropped = [(2, 1), (1, 2), (3, 2), (2, 3)];
    assert_eq!(left.len(), 21);
    assert!(dropped.iter().all(|cell| !left.contains(cell)));
}

#[test]
fn a_support_that_says_more_than_those_around_stays() {
    let keeps = |disparity_px: fn(usize, usize) -> Option<f32>| thinned(disparity_px).contains(&(2, 1));
    assert!(!keeps(|column, row| Some(if (column, row) == (2, 1) {
        10.9
    } else {
        10.0
    })));
    assert!(keeps(|column, row| Some(if (column, row) == (2, 1) {
        11.1
    } else {
        10.0
    })));
    // On the line through two neighbours, but not on the one through the others.
    assert!(keeps(|_, row| Some(if row == 0 { 30.0 } else { 10.0 })));
    assert!(keeps(|column, _| Some(if column == 1 { 30.0 } else { 10.0 })));
    // Two neighbours are enough, one is not.
    assert!(!keeps(|_, row| (row == 1).then_some(10.0)));
    assert!(!keeps(|column, _| (column == 2).then_some(10.0)));
    assert!(keeps(|column, row| (column >= 2 && row >= 1).then_some(10.0)));
}
