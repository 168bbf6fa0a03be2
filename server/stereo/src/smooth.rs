//! The last touch on a dense map: a 3x3 median takes out single wrong pixels, a 3x3 mean of the neighbours on the same
//! surface steadies the sub-pixel part. Row by row, so that what a row's neighbours need of it is still at hand.

use crate::disparity::FIXED_PER_PX;
use crate::simd::{Kernel, Lanes, Level};

/// Pixels of one block: plain loops over arrays of this length become vector code.
const BLOCK: usize = 16;
/// Rows that a result depends on, the median's and the mean's.
const ROWS: usize = 3;

/// Rings of rows.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    /// Each three horizontal neighbours in order: smallest, middle and largest of [`ROWS`] rows.
    sorted: [Vec<u16>; 3],
    /// Medians of [`ROWS`] rows.
    medians: Vec<u16>,
}

/// Rows `rows` of the smoothed map `from` (rows of `width`, at least [`BLOCK`] + 2) to `to`; the map's border is copied.
pub(crate) fn smooth(
    level: Level,
    width: usize,
    from: &[u16],
    rows: std::ops::Range<usize>,
    to: &mut [u16],
    scratch: &mut Scratch,
) {
    level.run(Smooth {
        width,
        from,
        rows,
        to,
        scratch,
    });
}

type Block = [u16; BLOCK];

struct Smooth<'a> {
    width: usize,
    from: &'a [u16],
    rows: std::ops::Range<usize>,
    to: &'a mut [u16],
    scratch: &'a mut Scratch,
}

impl Kernel for Smooth<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self {
            width,
            from,
            rows,
            to,
            scratch,
        } = self;
        let Scratch { sorted, medians } = scratch;
        for ring in sorted.iter_mut().chain([&mut *medians]) {
            ring.resize(ROWS * width, 0);
        }
        let height = from.len() / width;
        let start = rows.start.saturating_sub(1);
        let (mut next_sorted, mut next_mean) = (start.saturating_sub(1), rows.start);
        for y in start..(rows.end + 1).min(height) {
            let below = (y + 2).min(height);
            for y in next_sorted..below {
                let slot = y % ROWS * width;
                let [low, middle, high] = sorted.each_mut().map(|ring| &mut ring[slot..][..width]);
                sort_row(&from[y * width..][..width], low, middle, high);
            }
            next_sorted = below;
            let median = &mut medians[y % ROWS * width..][..width];
            median.copy_from_slice(&from[y * width..][..width]);
            let is_inner = |y: usize| y > 0 && y + 1 < height;
            if is_inner(y) {
                median_row(sorted, median);
            }
            // A row whose neighbours' medians are all there; below the last row there is none.
            let ready = if y + 1 == height { height } else { y }.min(rows.end);
            for y in next_mean..ready {
                let to = &mut to[(y - rows.start) * width..][..width];
                to.copy_from_slice(&medians[y % ROWS * width..][..width]);
                if is_inner(y) {
                    let around = [y - 1, y, y + 1].map(|y| &medians[y % ROWS * width..][..width]);
                    mean_row(around, to);
                }
            }
            next_mean = ready.max(next_mean);
        }
    }
}

/// First columns of the blocks that cover `count` columns; the last one overlaps the one before.
#[inline(always)]
fn blocks(count: usize) -> impl Iterator<Item = usize> {
    let whole = (0..count / BLOCK).map(|block| block * BLOCK);
    whole.chain((!count.is_multiple_of(BLOCK)).then(|| count - BLOCK))
}

#[inline(always)]
fn block(of: &[u16], at: usize) -> Block {
    let mut block = [0; BLOCK];
    block.copy_from_slice(&of[at..at + BLOCK]);
    block
}

/// Each pixel and its two neighbours in order, for the inner columns.
#[inline(always)]
fn sort_row(row: &[u16], low: &mut [u16], middle: &mut [u16], high: &mut [u16]) {
    for x in blocks(row.len() - 2) {
        let (mut a, mut b, mut c) = (block(row, x), block(row, x + 1), block(row, x + 2));
        for k in 0..BLOCK {
            (a[k], b[k], c[k]) = in_order(a[k], b[k], c[k]);
        }
        for (to, from) in [(&mut *low, a), (&mut *middle, b), (&mut *high, c)] {
            to[x + 1..x + 1 + BLOCK].copy_from_slice(&from);
        }
    }
}

/// Medians of the inner columns, from three rows whose triples are in order: the median of the largest low, the middle
/// middle and the smallest high one (Smith 1996). The rows' order doesn't matter.
#[inline(always)]
fn median_row([low, middle, high]: &[Vec<u16>; 3], medians: &mut [u16]) {
    let width = medians.len();
    for x in blocks(width - 2) {
        let x = x + 1;
        let lows = [block(low, x), block(low, width + x), block(low, 2 * width + x)];
        let middles = [
            block(middle, x),
            block(middle, width + x),
            block(middle, 2 * width + x),
        ];
        let highs = [block(high, x), block(high, width + x), block(high, 2 * width + x)];
        let mut median = [0; BLOCK];
        for k in 0..BLOCK {
            let first = lows[0][k].max(lows[1][k]).max(lows[2][k]);
            let (_, second, _) = in_order(middles[0][k], middles[1][k], middles[2][k]);
            let third = highs[0][k].min(highs[1][k]).min(highs[2][k]);
            median[k] = in_order(first, second, third).1;
        }
        medians[x..x + BLOCK].copy_from_slice(&median);
    }
}

#[inline(always)]
fn in_order(a: u16, b: u16, c: u16) -> (u16, u16, u16) {
    let (low, high) = (a.min(b), a.max(b));
    let (middle, most) = (high.min(c), high.max(c));
    (low.min(middle), low.max(middle), most)
}

/// Added to a number of up to 2^22, this leaves it rounded in the low bits.
const ROUND: f32 = 12_582_912.0;

/// Means of the inner columns' neighbours within a pixel of disparity.
#[inline(always)]
fn mean_row(around: [&[u16]; ROWS], means: &mut [u16]) {
    for x in blocks(means.len() - 2) {
        let centre = block(around[1], x + 1);
        let (mut sum, mut count) = ([0i16; BLOCK], [0i16; BLOCK]);
        for row in around {
            for dx in 0..3 {
                let beside = block(row, x + dx);
                for k in 0..BLOCK {
                    let step = beside[k].wrapping_sub(centre[k]);
                    let same = -i16::from(step.wrapping_add(FIXED_PER_PX) <= 2 * FIXED_PER_PX);
                    sum[k] += step.cast_signed() & same;
                    count[k] -= same;
                }
            }
        }
        let mut mean = centre;
        for k in 0..BLOCK {
            let rounded = (f32::from(sum[k]) / f32::from(count[k]) + ROUND).to_bits();
            #[expect(clippy::cast_possible_truncation, reason = "the low bits are what is wanted")]
            {
                mean[k] = centre[k].wrapping_add(rounded as u16);
            }
        }
        means[x + 1..x + 1 + BLOCK].copy_from_slice(&mean);
    }
}

#[cfg(test)]
mod tests {
    use super::{Scratch, smooth};
    use crate::scene::Noise;
    use crate::simd::Level;

    fn smoothed(level: Level, width: usize, map: &[u16], rows: std::ops::Range<usize>) -> Vec<f64> {
        let mut to = vec![0; rows.len() * width];
        smooth(level, width, map, rows, &mut to, &mut Scratch::default());
        to.into_iter().map(f64::from).collect()
    }

    /// As the definition says, one pixel at a time.
    fn expected(width: usize, map: &[u16]) -> Vec<f64> {
        let height = map.len() / width;
        let inner =
            |at: usize| (1..width - 1).contains(&(at % width)) && (1..height - 1).contains(&(at / width));
        let around = |map: &[u16], at: usize| -> Vec<u16> {
            let rows = [at - width, at, at + width];
            rows.iter().flat_map(|at| map[at - 1..=at + 1].to_vec()).collect()
        };
        let mut medians = map.to_vec();
        let mut means = Vec::new();
        for at in (0..map.len()).filter(|at| inner(*at)) {
            let mut nine = around(map, at);
            nine.sort_unstable();
            medians[at] = nine[4];
        }
        for (at, centre) in medians.iter().enumerate() {
            let mut near = vec![f64::from(*centre)];
            if inner(at) {
                near = around(&medians, at).into_iter().map(f64::from).collect();
                near.retain(|value| (value - f64::from(*centre)).abs() <= 64.0);
            }
            let steps: f64 = near.iter().map(|value| value - f64::from(*centre)).sum();
            means.push(f64::from(*centre) + (steps / near.len() as f64).round_ties_even());
        }
        means
    }

    #[test]
    fn medians_then_means_of_one_surface_whatever_the_rows() {
        let (width, height) = (43, 11);
        let mut noise = Noise::new(5);
        let map: Vec<u16> = (0..width * height)
            .map(|at| u16::try_from(at % 17 * 20 + noise.below(200)).unwrap_or(0))
            .collect();
        let whole = expected(width, &map);
        for level in Level::available() {
            assert!(
                smoothed(level, width, &map, 0..height) == whole,
                "{}",
                level.name()
            );
            for (from, to) in [(0, 4), (4, 5), (5, 10), (10, 11)] {
                let part = smoothed(level, width, &map, from..to);
                assert!(part == whole[from * width..to * width], "{from}..{to}");
            }
        }
    }
}
