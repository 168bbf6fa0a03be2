use super::{EXPLAINED_UP_TO, drop_taken, lend, spare};
use crate::changes::Changes;
use crate::support::Support;

const WIDTH: usize = 64;
const HEIGHT: usize = 16;

fn found(x: usize, y: usize, disparity_px: f32) -> Support {
    Support { x, y, disparity_px }
}

#[test]
fn a_place_that_a_well_explained_pixel_shows_is_taken() {
    // Everything at 10 px, explained; the pixels of row 3 around column 30 are not.
    let disparity = vec![640; WIDTH * HEIGHT];
    let mut cost = vec![EXPLAINED_UP_TO; WIDTH * HEIGHT];
    for x in 26..35 {
        cost[3 * WIDTH + x] = EXPLAINED_UP_TO + 1;
    }
    let free = [found(30, 3, 10.0), found(33, 3, 13.9), found(20, 3, 0.0)];
    let taken = [
        found(30, 3, 16.0),
        found(30, 3, 3.0),
        found(33, 4, 13.9),
        found(63, 3, 12.4),
    ];
    let mut matches: Vec<Support> = free.iter().chain(&taken).copied().collect();
    drop_taken(&mut matches, (&disparity, &cost), WIDTH, 16);
    // Column 20 shows what column 30 does not explain.
    assert_eq!(matches, free);
}

#[test]
fn pixels_beyond_the_most_are_left_out_evenly() {
    let mut pixels: Vec<usize> = (0..10).collect();
    spare(&mut pixels, 10);
    assert_eq!(pixels.len(), 10);
    spare(&mut pixels, 4);
    assert_eq!(pixels, [2, 4, 7, 9]);
    spare(&mut pixels, 0);
    assert_eq!(pixels, []);
}

#[test]
fn the_pixels_in_reach_try_the_nearest_match_and_no_others() {
    let mut candidates = vec![7; WIDTH * HEIGHT];
    let mut changes = Changes::default();
    changes.reset(HEIGHT);
    lend(
        &[found(20, 5, 3.25), found(24, 5, 9.0), found(60, 0, 200.0)],
        (&mut candidates, WIDTH),
        1000,
        &mut changes,
    );
    let row = |y: usize| &candidates[y * WIDTH..][..WIDTH];
    let columns = |y: usize, disparity: u16| -> Vec<usize> {
        let row = row(y).iter().enumerate();
        row.filter(|&(_, &at)| at == disparity).map(|(x, _)| x).collect()
    };
    assert_eq!(columns(5, 208), (12..22).collect::<Vec<_>>());
    assert_eq!(columns(5, 576), (22..33).collect::<Vec<_>>());
    // No further than the image, and no more than the largest disparity.
    assert_eq!(columns(0, 1000), (52..WIDTH).collect::<Vec<_>>());
    assert_eq!(
        [columns(5, 7).len(), columns(14, 7).len()],
        [WIDTH - 21 - 12, WIDTH]
    );
    let marked = (0..HEIGHT).filter(|&y| changes.blocks(y, 0).runs(WIDTH).next().is_some());
    assert_eq!(marked.collect::<Vec<_>>(), (0..14).collect::<Vec<_>>());
}
