use proptest::prelude::*;

use super::{Found, GOOD_BELOW, Scratch, candidates};
use crate::changes::Changes;
use crate::scene::Noise;
use crate::simd::Level;

/// Steps to those that are asked, in order.
const ORDER: [isize; 17] = [0, -1, 1, -2, -3, 2, 3, -4, -5, -6, -7, 4, 5, 6, 7, -8, 8];
/// Below some of the disparities.
const MAX_FIXED: u16 = 15_000;

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_bad_pixel_tries_the_nearest_good_one_of_its_row_within_reach(
        (width, height) in (1usize..150, 1usize..20),
        (good_one_in, seed) in (1usize..30, any::<u64>()),
    ) {
        let mut noise = Noise::new(seed);
        let disparity = noise.words(width * height, 16_000);
        let cost: Vec<u8> = (0..width * height)
            .map(|_| if noise.below(good_one_in) == 0 { GOOD_BELOW - 1 } else { GOOD_BELOW })
            .collect();
            let mut proposed = vec![0; width * height];
            let (mut changes, mut scratch) = (Changes::default(), Scratch::default());
            changes.reset(height);
            let found = Found { width, disparity: &disparity, cost: &cost, max_fixed: MAX_FIXED };
            candidates(Level::detect(), found, &mut proposed, &mut changes, &mut scratch);
            let mut marked = vec![false; width * height];
            for y in 0..height {
                // A row by itself, from its own marks only.
                for columns in changes.blocks(y, 0).runs(width) { marked[y * width..][columns].fill(true); }
            }
            for at in 0..width * height {
                let (x, y) = (at % width, at / width);
                let lender = ORDER.iter().find_map(|&step| {
                    let x = x.checked_add_signed(step).filter(|&x| x < width)?;
                    (cost[y * width + x] < GOOD_BELOW).then_some(y * width + x)
                });
                let lent = disparity[lender.unwrap_or(at)].min(MAX_FIXED);
                prop_assert_eq!(proposed[at], lent, "at {}, {}", x, y);
                prop_assert!(marked[at] || lender.is_none_or(|lender| lender == at), "unmarked at {}, {}", x, y);
            }
    }
}
