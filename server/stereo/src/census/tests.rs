use proptest::prelude::*;

use super::{Census, OUTSIDE, Pattern, REACH_PX};
use crate::plane::MARGIN_X;
use crate::scene::{Image, Noise, code};
use crate::simd::Level;

#[test]
fn patterns_compare_each_neighbour_once() {
    let offsets = |pattern: Pattern| {
        let mut offsets = pattern.planes().concat();
        offsets.sort_unstable();
        offsets
    };
    let mut square: Vec<_> = (-2..=2).flat_map(|dx| (-2..=2).map(move |dy| (dx, dy))).collect();
    square.retain(|&offset| offset != (0, 0));
    assert_eq!(offsets(Pattern::Full5x5), square);
    let sparse = offsets(Pattern::Sparse9x7);
    assert!(sparse.windows(2).all(|pair| pair[0] != pair[1]));
    assert!(sparse.iter().all(|&(dx, dy)| sparse.contains(&(-dx, -dy))));
    assert!(sparse.iter().all(|&(dx, dy)| dx.abs() <= 4 && dy.abs() <= 3));
    assert_eq!((Pattern::Sparse9x7.bits(), Pattern::Full5x5.bits()), (16, 24));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_bit_tells_whether_its_neighbour_is_brighter_and_columns_outside_are_neutral(
        (width, height) in (1usize..40, 1usize..20),
        (before, after) in (0usize..30, 0usize..30),
        (full, mirrored) in (any::<bool>(), any::<bool>()),
        // Columns of the padded row that the view has.
        (first, end) in (0usize..60, 0usize..120),
        (levels, seed) in (prop_oneof![Just(3usize), Just(256)], any::<u64>()),
    ) {
        let pattern = if full { Pattern::Full5x5 } else { Pattern::Sparse9x7 };
        let image = Image::noise(&mut Noise::new(seed), width, height, levels);
        let plane = image.padded(MARGIN_X + before, MARGIN_X + after);
        let mut census = Census::default();
        census.reshape(pattern, &plane, plane.height(), mirrored);
        census.compute(Level::detect(), pattern, &plane, first..end);
        prop_assert_eq!(census.planes().len() * 8, pattern.bits());
        // The outermost half margins have no codes: their neighbours may not exist.
        let coded = first.max(REACH_PX)..end.min(plane.stride() - REACH_PX);
        for (p, neighbours) in pattern.planes().iter().enumerate() {
            for (column, y) in (0..plane.stride()).flat_map(|column| (0..height).map(move |y| (column, y))) {
                let (x, row) = (column.cast_signed() - plane.margin_left().cast_signed(), y.cast_signed());
                let expected = if coded.contains(&column) {
                    let bit = |(dx, dy): (i8, i8)| image.at(x + isize::from(dx), row + isize::from(dy)) > image.at(x, row);
                    (0..8).fold(0, |byte, k| byte | u8::from(bit(neighbours[k])) << k)
                } else {
                    OUTSIDE
                };
                prop_assert_eq!(code(&census, p, mirrored, x, (y, 0)), expected, "plane {} at {}, {}", p, x, y);
            }
            let margins = [(0, -1), (height - 1, 1)];
            prop_assert!(margins.iter().all(|&(y, dy)| census.planes()[p].row(y, dy).iter().all(|&code| code == OUTSIDE)));
        }
    }
}

#[test]
fn a_mirrored_row_runs_from_right_to_left() {
    let plane = Image::noise(&mut Noise::new(5), 20, 3, 256).padded(MARGIN_X, MARGIN_X + 32);
    let [straight, mirrored] = [false, true].map(|mirrored| {
        let mut census = Census::default();
        census.reshape(Pattern::Sparse9x7, &plane, plane.height(), mirrored);
        census.compute(Level::detect(), Pattern::Sparse9x7, &plane, 0..plane.stride());
        census
    });
    for (straight, mirrored) in straight.planes().iter().zip(mirrored.planes()) {
        let mut reversed = mirrored.row(1, 0).to_vec();
        reversed.reverse();
        assert_eq!(straight.row(1, 0), reversed);
    }
    assert_eq!(mirrored.index(3), mirrored.index(4) + 1);
}
