//! From a pyramid level to the next finer one: disparities double, and so do the pixels.

use crate::disparity::FIXED_PER_PX;
use crate::simd::{Kernel, Lanes, Level};

/// Neighbours further apart than this (1/64 px) are different surfaces: no mixing.
const SAME_SURFACE: u16 = 2 * FIXED_PER_PX;

/// One row `y` of the finer level (`fine.len()` pixels) from the coarse map (rows of `width`).
///
/// Bilinear: a fine pixel lies a quarter of a coarse pixel off its coarse pixel's centre, so it is 9 : 3 : 3 : 1 of the four
/// around; at a jump it is its own coarse pixel's.
pub(crate) fn row(level: Level, coarse: &[u16], width: usize, y: usize, fine: &mut [u16]) {
    let height = coarse.len() / width;
    let near = (y / 2).min(height - 1);
    let far = if y.is_multiple_of(2) {
        near.saturating_sub(1)
    } else {
        (near + 1).min(height - 1)
    };
    let [near, far] = [near, far].map(|y| &coarse[y * width..][..width]);
    level.run(Row { near, far, fine });
}

struct Row<'a> {
    near: &'a [u16],
    far: &'a [u16],
    fine: &'a mut [u16],
}

impl Kernel for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self { near, far, fine } = self;
        let width = near.len();
        let far = &far[..width];
        let mix = |x: usize, beside: usize| {
            let corners = [near[x], near[beside], far[x], far[beside]];
            let largest = corners[0].max(corners[1]).max(corners[2].max(corners[3]));
            let smallest = corners[0].min(corners[1]).min(corners[2].min(corners[3]));
            let [own, side, other, diagonal] = corners.map(u32::from);
            let mixed = (9 * own + 3 * (side + other) + diagonal + 4) / 8;
            #[expect(
                clippy::cast_possible_truncation,
                reason = "a mean of 16-bit disparities, doubled: below 512 px of 64"
            )]
            let mixed = mixed as u16;
            if largest - smallest > SAME_SURFACE {
                2 * corners[0]
            } else {
                mixed
            }
        };
        let last = fine.len() - 1;
        fine[0] = mix(0, 0);
        if last > 0 {
            fine[1] = mix(0, 1.min(width - 1));
        }
        let (pairs, rest) = fine[2..].as_chunks_mut::<2>();
        let inner = pairs.len().min(width.saturating_sub(2));
        for (x, pair) in (1..).zip(&mut pairs[..inner]) {
            *pair = [mix(x, x - 1), mix(x, x + 1)];
        }
        for (x, pair) in (1 + inner..).zip(&mut pairs[inner..]) {
            *pair = [mix(x, x - 1), mix(x, x)];
        }
        if let [single] = rest {
            let x = last / 2;
            *single = mix(x, x - 1);
        }
    }
}
