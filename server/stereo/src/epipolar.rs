//! Epipolar search: the disparity of single pixels over the whole range (the paper's SparseStereo and
//! SparseEpipolarStereo, after Schauwecker, Klette and Zell 2012).
//!
//! ```text
//! for every candidate (x, y) of the left view:
//!     C(d)  = sum over taps t of hamming(left(x + t), right(x + t - d)),   d in the range and inside the view
//!     d*    = argmin C
//!     drop it unless C(d*) <= max_cost                          (it looks like its match)
//!              and   C(d*) <  uniqueness * C(best outside d* +- 2)  (and like nothing else)
//!              and   searching back from the right view finds it (left-right check)
//!     add the sub-pixel minimum of the two lines through C(d* - 1), C(d*), C(d* + 1)
//! ```
//! A single census word is far too weak to be searched with (a third of such matches are wrong); the taps spread over a
//! small window make it strong.

use crate::census::{Census, Pattern};
use crate::simd::{Kernel, Lanes, Level};
use crate::support::{Candidate, Support};

/// Disparities of one search at most.
pub(crate) const MAX_DISPARITIES: usize = 256;

/// Offsets (dx, dy) whose census words are summed.
pub(crate) type Taps = &'static [(i8, i8)];

/// A 3x3 grid 4 px apart with the four points between: 13 words for the reach of 81.
pub(crate) const QUINCUNX: Taps = &[
    (-4, -4),
    (0, -4),
    (4, -4),
    (-2, -2),
    (2, -2),
    (-4, 0),
    (0, 0),
    (4, 0),
    (-2, 2),
    (2, 2),
    (-4, 4),
    (0, 4),
    (4, 4),
];

/// Every pixel of a 5x5 window.
pub(crate) const WINDOW_5X5: Taps = &[
    (-2, -2),
    (-1, -2),
    (0, -2),
    (1, -2),
    (2, -2),
    (-2, -1),
    (-1, -1),
    (0, -1),
    (1, -1),
    (2, -1),
    (-2, 0),
    (-1, 0),
    (0, 0),
    (1, 0),
    (2, 0),
    (-2, 1),
    (-1, 1),
    (0, 1),
    (1, 1),
    (2, 1),
    (-2, 2),
    (-1, 2),
    (0, 2),
    (1, 2),
    (2, 2),
];

/// What makes a match good enough to be a support point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Search {
    /// Where census words are compared.
    pub(crate) taps: Taps,
    /// Largest share of differing bits, 0..=1.
    pub(crate) max_cost: f32,
    /// Largest ratio of the best cost to the best one further than 2 px away, 0..=1.
    pub(crate) uniqueness: f32,
    /// Largest difference in px between the match and the match back.
    pub(crate) left_right_px: usize,
    /// Whether the disparity is refined below a pixel; the paper's supports are whole (section III-A).
    pub(crate) subpixel: bool,
}

/// The two views' codes and the range searched in them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Views<'a> {
    pub(crate) pattern: Pattern,
    pub(crate) left: &'a Census,
    pub(crate) right: &'a Census,
    /// Width of the left window in px.
    pub(crate) width: usize,
    /// Disparities searched, counted from the smallest.
    pub(crate) disparities: usize,
    /// Columns of the right view left of the window's first candidate: at column x there are `columns_before + x + 1`
    /// candidates. Negative where the smallest disparity already leaves the view.
    pub(crate) columns_before: isize,
}

type Costs = [u16; MAX_DISPARITIES];

impl Search {
    /// Searches for all `candidates`, and adds those that can be trusted to `found`.
    pub(crate) fn search(
        &self,
        level: Level,
        views: &Views<'_>,
        candidates: &[Candidate],
        found: &mut Vec<Support>,
    ) {
        level.run(SearchAll {
            search: self,
            views,
            candidates,
            found,
        });
    }

    /// The disparity of the left view's pixel (`x`, `y`) in px above the smallest, if it can be trusted.
    #[inline(always)]
    fn disparity_px(&self, views: &Views<'_>, x: usize, y: usize) -> Option<f32> {
        let reachable = views
            .disparities
            .min((x + 1).checked_add_signed(views.columns_before)?);
        let left = Around {
            census: views.left,
            at: views.left.index(x),
            step: 1,
        };
        let right = Around {
            census: views.right,
            at: views.right_index(x),
            step: -1,
        };
        let mut costs: Costs = [0; MAX_DISPARITIES];
        sum_costs(left, right, self.taps, y, reachable, &mut costs);
        let best = argmin(&costs)?;
        let worst_possible =
            f32::from(u16::try_from(self.taps.len() * views.pattern.bits()).unwrap_or(u16::MAX));
        if f32::from(costs[best]) > self.max_cost * worst_possible {
            return None;
        }
        if f32::from(costs[best]) >= self.uniqueness * f32::from(best_elsewhere(&costs, best)?) {
            return None;
        }
        if !self.is_found_from_the_right(views, x, y, best) {
            return None;
        }
        let whole = f32::from(u16::try_from(best).unwrap_or(u16::MAX));
        let offset = if self.subpixel {
            equiangular(&costs[..reachable], best)
        } else {
            0.0
        };
        Some((whole + offset).max(0.0))
    }

    /// Searches back from the right view's pixel `x - d`: the left view's candidates are `x - d + d'`.
    #[inline(always)]
    fn is_found_from_the_right(&self, views: &Views<'_>, x: usize, y: usize, disparity: usize) -> bool {
        // The matched right pixel may lie left of the window, where the left view has no candidates but further right.
        let (first, skipped) = match x.checked_sub(disparity) {
            Some(right_x) => (right_x, 0),
            None => (0, disparity - x),
        };
        let n = (views.disparities - skipped).min(views.width - first);
        let right = Around {
            census: views.right,
            at: views.right_index(x) + disparity,
            step: -1,
        };
        let left = Around {
            census: views.left,
            at: views.left.index(first),
            step: 1,
        };
        let mut costs: Costs = [0; MAX_DISPARITIES];
        sum_costs(right, left, self.taps, y, n, &mut costs);
        argmin(&costs).is_some_and(|back| (back + skipped).abs_diff(disparity) <= self.left_right_px)
    }
}

struct SearchAll<'a> {
    search: &'a Search,
    views: &'a Views<'a>,
    candidates: &'a [Candidate],
    found: &'a mut Vec<Support>,
}

impl Kernel for SearchAll<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        for &Candidate { x, y } in self.candidates {
            if let Some(disparity_px) = self.search.disparity_px(self.views, x, y) {
                self.found.push(Support { x, y, disparity_px });
            }
        }
    }
}

impl Views<'_> {
    /// Where the right view's column `x` (disparity 0) is in a mirrored row; disparity d is d further.
    pub(crate) fn right_index(&self, x: usize) -> usize {
        self.right.index(0).wrapping_sub(x)
    }
}

/// Disparities summed at a time: their sums stay in registers over all taps.
const BLOCK: usize = 64;

/// A view's words around a pixel, `at` within its rows; `step` is 1, or -1 where the rows are mirrored.
#[derive(Clone, Copy)]
struct Around<'a> {
    census: &'a Census,
    at: usize,
    step: isize,
}

impl<'a> Around<'a> {
    /// Plane `plane`'s row `y + dy` and where column `dx` further right is in it.
    #[inline(always)]
    fn row(&self, plane: usize, y: usize, (dx, dy): (i8, i8)) -> (&'a [u8], usize) {
        let row = self.census.planes()[plane].row(y, dy);
        (row, self.at.wrapping_add_signed(self.step * isize::from(dx)))
    }
}

/// `costs[d]` for `d < n`: Hamming distance of the words around `one` to the words around `many`, `d` further in its rows;
/// the rest of `costs` is as large as can be.
#[inline(always)]
fn sum_costs(one: Around<'_>, many: Around<'_>, taps: Taps, y: usize, n: usize, costs: &mut Costs) {
    match n.div_ceil(BLOCK) {
        0 => {}
        1 => sum_blocks::<1>(one, many, taps, y, costs),
        2 => sum_blocks::<2>(one, many, taps, y, costs),
        3 => sum_blocks::<3>(one, many, taps, y, costs),
        _ => sum_blocks::<4>(one, many, taps, y, costs),
    }
    costs[n..].fill(u16::MAX);
}

/// The first `BLOCKS` blocks of costs.
#[inline(always)]
fn sum_blocks<const BLOCKS: usize>(
    one: Around<'_>,
    many: Around<'_>,
    taps: Taps,
    y: usize,
    costs: &mut Costs,
) {
    let planes = one.census.planes().len();
    // Bytes are twice as fast as 16 bits, as long as a sum fits one.
    let taps_that_fit = usize::from(u8::MAX) / (8 * planes);
    let (costs, _) = costs.as_chunks_mut::<BLOCK>();
    for block in &mut costs[..BLOCKS] {
        *block = [0; BLOCK];
    }
    for taps in taps.chunks(taps_that_fit) {
        let mut sums = [[0u8; BLOCK]; BLOCKS];
        for &tap in taps {
            for plane in 0..planes {
                let (row, at) = one.row(plane, y, tap);
                let word = row[at];
                // Rows have margins of a block more than any disparity reaches.
                let (row, at) = many.row(plane, y, tap);
                let (words, _) = row[at..at + BLOCKS * BLOCK].as_chunks::<BLOCK>();
                for (sums, words) in sums.iter_mut().zip(words) {
                    for k in 0..BLOCK {
                        #[expect(clippy::cast_possible_truncation, reason = "at most 8")]
                        let distance = (word ^ words[k]).count_ones() as u8;
                        sums[k] += distance;
                    }
                }
            }
        }
        for (costs, sums) in costs.iter_mut().zip(&sums) {
            for k in 0..BLOCK {
                costs[k] += u16::from(sums[k]);
            }
        }
    }
}

/// The first of the least costs; `None` if there is none.
#[inline(always)]
fn argmin(costs: &Costs) -> Option<usize> {
    let mut least = u32::MAX;
    for (d, cost) in (0u32..).zip(costs) {
        least = least.min(u32::from(*cost) << 16 | d);
    }
    (least >> 16 < u32::from(u16::MAX)).then_some((least & 0xFFFF) as usize)
}

/// The least cost further than 2 px from `best`; `None` if nothing is that far, so that uniqueness can't be told.
#[inline(always)]
fn best_elsewhere(costs: &Costs, best: usize) -> Option<u16> {
    let mut elsewhere = *costs;
    elsewhere[best.saturating_sub(2)..(best + 3).min(MAX_DISPARITIES)].fill(u16::MAX);
    let mut least = u16::MAX;
    for cost in elsewhere {
        least = least.min(cost);
    }
    (least < u16::MAX).then_some(least)
}

/// Offset in -0.5..=0.5 of the minimum of two lines of equal slope through the best cost and its neighbours.
#[inline(always)]
fn equiangular(costs: &[u16], best: usize) -> f32 {
    if best == 0 || best + 1 >= costs.len() {
        return 0.0;
    }
    let [before, here, after] = [best - 1, best, best + 1].map(|d| f32::from(costs[d]));
    let steepest = before.max(after) - here;
    if steepest <= 0.0 {
        0.0
    } else {
        (before - after) / (2.0 * steepest)
    }
}

#[cfg(test)]
mod tests;
