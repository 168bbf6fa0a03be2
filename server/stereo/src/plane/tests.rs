use proptest::prelude::*;

use super::{MARGIN_Y, Plane};
use crate::scene::{Image, Noise};

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_copy_is_the_view_with_its_edge_repeated_whatever_the_offset(
        (image_width, image_height) in (1usize..40, 1usize..30),
        (width, height) in (1usize..40, 1usize..30),
        (margin_left, margin_right) in (0usize..40, 0usize..40),
        left_px in prop_oneof![-60isize..60, Just(isize::MIN), Just(-1000), Just(1000), Just(isize::MAX / 2)],
        top_px in prop_oneof![0usize..40, Just(1000)],
        seed in any::<u64>(),
    ) {
        let image = Image::noise(&mut Noise::new(seed), image_width, image_height, 256);
        let mut plane = Plane::default();
        // Whatever a larger frame has left behind.
        plane.reshape(70, 50, 30, 30);
        plane.fill(7);
        plane.reshape(width, height, margin_left, margin_right);
        let rows = 0..plane.padded_height();
        plane.copy_from(&image.view(), (left_px, top_px), rows);
        prop_assert_eq!((plane.width(), plane.height()), (width, height));
        prop_assert_eq!(plane.stride(), margin_left + width + margin_right);
        let reach = i8::try_from(MARGIN_Y).unwrap();
        for (y, dy) in (0..height).map(|y| (y, 0)).chain((1..=reach).flat_map(|dy| [(0, -dy), (height - 1, dy)])) {
            let row = plane.row(y, dy);
            prop_assert_eq!(row.len(), plane.stride());
            for (column, &pixel) in row.iter().enumerate() {
                let x = left_px.saturating_add(column.cast_signed() - margin_left.cast_signed());
                prop_assert_eq!(pixel, image.at(x, (y + top_px).cast_signed() + isize::from(dy)));
            }
        }
    }
}

#[test]
fn a_written_row_is_read_back_and_its_neighbours_stay() {
    let mut plane = Plane::default();
    plane.reshape(4, 3, 2, 1);
    plane.fill(9);
    plane.row_mut(1).copy_from_slice(&[1, 2, 3, 4, 5, 6, 7]);
    assert_eq!(plane.row(1, 0), [1, 2, 3, 4, 5, 6, 7]);
    assert_eq!(plane.row(0, 1), plane.row(2, -1));
    assert!(
        plane
            .row(0, 0)
            .iter()
            .chain(plane.row(2, 0))
            .all(|&pixel| pixel == 9)
    );
}
