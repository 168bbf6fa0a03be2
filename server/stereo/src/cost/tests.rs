use proptest::prelude::*;

use super::{Best, Evaluation, Scratch, Window};
use crate::census::Pattern;
use crate::changes::{Blocks, Changes};
use crate::scene::{Image, Noise, Views, code};
use crate::simd::Level;

const PATTERN: Pattern = Pattern::Sparse9x7;

/// D_f and C_f of a whole window.
#[derive(Debug, Clone, PartialEq)]
struct Maps {
    disparity: Vec<u16>,
    cost: Vec<u8>,
}

impl Maps {
    /// Updates in bands of `rows`.
    fn update(&mut self, evaluation: &Evaluation<'_>, rows: usize, scratch: &mut Scratch) {
        let band = rows * evaluation.width;
        let bands = self.disparity.chunks_mut(band).zip(self.cost.chunks_mut(band));
        for (k, (disparity, cost)) in bands.enumerate() {
            evaluation.update(k * rows, |_| Blocks::ALL, &mut Best { disparity, cost }, scratch);
        }
    }

    /// Updates the blocks that are marked.
    fn update_marked(&mut self, evaluation: &Evaluation<'_>, changes: &Changes, scratch: &mut Scratch) {
        let Self { disparity, cost } = self;
        evaluation.update(
            0,
            |y| changes.blocks(y, 0),
            &mut Best { disparity, cost },
            scratch,
        );
    }

    /// The result of a frame that has none.
    fn begin(mut self, evaluation: &Evaluation<'_>, scratch: &mut Scratch) -> Self {
        let Self { disparity, cost } = &mut self;
        evaluation.begin(0, &mut Best { disparity, cost }, scratch);
        self
    }
}

/// The differing bits of a window, each pixel at its own candidate moved by `step`: all of 5x5 pixels, or those of each two
/// columns' mean of 7x7 (rounded up), as far as a byte counts.
fn differing_bits(evaluation: &Evaluation<'_>, at: (usize, usize), step: isize) -> u32 {
    let radius: isize = if evaluation.window == Window::Side5 { 2 } else { 3 };
    let clamp = |at: usize, by: isize, n: usize| at.saturating_add_signed(by).min(n - 1);
    let column = |dx: isize| -> u32 {
        let bits = |dy: isize| -> u32 {
            let x = clamp(at.0, dx, evaluation.width);
            let y = clamp(at.1, dy, evaluation.height);
            let candidate = f64::from(evaluation.candidates[y * evaluation.width + x]) / 64.0;
            #[expect(clippy::cast_possible_truncation, reason = "below 1024")]
            let d = (candidate + 0.5).floor() as isize + step;
            let differing = (0..PATTERN.planes().len()).map(|plane| {
                let left = code(evaluation.left, plane, false, x.cast_signed(), (y, 0));
                let right = code(evaluation.right, plane, true, x.cast_signed() - d, (y, 0));
                (left ^ right).count_ones()
            });
            differing.sum()
        };
        (-radius..=radius).map(bits).sum()
    };
    let bits = match evaluation.window {
        Window::Side5 => (-2..=2).map(column).sum(),
        Window::Side7 => {
            let pairs =
                [(-3, 3), (-2, 2), (-1, 1)].map(|(one, other)| (column(one) + column(other)).div_ceil(2));
            pairs.iter().sum::<u32>() + column(0).div_ceil(2)
        }
    };
    bits.min(255)
}

/// What is better than before by more than `by` is kept.
fn expected(evaluation: &Evaluation<'_>, before: &Maps, by: u8) -> Maps {
    let mut maps = before.clone();
    for at in 0..maps.cost.len() {
        let pixel = (at % evaluation.width, at / evaluation.width);
        let own = evaluation.candidates[at];
        // Of equals the candidate itself, then the smaller one.
        let tested = [(0, own), (-1, own.saturating_sub(64)), (1, own + 64)];
        let costs = tested.map(|(step, disparity)| (differing_bits(evaluation, pixel, step), disparity));
        let (bits, disparity) = costs.into_iter().min_by_key(|(bits, _)| *bits).unwrap();
        let cost = bits / 2 + bits / 8;
        if cost + u32::from(by) < u32::from(before.cost[at]) {
            (maps.disparity[at], maps.cost[at]) = (disparity, u8::try_from(cost).unwrap());
        }
    }
    maps
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn an_update_keeps_the_best_of_three_and_of_before_in_one_go_and_in_bands(
        (width, height, rows) in (32usize..=100, 32usize..44, 1usize..44),
        (is_large, levels) in (any::<bool>(), prop_oneof![Just(2usize), Just(256)]),
        sixteenths in 1usize..=16,
        // Neighbours may differ by this much.
        spread in prop_oneof![Just(1usize), Just(100), Just(20_000)],
        (costs_before, seed) in (prop_oneof![Just(120usize), Just(256)], any::<u64>()),
    ) {
        let mut noise = Noise::new(seed);
        let disparities = 16 * sixteenths;
        let left = Image::noise(&mut noise, width, height, levels);
        let right = left.seen_from_the_right(|_, _| 9);
        let codes = Views::of(PATTERN, [&left, &right], disparities);
        let most = (disparities - 1) * 64 + 1;
        let lowest = noise.below(most);
        let candidates: Vec<u16> = (0..width * height)
            .map(|_| u16::try_from(lowest + noise.below(spread.min(most - lowest))).unwrap())
            .collect();
        let window = if is_large { Window::Side7 } else { Window::Side5 };
        let evaluation = Evaluation { level: Level::detect(), left: &codes.left, right: &codes.right, candidates: &candidates, width, height, window };
        let before = Maps {
            disparity: noise.words(width * height, most),
            cost: noise.bytes(width * height, costs_before),
        };
        let mut scratch = Scratch::default();
        let (mut maps, by) = (before.clone(), u8::try_from(noise.below(256)).unwrap());
        let Maps { disparity, cost } = &mut maps;
        evaluation.update_by(by, 0, |_| Blocks::ALL, &mut Best { disparity, cost }, &mut scratch);
        prop_assert!(maps == expected(&evaluation, &before, by), "better by more than {}", by);
        let expected = expected(&evaluation, &before, 0);
        for rows in [height, rows] {
            let mut maps = before.clone();
            maps.update(&evaluation, rows, &mut scratch);
            prop_assert!(maps == expected, "in bands of {}", rows);
        }
        // Some blocks: those are as if all had been updated, all others as before.
        let mut changes = Changes::default();
        changes.reset(height);
        for _ in 0..noise.below(height) {
            let x = noise.below(width);
            changes.mark(noise.below(height), x, x);
        }
        let mut maps = before.clone();
        maps.update_marked(&evaluation, &changes, &mut scratch);
        let mut some = before.clone();
        for y in 0..height {
            for run in changes.blocks(y, 0).runs(width) {
                let run = y * width + run.start..y * width + run.end;
                some.disparity[run.clone()].copy_from_slice(&expected.disparity[run.clone()]);
                some.cost[run.clone()].copy_from_slice(&expected.cost[run]);
            }
        }
        prop_assert!(maps == some, "of some blocks");
        // The first time, whatever was there before.
        let mut worst = before.clone();
        worst.cost.fill(u8::MAX);
        worst.update(&evaluation, height, &mut scratch);
        prop_assert!(before.begin(&evaluation, &mut scratch) == worst, "the first time");
    }
}

#[test]
fn the_true_disparity_costs_nothing_and_replaces_what_costs_more() {
    let left = Image::noise(&mut Noise::new(8), 80, 40, 256);
    let right = left.seen_from_the_right(|_, _| 12);
    let codes = Views::of(PATTERN, [&left, &right], 32);
    for (candidate, found) in [
        (12 * 64 + 20, 12 * 64 + 20),
        (11 * 64, 12 * 64),
        (13 * 64, 12 * 64),
        (20 * 64, 7),
    ] {
        for window in [Window::Side5, Window::Side7] {
            let candidates = vec![candidate; 80 * 40];
            let evaluation = Evaluation {
                level: Level::detect(),
                left: &codes.left,
                right: &codes.right,
                candidates: &candidates,
                width: 80,
                height: 40,
                window,
            };
            let mut maps = Maps {
                disparity: vec![7; 80 * 40],
                cost: vec![30; 80 * 40],
            };
            maps.update(&evaluation, 40, &mut Scratch::default());
            let at = 20 * 80 + 40;
            assert_eq!(
                (maps.disparity[at], maps.cost[at]),
                (found, if found == 7 { 30 } else { 0 })
            );
        }
    }
}
