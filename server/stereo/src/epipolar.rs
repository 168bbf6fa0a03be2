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

use std::ops::Range;

use crate::census::{Census, Pattern};
use crate::disparity::FIXED_PER_PX;
use crate::simd::{Kernel, Lanes, Level, MOST_BYTES};
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
    /// A map of disparities in 1/64 px near which the pixels' own are looked for; without it, the whole range is searched.
    pub(crate) near: Option<&'a [u16]>,
}

/// Disparities searched around that of a map.
const NEAR_PX: usize = 64;

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

    /// The disparity of the left view's pixel in px above the smallest, if it can be trusted.
    #[inline(always)]
    fn disparity_px<L: Lanes>(
        &self,
        lanes: L,
        views: &Views<'_>,
        taps: &TapsOf<'_>,
        at: Candidate,
    ) -> Option<f32> {
        let Candidate { x, y } = at;
        let Range { start: lowest, end } = views.searched(x, y)?;
        let mut costs = Costs::default();
        let n = end - lowest;
        let (left, right) = (
            taps.left.at(views.left.index(x), y),
            taps.right.at(views.right_index(x) + lowest, y),
        );
        sum_costs(lanes, left, right, n, &mut costs);
        let (least, best) = lanes.first_least(costs.searched(n));
        let worst_possible =
            f32::from(u16::try_from(self.taps.len() * views.pattern.bits()).unwrap_or(u16::MAX));
        if f32::from(least) > self.max_cost * worst_possible {
            return None;
        }
        let whole = f32::from(u16::try_from(lowest + best).unwrap_or(u16::MAX));
        let offset = if self.subpixel {
            equiangular(&costs.searched(n)[..n], best)
        } else {
            0.0
        };
        costs.forget_around(best);
        let (elsewhere, _) = lanes.first_least(costs.searched(n));
        // If nothing is that far, uniqueness can't be told.
        if elsewhere == u16::MAX || f32::from(least) >= self.uniqueness * f32::from(elsewhere) {
            return None;
        }
        let disparity = lowest + best;
        // Back from the right view's pixel `x - d`: the left view's candidates are `x - d + d'`. It may lie left of the
        // window, where the left view has no candidates but further right.
        let skipped = lowest.max(disparity.saturating_sub(x));
        let first = x + skipped - disparity;
        let n = (views.end(lowest) - skipped).min(views.width - first);
        let (right, left) = (
            taps.right.at(views.right_index(x) + disparity, y),
            taps.left.at(views.left.index(first), y),
        );
        sum_costs(lanes, right, left, n, &mut costs);
        let (_, back) = lanes.first_least(costs.searched(n));
        ((back + skipped).abs_diff(disparity) <= self.left_right_px).then_some((whole + offset).max(0.0))
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
    fn run<L: Lanes>(self, lanes: L) {
        let Self {
            search,
            views,
            candidates,
            found,
        } = self;
        let taps = TapsOf {
            left: TapsOfView::new(views.left, search.taps, 1),
            right: TapsOfView::new(views.right, search.taps, -1),
        };
        for &candidate in candidates {
            if let Some(disparity_px) = search.disparity_px(lanes, views, &taps, candidate) {
                let Candidate { x, y } = candidate;
                found.push(Support { x, y, disparity_px });
            }
        }
    }
}

impl Views<'_> {
    /// Where the right view's column `x` (disparity 0) is in a mirrored row; disparity d is d further.
    pub(crate) fn right_index(&self, x: usize) -> usize {
        self.right.index(0).wrapping_sub(x)
    }

    /// End of the disparities searched from `lowest` on.
    #[inline(always)]
    fn end(&self, lowest: usize) -> usize {
        if self.near.is_some() {
            (lowest + NEAR_PX).min(self.disparities)
        } else {
            self.disparities
        }
    }

    /// Disparities searched for the pixel (`x`, `y`), all of them inside the right view; `None` without any.
    #[inline(always)]
    fn searched(&self, x: usize, y: usize) -> Option<Range<usize>> {
        let end = self
            .disparities
            .min((x + 1).checked_add_signed(self.columns_before)?);
        let range = match self.near {
            None => 0..end,
            Some(map) => {
                let centre = usize::from(map[y * self.width + x] / FIXED_PER_PX);
                let start = (centre + NEAR_PX / 2).min(end).saturating_sub(NEAR_PX);
                start..end.min(start + NEAR_PX)
            }
        };
        (!range.is_empty()).then_some(range)
    }
}

/// Costs in order of disparity.
#[repr(align(64))]
struct Costs([u16; Self::MARGIN + MAX_DISPARITIES + Self::MARGIN]);

impl Default for Costs {
    fn default() -> Self {
        Self([u16::MAX; _])
    }
}

impl Costs {
    /// Room for what is forgotten around the first and the last.
    const MARGIN: usize = 32;
    /// Disparities that are as good as the same, in px on both sides.
    const SAME_PX: usize = 2;

    /// The blocks that hold `n` costs; the rest of the last one is as large as can be.
    #[inline(always)]
    fn searched(&self, n: usize) -> &[u16] {
        &self.0[Self::MARGIN..][..n.next_multiple_of(BLOCK)]
    }

    /// As if `best` and what is as good as the same had not been searched.
    #[inline(always)]
    fn forget_around(&mut self, best: usize) {
        let first = Self::MARGIN + best - Self::SAME_PX;
        self.0[first..first + 2 * Self::SAME_PX + 1].fill(u16::MAX);
    }
}

/// Costs are compared in blocks of this length, the longest vector.
const BLOCK: usize = MOST_BYTES;
/// Taps and planes of any preset.
const MOST_TAPS: usize = 25;
const MOST_PLANES: usize = 3;

struct TapsOf<'a> {
    left: TapsOfView<'a>,
    right: TapsOfView<'a>,
}

/// Where the words of all taps are in one view, whatever the pixel.
struct TapsOfView<'a> {
    planes: [&'a [u8]; MOST_PLANES],
    census: &'a Census,
    offsets: [isize; MOST_TAPS],
    taps: usize,
}

impl<'a> TapsOfView<'a> {
    /// `step` is 1, or -1 where the rows are mirrored.
    fn new(census: &'a Census, taps: Taps, step: isize) -> Self {
        let mut view = Self {
            planes: [&[]; MOST_PLANES],
            census,
            offsets: [0; MOST_TAPS],
            taps: taps.len(),
        };
        for (data, plane) in view.planes.iter_mut().zip(census.planes()) {
            *data = plane.bytes();
        }
        for (offset, &(dx, dy)) in view.offsets.iter_mut().zip(taps) {
            *offset = isize::from(dy) * census.planes()[0].stride().cast_signed() + step * isize::from(dx);
        }
        view
    }

    /// The words around `index` of row `y`.
    #[inline(always)]
    fn at(&self, index: usize, y: usize) -> Around<'_> {
        Around {
            planes: &self.planes[..self.census.planes().len()],
            offsets: &self.offsets[..self.taps],
            at: self.census.planes()[0].position(index, y),
        }
    }
}

/// A view's words around a pixel.
#[derive(Clone, Copy)]
struct Around<'a> {
    planes: &'a [&'a [u8]],
    offsets: &'a [isize],
    at: usize,
}

/// The cost of disparity `d < n`: Hamming distance of the words around `one` to the words around `many`, `d` further in
/// its rows; the rest of the last block is as large as can be.
#[inline(always)]
fn sum_costs<L: Lanes>(lanes: L, one: Around<'_>, many: Around<'_>, n: usize, costs: &mut Costs) {
    let mut done = 0;
    while done < n {
        // Two vectors at a time share the words of the one.
        if done + L::BYTES < n {
            sum_vectors::<L, 2>(lanes, one, many, done, costs);
            done += 2 * L::BYTES;
        } else {
            sum_vectors::<L, 1>(lanes, one, many, done, costs);
            done += L::BYTES;
        }
    }
    costs.0[Costs::MARGIN + n..Costs::MARGIN + n.next_multiple_of(BLOCK)].fill(u16::MAX);
}

/// `N` vectors of costs from disparity `first` on. Their sums stay in registers over all taps.
#[inline(always)]
fn sum_vectors<L: Lanes, const N: usize>(
    lanes: L,
    one: Around<'_>,
    many: Around<'_>,
    first: usize,
    costs: &mut Costs,
) {
    // Bytes are twice as fast as 16 bits, as long as a sum fits one.
    let taps_that_fit = usize::from(u8::MAX) / (8 * one.planes.len());
    let costs = &mut costs.0[Costs::MARGIN + first..][..N * L::BYTES];
    let taps = one.offsets.len();
    for from in (0..taps).step_by(taps_that_fit) {
        let mut sums = [lanes.splat(0); N];
        for tap in from..(from + taps_that_fit).min(taps) {
            let at = one.at.wrapping_add_signed(one.offsets[tap]);
            // Rows have margins of a block more than any disparity reaches.
            let start = many.at.wrapping_add_signed(many.offsets[tap]) + first;
            for (one, many) in one.planes.iter().zip(many.planes) {
                let word = lanes.splat(one[at]);
                let words = &many[start..start + N * L::BYTES];
                for (k, sum) in sums.iter_mut().enumerate() {
                    let differing = lanes.xor(word, lanes.load(&words[k * L::BYTES..]));
                    *sum = lanes.add(*sum, lanes.count_ones(differing));
                }
            }
        }
        for (k, sum) in sums.into_iter().enumerate() {
            let mut bytes = [0; MOST_BYTES];
            lanes.store(sum, &mut bytes);
            let costs = &mut costs[k * L::BYTES..][..L::BYTES];
            for (cost, sum) in costs.iter_mut().zip(&bytes) {
                let before = if from == 0 { 0 } else { *cost };
                *cost = before + u16::from(*sum);
            }
        }
    }
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
