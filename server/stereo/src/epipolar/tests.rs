use proptest::prelude::*;

use super::{Known, Quincunx, Search, TapRow, Taps, Views, Window5x5};
use crate::census::Pattern;
use crate::scene::{self, Image, Noise, code};
use crate::simd::Level;
use crate::support::Candidate;

const STRICT: Search = Search {
    taps: Taps::Quincunx,
    max_cost: 0.35,
    uniqueness: 0.72,
    left_right_px: 1,
    subpixel: true,
};

/// Matches are accepted whatever they cost.
const ANY_COST: Search = Search {
    max_cost: 1.0,
    uniqueness: 1.0,
    ..STRICT
};

const DISPARITIES: usize = 48;

fn offsets(taps: Taps) -> impl Iterator<Item = (i8, i8)> {
    let rows: &[TapRow] = match taps {
        Taps::Quincunx => Quincunx::ROWS,
        Taps::Window5x5 => Window5x5::ROWS,
    };
    rows.iter().flat_map(|row| row.dx.iter().map(|&dx| (dx, row.dy)))
}

/// A window's codes and the columns before it.
struct Scene {
    codes: scene::Views,
    pattern: Pattern,
    width: usize,
    disparities: usize,
    columns_before: isize,
}

impl Scene {
    fn new(pattern: Pattern, images: [&Image; 2], (x, width): (usize, usize), disparities: usize) -> Self {
        Self {
            codes: scene::Views::of_window(pattern, images, (x, width), disparities),
            pattern,
            width,
            disparities,
            columns_before: x.cast_signed(),
        }
    }

    fn of(left: &Image, right: &Image) -> Self {
        Self::new(Pattern::Sparse9x7, [left, right], (0, left.width), DISPARITIES)
    }

    fn views(&self) -> Views<'_> {
        Views {
            pattern: self.pattern,
            left: &self.codes.left,
            right: &self.codes.right,
            width: self.width,
            disparities: self.disparities,
            columns_before: self.columns_before,
            near: None,
        }
    }

    fn find(&self, search: &Search, x: usize, y: usize) -> Option<f32> {
        let views = self.views();
        let mut found = Vec::new();
        search.search(Level::detect(), &views, &[Candidate { x, y }], &mut found);
        found.first().map(|support| support.disparity_px)
    }

    /// Differing bits between the left view around `left_x` and the right view around `right_x`.
    fn cost(&self, search: &Search, left_x: isize, right_x: isize, y: usize) -> u32 {
        let mut bits = 0;
        for (dx, dy) in offsets(search.taps) {
            for plane in 0..self.pattern.planes().len() {
                let left = code(&self.codes.left, plane, false, left_x + isize::from(dx), (y, dy));
                let right = code(&self.codes.right, plane, true, right_x + isize::from(dx), (y, dy));
                bits += (left ^ right).count_ones();
            }
        }
        bits
    }

    /// The module's pseudo-code, word by word.
    fn expected(&self, search: &Search, x: usize, y: usize) -> Option<f32> {
        let first_least = |costs: &[(isize, u32)]| costs.iter().min_by_key(|(_, cost)| *cost).copied();
        let range = 0..self.disparities.cast_signed();
        let x = x.cast_signed();
        let costs: Vec<_> = range
            .clone()
            .filter(|d| x - d + self.columns_before >= 0)
            .map(|d| (d, self.cost(search, x, x - d, y)))
            .collect();
        let (best, cost) = first_least(&costs)?;
        let as_f32 = |cost: u32| f32::from(u16::try_from(cost).unwrap());
        let bits = u32::try_from(offsets(search.taps).count() * self.pattern.bits()).unwrap();
        let elsewhere = costs
            .iter()
            .filter(|(d, _)| d.abs_diff(best) > 2)
            .map(|(_, cost)| *cost)
            .min()?;
        let looks_alike = as_f32(cost) <= search.max_cost * as_f32(bits);
        let unique = as_f32(cost) < search.uniqueness * as_f32(elsewhere);
        let back: Vec<_> = range
            .filter(|d| (0..self.width.cast_signed()).contains(&(x - best + d)))
            .map(|d| (d, self.cost(search, x - best + d, x - best, y)))
            .collect();
        let found_back = first_least(&back)?.0.abs_diff(best) <= search.left_right_px;
        let whole = f32::from(i16::try_from(best).unwrap());
        let at = best.unsigned_abs();
        let offset = match costs.get(at.wrapping_sub(1)).zip(costs.get(at + 1)) {
            Some((&(_, before), &(_, after))) if search.subpixel && before.max(after) > cost => {
                (as_f32(before) - as_f32(after)) / (2.0 * as_f32(before.max(after) - cost))
            }
            _ => 0.0,
        };
        (looks_alike && unique && found_back).then_some((whole + offset).max(0.0))
    }
}

fn noise(seed: u64, width: usize) -> Image {
    Image::noise(&mut Noise::new(seed), width, 24, 256)
}

#[test]
fn the_shift_of_a_texture_is_found() {
    let left = noise(1, 160);
    for shift in [0, 1, 17, DISPARITIES - 1] {
        let scene = Scene::of(&left, &left.seen_from_the_right(|_, _| shift));
        for x in shift + 8..150 {
            let found = scene.find(&STRICT, x, 12).unwrap();
            assert!(
                (found - shift as f32).abs() <= 0.5,
                "{found} at {x} instead of {shift}"
            );
            let whole = scene.find(
                &Search {
                    subpixel: false,
                    ..STRICT
                },
                x,
                12,
            );
            assert_eq!(whole, Some(shift as f32));
        }
    }
}

#[test]
fn a_repeated_texture_has_no_unique_match() {
    let texture = noise(2, 160);
    let repeated = |period: usize| {
        Image::from_fn(160, 24, |x, y| {
            texture.at((x % period).cast_signed(), y.cast_signed())
        })
    };
    for period in [4, 11, 20] {
        let left = repeated(period);
        let scene = Scene::of(&left, &left.seen_from_the_right(|_, _| 3));
        assert!(
            (60..150).all(|x| scene.find(&STRICT, x, 12).is_none()),
            "period {period}"
        );
    }
}

#[test]
fn a_hidden_pixel_is_given_away_by_searching_back() {
    // A box at disparity 30 in front of a wall at 2 hides the wall's columns 32 to 59 from the right view.
    let (wall, front) = (noise(3, 160), noise(4, 160));
    let at = |image: &Image, x: usize, y: usize| image.at(x.cast_signed(), y.cast_signed());
    let left = Image::from_fn(160, 24, |x, y| {
        at(if (60..100).contains(&x) { &front } else { &wall }, x, y)
    });
    let right = Image::from_fn(160, 24, |x, y| {
        if (30..70).contains(&x) {
            at(&front, x + 30, y)
        } else {
            at(&wall, x + 2, y)
        }
    });
    let scene = Scene::of(&left, &right);
    let unchecked = Search {
        left_right_px: DISPARITIES,
        ..ANY_COST
    };
    for x in 42..50 {
        assert!(scene.find(&unchecked, x, 12).is_some());
        assert_eq!(scene.find(&ANY_COST, x, 12), None, "{x}");
    }
    assert!((scene.find(&STRICT, 80, 12).unwrap() - 30.0).abs() <= 0.5);
    assert!((scene.find(&STRICT, 120, 12).unwrap() - 2.0).abs() <= 0.5);
}

#[test]
fn near_the_left_border_only_what_the_view_has_is_searched() {
    let left = noise(5, 200);
    let right = left.seen_from_the_right(|_, _| 20);
    // In the whole image the match of column 12 would be left of the view; in a window of it, it exists.
    let whole = Scene::of(&left, &right);
    assert_eq!(whole.find(&STRICT, 12, 12), None);
    assert!((4..18).all(|x| whole.find(&ANY_COST, x, 12).is_none_or(|found| found <= x as f32)));
    let window = Scene::new(Pattern::Sparse9x7, [&left, &right], (60, 100), DISPARITIES);
    assert!((window.find(&STRICT, 12, 12).unwrap() - 20.0).abs() <= 0.5);
    // Too few candidates to tell whether one is unique, and none at all.
    assert_eq!(whole.find(&ANY_COST, 2, 12), None);
    assert_eq!(
        Scene {
            columns_before: -30,
            ..whole
        }
        .find(&ANY_COST, 12, 12),
        None
    );
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_search_is_the_pseudo_code_for_both_presets_patterns_and_any_limits(
        (full, window, subpixel) in (any::<bool>(), any::<bool>(), any::<bool>()),
        (width, before, after) in (32usize..100, 0usize..60, 0usize..20),
        (sixteenths, shift) in (1usize..=16, 0usize..40),
        (max_cost, uniqueness) in (0.1f32..=1.0, 0.5f32..=1.0),
        left_right_px in prop_oneof![Just(0usize), Just(1), Just(300)],
        smallest in 0usize..30,
        (levels, dirt, seed) in (prop_oneof![Just(2usize), Just(256)], 1usize..20, any::<u64>()),
    ) {
        let mut random = Noise::new(seed);
        let left = Image::noise(&mut random, before + width + after, 16, levels);
        let dirty = Image::noise(&mut random, left.width, 16, dirt);
        let shifted = left.seen_from_the_right(|_, _| shift);
        let right = Image::from_fn(left.width, 16, |x, y| {
            let (x, y) = (x.cast_signed(), y.cast_signed());
            if dirty.at(x, y) == 0 { dirty.at(y, x) } else { shifted.at(x, y) }
        });
        let pattern = if full { Pattern::Full5x5 } else { Pattern::Sparse9x7 };
        let taps = if window { Taps::Window5x5 } else { Taps::Quincunx };
        let search = Search { taps, max_cost, uniqueness, left_right_px, subpixel };
        let mut scene = Scene::new(pattern, [&left, &right], (before, width), 16 * sixteenths);
        scene.columns_before -= smallest.cast_signed();
        for x in 4..width - 4 {
            for y in [4, 8, 11] {
                let (found, whole) = (scene.find(&search, x, y), scene.find(&Search { subpixel: false, ..search }, x, y));
                prop_assert_eq!(found, scene.expected(&search, x, y), "at {}, {}", x, y);
                prop_assert_eq!(found.is_some(), whole.is_some());
                let offset = found.unwrap_or(0.0) - whole.unwrap_or(0.0);
                prop_assert!(offset.abs() <= 0.5 && (subpixel || offset == 0.0), "{}", offset);
            }
        }
    }
}

#[test]
fn near_a_map_only_what_it_says_is_searched() {
    let left = Image::noise(&mut Noise::new(5), 300, 40, 256);
    let right = left.seen_from_the_right(|_, _| 90);
    let scene = Scene::new(Pattern::Sparse9x7, [&left, &right], (0, 300), 128);
    let found = |fixed: u16| {
        let map = vec![fixed; 300 * 40];
        let views = Views {
            near: Some(&map),
            ..scene.views()
        };
        let mut found = Vec::new();
        STRICT.search(
            Level::detect(),
            &views,
            &[Candidate { x: 250, y: 20 }],
            &mut found,
        );
        found.first().map(|support| support.disparity_px.round())
    };
    // 64 disparities around the map's.
    assert_eq!(
        [60 * 64, 121 * 64, 57 * 64, 10 * 64].map(found),
        [Some(90.0), Some(90.0), None, None]
    );
}
