//! The last touch on a dense map: a 3x3 median takes out single wrong pixels, a 3x3 mean of the neighbours on the same
//! surface steadies the sub-pixel part.

use crate::disparity::FIXED_PER_PX;
use crate::simd::{Kernel, Lanes, Level};

/// Pixels of one block: plain loops over arrays of this length become vector code.
const BLOCK: usize = 16;

/// Rows `rows` of `to` from the map `from` (rows of `width`, at least [`BLOCK`] + 2); the map's border is copied.
pub(crate) fn median(level: Level, width: usize, from: &[u16], rows: std::ops::Range<usize>, to: &mut [u16]) {
    level.run(Smooth {
        width,
        from,
        rows,
        to,
        of_nine: median_of_nine,
    });
}

/// The same with the mean of those neighbours that are within a pixel of the centre.
pub(crate) fn mean(level: Level, width: usize, from: &[u16], rows: std::ops::Range<usize>, to: &mut [u16]) {
    level.run(Smooth {
        width,
        from,
        rows,
        to,
        of_nine: mean_of_surface,
    });
}

type Block = [u16; BLOCK];

struct Smooth<'a, F> {
    width: usize,
    from: &'a [u16],
    rows: std::ops::Range<usize>,
    to: &'a mut [u16],
    of_nine: F,
}

impl<F: Fn([Block; 9]) -> Block> Kernel for Smooth<'_, F> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self {
            width,
            from,
            rows,
            to,
            of_nine,
        } = self;
        let last_row = from.len() / width - 1;
        for (y, to) in rows.zip(to.chunks_exact_mut(width)) {
            to.copy_from_slice(&from[y * width..][..width]);
            if y == 0 || y == last_row {
                continue;
            }
            let inner = width - 2;
            // The last block overlaps the one before.
            let starts = (0..inner / BLOCK).map(|block| block * BLOCK);
            for x in starts.chain([inner - BLOCK]) {
                to[x + 1..x + 1 + BLOCK].copy_from_slice(&of_nine(around(from, width, (x, y))));
            }
        }
    }
}

/// The nine shifted blocks around the pixels right of column `x`.
#[inline(always)]
fn around(from: &[u16], width: usize, (x, y): (usize, usize)) -> [Block; 9] {
    let mut nine = [[0; BLOCK]; 9];
    for (k, block) in nine.iter_mut().enumerate() {
        block.copy_from_slice(&from[(y + k / 3 - 1) * width + x + k % 3..][..BLOCK]);
    }
    nine
}

/// Brings the median of nine to the middle by ordering rows first (Smith 1996).
#[inline(always)]
fn median_of_nine(nine: [Block; 9]) -> Block {
    let mut medians = [0; BLOCK];
    for k in 0..BLOCK {
        let [mut a, mut b, mut c] = [nine[0][k], nine[1][k], nine[2][k]];
        let [mut d, mut e, mut f] = [nine[3][k], nine[4][k], nine[5][k]];
        let [mut g, mut h, mut i] = [nine[6][k], nine[7][k], nine[8][k]];
        // Each row in order, ..
        (a, b, c) = in_order(a, b, c);
        (d, e, f) = in_order(d, e, f);
        (g, h, i) = in_order(g, h, i);
        // .. then the median is that of the largest first, the middle second and the smallest third ones.
        let first = a.max(d).max(g);
        let (_, second, _) = in_order(b, e, h);
        let third = c.min(f).min(i);
        medians[k] = in_order(first, second, third).1;
    }
    medians
}

#[inline(always)]
fn in_order(a: u16, b: u16, c: u16) -> (u16, u16, u16) {
    let (low, high) = (a.min(b), a.max(b));
    let (middle, most) = (high.min(c), high.max(c));
    (low.min(middle), low.max(middle), most)
}

#[inline(always)]
fn mean_of_surface(nine: [Block; 9]) -> Block {
    let centre = nine[4];
    let (mut sum, mut count) = ([0i16; BLOCK], [0i16; BLOCK]);
    for block in nine {
        for k in 0..BLOCK {
            let step = block[k].wrapping_sub(centre[k]).cast_signed();
            let same = -i16::from(block[k].abs_diff(centre[k]) <= FIXED_PER_PX);
            sum[k] += step & same;
            count[k] -= same;
        }
    }
    let mut means = centre;
    for k in 0..BLOCK {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "a mean of steps of at most a pixel"
        )]
        let step = (f32::from(sum[k]) / f32::from(count[k])).round_ties_even() as i16;
        means[k] = centre[k].wrapping_add_signed(step);
    }
    means
}
