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
    /// The disparity of the left view's pixel (`x`, `y`) in px above the smallest, if it can be trusted.
    pub(crate) fn disparity_px(&self, views: &Views<'_>, x: usize, y: usize) -> Option<f32> {
        let mut costs: Costs = [0; MAX_DISPARITIES];
        let reachable = views
            .disparities
            .min((x + 1).checked_add_signed(views.columns_before)?);
        let costs = &mut costs[..reachable];
        sum_costs(
            views,
            (views.left, x),
            (views.right, views.right_index(x)),
            self.taps,
            y,
            costs,
        );
        let best = argmin(costs)?;
        let worst_possible =
            f32::from(u16::try_from(self.taps.len() * views.pattern.bits()).unwrap_or(u16::MAX));
        if f32::from(costs[best]) > self.max_cost * worst_possible {
            return None;
        }
        if f32::from(costs[best]) >= self.uniqueness * f32::from(best_elsewhere(costs, best)?) {
            return None;
        }
        if !self.is_found_from_the_right(views, x, y, best) {
            return None;
        }
        let whole = f32::from(u16::try_from(best).unwrap_or(u16::MAX));
        Some(if self.subpixel {
            (whole + equiangular(costs, best)).max(0.0)
        } else {
            whole
        })
    }

    /// Searches back from the right view's pixel `x - d`: the left view's candidates are `x - d + d'`.
    fn is_found_from_the_right(&self, views: &Views<'_>, x: usize, y: usize, disparity: usize) -> bool {
        // The matched right pixel may lie left of the window, where the left view has no candidates but further right.
        let (first, skipped) = match x.checked_sub(disparity) {
            Some(right_x) => (right_x, 0),
            None => (0, disparity - x),
        };
        let n = (views.disparities - skipped).min(views.width - first);
        let mut costs: Costs = [0; MAX_DISPARITIES];
        let costs = &mut costs[..n];
        // The roles change: one right word against consecutive left words, both in their own order of columns.
        let right_at = views.right_index(x) + disparity;
        sum_costs_back(views, right_at, views.left.index(first), self.taps, y, costs);
        argmin(costs).is_some_and(|back| (back + skipped).abs_diff(disparity) <= self.left_right_px)
    }
}

impl Views<'_> {
    /// Where the right view's column `x` (disparity 0) is in a mirrored row; disparity d is d further.
    pub(crate) fn right_index(&self, x: usize) -> usize {
        self.right.index(0).wrapping_sub(x)
    }
}

/// `costs[d]` = Hamming distance of the left words around column `x` to the right words `d` columns further left.
fn sum_costs(
    views: &Views<'_>,
    (left, x): (&Census, usize),
    (right, right_at): (&Census, usize),
    taps: Taps,
    y: usize,
    costs: &mut [u16],
) {
    let mut accumulator = ByteSums::new(views.pattern);
    for &(dx, dy) in taps {
        for (left, right) in left.planes().iter().zip(right.planes()) {
            let word = left.row(y, dy)[(left.margin_left() + x).wrapping_add_signed(isize::from(dx))];
            let from = right_at.wrapping_add_signed(-isize::from(dx));
            accumulator.add(word, &right.row(y, dy)[from..from + costs.len()]);
        }
        accumulator.end_tap(costs);
    }
    accumulator.flush(costs);
}

/// The same from the right: `costs[d]` for the left words at `left_at + d`.
fn sum_costs_back(
    views: &Views<'_>,
    right_at: usize,
    left_at: usize,
    taps: Taps,
    y: usize,
    costs: &mut [u16],
) {
    let mut accumulator = ByteSums::new(views.pattern);
    for &(dx, dy) in taps {
        for (left, right) in views.left.planes().iter().zip(views.right.planes()) {
            let word = right.row(y, dy)[right_at.wrapping_add_signed(-isize::from(dx))];
            let from = left_at.wrapping_add_signed(isize::from(dx));
            accumulator.add(word, &left.row(y, dy)[from..from + costs.len()]);
        }
        accumulator.end_tap(costs);
    }
    accumulator.flush(costs);
}

/// Sums Hamming distances in bytes as long as they can't overflow, then in 16 bits: bytes are twice as fast.
struct ByteSums {
    sums: [u8; MAX_DISPARITIES],
    taps: usize,
    taps_that_fit: usize,
}

impl ByteSums {
    fn new(pattern: Pattern) -> Self {
        Self {
            sums: [0; MAX_DISPARITIES],
            taps: 0,
            taps_that_fit: usize::from(u8::MAX) / pattern.bits(),
        }
    }

    fn add(&mut self, word: u8, others: &[u8]) {
        for (sum, other) in self.sums.iter_mut().zip(others) {
            // At most 8, so the sum stays in its byte until `end_tap` flushes.
            *sum += hamming(word, *other);
        }
    }

    fn end_tap(&mut self, costs: &mut [u16]) {
        self.taps += 1;
        if self.taps == self.taps_that_fit {
            self.flush(costs);
        }
    }

    fn flush(&mut self, costs: &mut [u16]) {
        for (cost, sum) in costs.iter_mut().zip(&mut self.sums) {
            *cost += u16::from(*sum);
            *sum = 0;
        }
        self.taps = 0;
    }
}

/// Number of differing bits of two census words, 0..=8.
#[inline]
fn hamming(a: u8, b: u8) -> u8 {
    // Written out: the baseline instruction set has no byte popcount and this form vectorises.
    let x = a ^ b;
    let x = x - ((x >> 1) & 0x55);
    let x = (x & 0x33) + ((x >> 2) & 0x33);
    (x + (x >> 4)) & 0x0F
}

/// The first of the least costs.
fn argmin(costs: &[u16]) -> Option<usize> {
    let least = costs.iter().copied().min()?;
    costs.iter().position(|&cost| cost == least)
}

/// The least cost further than 2 px from `best`; `None` if nothing is that far, so that uniqueness can't be told.
fn best_elsewhere(costs: &[u16], best: usize) -> Option<u16> {
    let before = &costs[..best.saturating_sub(2)];
    let after = costs.get(best + 3..).unwrap_or_default();
    before.iter().chain(after).copied().min()
}

/// Offset in -0.5..=0.5 of the minimum of two lines of equal slope through the best cost and its neighbours.
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
