//! From a pyramid level to the next finer one: disparities double, and so do the pixels.

use crate::disparity::FIXED_PER_PX;
use crate::simd::{Kernel, Lanes, Level};

/// Neighbours further apart than this (1/64 px) are different surfaces: no mixing.
const SAME_SURFACE: u16 = 2 * FIXED_PER_PX;

/// Row `y` of the finer level (`fine.len()` pixels) from the coarse map (rows of `width`, two at least), at most `most`.
///
/// Bilinear: a fine pixel lies a quarter of a coarse pixel off its coarse pixel's centre, so it is 9 : 3 : 3 : 1 of the four
/// around; at a jump it is its own coarse pixel's.
pub(crate) fn row(level: Level, coarse: &[u16], width: usize, y: usize, most: u16, fine: &mut [u16]) {
    let height = coarse.len() / width;
    let near = (y / 2).min(height - 1);
    let far = if y.is_multiple_of(2) {
        near.saturating_sub(1)
    } else {
        (near + 1).min(height - 1)
    };
    let [near, far] = [near, far].map(|y| &coarse[y * width..][..width]);
    level.run(Row {
        near,
        far,
        most,
        fine,
    });
}

struct Row<'a> {
    near: &'a [u16],
    far: &'a [u16],
    most: u16,
    fine: &'a mut [u16],
}

impl Kernel for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self {
            near,
            far,
            most,
            fine,
        } = self;
        let (pairs, rest) = fine.as_chunks_mut::<2>();
        let (last, odd) = (near.len() - 1, rest.len());
        let mix = |x: usize, beside: usize| mixed(near[x], near[beside], far[x], far[beside]).min(most);
        // The border repeats itself; an odd width ends within its last coarse pixel.
        for x in [0, last - odd] {
            pairs[x] = [mix(x, x.saturating_sub(1)), mix(x, (x + 1).min(last))];
        }
        if let [single] = rest {
            *single = mix(last, last - 1);
        }
        let count = last - 1;
        let [near_left, near_own, near_right] = [&near[..count], &near[1..1 + count], &near[2..2 + count]];
        let [far_left, far_own, far_right] = [&far[..count], &far[1..1 + count], &far[2..2 + count]];
        let pairs = &mut pairs[1..1 + count];
        for x in 0..count {
            let left = mixed(near_own[x], near_left[x], far_own[x], far_left[x]);
            let right = mixed(near_own[x], near_right[x], far_own[x], far_right[x]);
            pairs[x] = [left.min(most), right.min(most)];
        }
    }
}

/// `own` is a quarter of a pixel away, doubled like all disparities on the way to the finer level.
#[inline(always)]
fn mixed(own: u16, side: u16, other: u16, diagonal: u16) -> u16 {
    let largest = own.max(side).max(other.max(diagonal));
    let smallest = own.min(side).min(other.min(diagonal));
    // On one surface the differences are small, and so are their weighted sums.
    let off = |from: u16| from.wrapping_sub(own).cast_signed();
    let sum = off(side).wrapping_add(off(other));
    let sum = sum
        .wrapping_add(sum)
        .wrapping_add(sum)
        .wrapping_add(off(diagonal));
    let step = sum.wrapping_add(4) >> 3;
    let step = if largest - smallest > SAME_SURFACE {
        0
    } else {
        step
    };
    (2 * own).wrapping_add_signed(step)
}

#[cfg(test)]
mod tests {
    use super::row;
    use crate::simd::Level;

    fn enlarged(coarse: &[u16], width: usize, fine_width: usize, y: usize) -> Vec<u16> {
        let mut results = Level::available().into_iter().map(|level| {
            let mut fine = vec![0; fine_width];
            row(level, coarse, width, y, 2000, &mut fine);
            fine
        });
        let first = results.next().expect("the scalar level is always there");
        assert!(results.all(|result| result == first));
        first
    }

    #[test]
    fn a_slope_goes_on_at_half_the_step() {
        let coarse: Vec<u16> = [100, 108, 116, 124].repeat(2);
        assert_eq!(
            enlarged(&coarse, 4, 8, 1),
            [200, 204, 212, 220, 228, 236, 244, 248]
        );
        // One pixel less: the last coarse pixel has only one fine one.
        assert_eq!(enlarged(&coarse, 4, 7, 0), [200, 204, 212, 220, 228, 236, 244]);
    }

    #[test]
    fn nothing_is_mixed_across_a_jump_and_nothing_exceeds_the_most() {
        let coarse: Vec<u16> = [100, 100, 900, 1100].repeat(3);
        assert_eq!(
            enlarged(&coarse, 4, 8, 2),
            [200, 200, 200, 200, 1800, 1800, 2000, 2000]
        );
    }
}
