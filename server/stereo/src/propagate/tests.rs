use proptest::prelude::*;

use super::{From, GOOD_BELOW, REACH_PX, candidates};
use crate::scene::Noise;

const DIRECTIONS: [(From, (isize, isize)); 4] = [
    (From::Left, (-1, 0)),
    (From::Right, (1, 0)),
    (From::Above, (0, -1)),
    (From::Below, (0, 1)),
];

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_bad_pixel_tries_the_nearest_good_one_on_its_side_within_reach(
        (width, height) in (1usize..40, 1usize..40),
        (good_one_in, seed) in (1usize..30, any::<u64>()),
    ) {
        let mut noise = Noise::new(seed);
        let disparity = noise.words(width * height, 16_000);
        let cost: Vec<u8> = (0..width * height)
            .map(|_| if noise.below(good_one_in) == 0 { GOOD_BELOW - 1 } else { GOOD_BELOW })
            .collect();
        for (from, (dx, dy)) in DIRECTIONS {
            let mut proposed = vec![0; width * height];
            candidates(from, width, &disparity, &cost, &mut proposed);
            for at in 0..width * height {
                let (x, y) = (at % width, at / width);
                let lender = (0..=isize::from(REACH_PX)).find_map(|step| {
                    let x = x.checked_add_signed(step * dx).filter(|&x| x < width)?;
                    let y = y.checked_add_signed(step * dy).filter(|&y| y < height)?;
                    (cost[y * width + x] < GOOD_BELOW).then_some(y * width + x)
                });
                prop_assert_eq!(proposed[at], disparity[lender.unwrap_or(at)], "{:?} at {}, {}", from, x, y);
            }
        }
    }
}
