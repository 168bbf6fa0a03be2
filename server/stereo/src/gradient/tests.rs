use proptest::prelude::*;

use super::Gradient;
use crate::plane::MARGIN_X;
use crate::scene::{Image, Noise};
use crate::simd::Level;

/// Correlation with a 3x3 kernel.
fn correlate(image: &Image, kernel: [[i32; 3]; 3], x: usize, y: usize) -> i32 {
    let mut sum = 0;
    for (row, dy) in kernel.iter().zip(-1..) {
        for (weight, dx) in row.iter().zip(-1..) {
            sum += weight * i32::from(image.at(x.cast_signed() + dx, y.cast_signed() + dy));
        }
    }
    sum
}

fn gradient(image: &Image) -> Gradient {
    let mut gradient = Gradient::default();
    gradient.reshape(image.width, image.height);
    gradient.compute(
        Level::detect(),
        &image.padded(MARGIN_X, MARGIN_X),
        0..image.height,
    );
    gradient
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn mask_and_strength_are_those_of_the_sobel_operator(
        (width, height) in (1usize..90, 1usize..30),
        (levels, seed) in (prop_oneof![Just(2usize), Just(24), Just(256)], any::<u64>()),
    ) {
        let image = Image::noise(&mut Noise::new(seed), width, height, levels);
        let gradient = gradient(&image);
        for (x, y) in (0..width).flat_map(|x| (0..height).map(move |y| (x, y))) {
            let gx = correlate(&image, [[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]], x, y);
            let gy = correlate(&image, [[-1, -2, -1], [0, 0, 0], [1, 2, 1]], x, y);
            prop_assert_eq!(gradient.mask[y * width + x], u8::from(gx.abs() + gy.abs() >= 64));
            prop_assert_eq!(i32::from(gradient.strength[y * width + x]), gx.abs() / 4);
        }
    }
}

#[test]
fn a_vertical_edge_is_strong_and_a_horizontal_one_is_masked_but_weak() {
    let vertical = gradient(&Image::from_fn(32, 32, |x, _| if x < 16 { 0 } else { 255 }));
    let horizontal = gradient(&Image::from_fn(32, 32, |_, y| if y < 16 { 0 } else { 255 }));
    let at = 16 * 32 + 16;
    assert_eq!((vertical.mask[at], vertical.strength[at]), (1, 255));
    assert_eq!((horizontal.mask[at], horizontal.strength[at]), (1, 0));
    assert_eq!((vertical.mask[at + 8], vertical.strength[at + 8]), (0, 0));
}
