use proptest::prelude::*;

use super::{Iteration, Occupancy};
use crate::census::Pattern;
use crate::cost::Best;
use crate::scene::{Image, Noise, Views};
use crate::simd::Level;
use crate::support::{Candidate, Support};

const DISPARITIES: usize = 32;
const CONFIDENT_BELOW: u8 = 42;
const INVALID_ABOVE: u8 = 125;

/// Differing bits (of 24, as a share of 250) of the two 5x5 patches, the right one sampled between its pixels.
fn cost(left: &Image, right: &Image, (x, y): (usize, usize), disparity: u16) -> u8 {
    let (x, y) = (x.cast_signed(), y.cast_signed());
    let sample = |dx: isize, dy: isize| {
        let at = (x + dx) as f64 - f64::from(disparity) / 64.0;
        #[expect(
            clippy::cast_possible_truncation,
            reason = "a column of the image or its margin"
        )]
        let whole = at.floor() as isize;
        let [before, after] = [whole, whole + 1].map(|column| f64::from(right.at(column, y + dy)));
        before + (after - before) * (at - at.floor())
    };
    let mut differing = 0;
    for (dx, dy) in (-2..=2).flat_map(|dx| (-2..=2).map(move |dy| (dx, dy))) {
        let is_brighter = left.at(x + dx, y + dy) > left.at(x, y);
        differing += u16::from(is_brighter != (sample(dx, dy) > sample(0, 0)));
    }
    u8::try_from(differing * 250 / 24).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn an_iteration_keeps_what_is_cheaper_and_each_cells_cheapest_and_dearest_pixel(
        (width, height, rows) in (32usize..80, 32usize..50, 1usize..50),
        side_px in prop_oneof![Just(1usize), Just(4), Just(7), Just(32)],
        // Few levels and whole disparities make ties and costs of zero.
        (levels, step) in (prop_oneof![Just(2usize), Just(12), Just(256)], prop_oneof![Just(1u16), Just(64)]),
        seed in any::<u64>(),
    ) {
        let mut noise = Noise::new(seed);
        let left = Image::noise(&mut noise, width, height, levels);
        // Half of the pixels at their place, so that all kinds of costs are there.
        let right = left.seen_from_the_right(|_, _| 3);
        let views = Views::of(Pattern::Full5x5, [&left, &right], DISPARITIES);
        let mask = noise.bytes(width * height, 2);
        let wild = noise.words(width * height, (DISPARITIES - 1) * 64);
        let interpolated: Vec<u16> = wild.iter().map(|&d| if d % 2 == 0 { 3 * 64 } else { d / step * step }).collect();
        let before = (noise.words(width * height, 2000), noise.bytes(width * height, 256));

        let level = Level::available()[noise.below(Level::available().len())];
        let iteration = Iteration {
            level,
            left: &views.left,
            right_image: &views.right_image,
            mask: &mask,
            interpolated: &interpolated,
            width,
            confident_below: CONFIDENT_BELOW,
            invalid_above: INVALID_ABOVE,
        };
        let mut occupancy = Occupancy::default();
        occupancy.reset(1, 9, 9);
        occupancy.reset(side_px, width, height);
        let (mut disparity, mut best_cost) = before.clone();
        let bands = disparity.chunks_mut(rows * width).zip(best_cost.chunks_mut(rows * width));
        for (k, (disparity, cost)) in bands.enumerate() {
            let end = (k * rows + rows).min(height);
            iteration.refine(k * rows..end, &mut Best { disparity, cost }, &mut occupancy);
        }

        let columns = width.div_ceil(side_px);
        let mut cells = vec![(None, None); columns * height.div_ceil(side_px)];
        for (at, (x, y)) in (0..width * height).map(|at| (at, (at % width, at / width))).filter(|(at, _)| mask[*at] != 0) {
            let cost = cost(&left, &right, (x, y), interpolated[at]);
            let best = if cost < before.1[at] { (interpolated[at], cost) } else { (before.0[at], before.1[at]) };
            prop_assert_eq!((disparity[at], best_cost[at]), best, "at {}, {}", x, y);
            if (4..width - 4).contains(&x) && (4..height - 4).contains(&y) {
                let (cheapest, dearest) = &mut cells[y / side_px * columns + x / side_px];
                if cost < CONFIDENT_BELOW && cheapest.is_none_or(|(least, _)| cost < least) {
                    *cheapest = Some((cost, at));
                }
                if cost > INVALID_ABOVE && dearest.is_none_or(|(most, _)| cost > most) {
                    *dearest = Some((cost, at));
                }
            }
        }
        for at in (0..width * height).filter(|at| mask[*at] == 0) {
            prop_assert_eq!((disparity[at], best_cost[at]), (before.0[at], before.1[at]), "outside of the mask");
        }
        let confident: Vec<Support> = occupancy.confident().collect();
        let expected: Vec<Support> = cells
            .iter()
            .filter_map(|cell| cell.0)
            .map(|(_, at)| Support { x: at % width, y: at / width, disparity_px: f32::from(interpolated[at]) / 64.0 })
            .collect();
        prop_assert_eq!(confident, expected);
        let invalid: Vec<Candidate> = occupancy.invalid().collect();
        let expected: Vec<Candidate> = cells
            .iter()
            .filter_map(|cell| cell.1)
            .map(|(_, at)| Candidate { x: at % width, y: at / width })
            .collect();
        prop_assert_eq!(invalid, expected);
    }
}

#[test]
fn an_empty_grid_has_neither_confident_nor_invalid_pixels() {
    let mut occupancy = Occupancy::default();
    occupancy.reset(8, 64, 64);
    assert_eq!(
        (occupancy.confident().count(), occupancy.invalid().count()),
        (0, 0)
    );
}
