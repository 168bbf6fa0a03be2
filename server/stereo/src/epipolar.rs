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

use std::marker::PhantomData;
use std::ops::Range;

use crate::census::{Census, Pattern};
use crate::disparity::FIXED_PER_PX;
use crate::simd::{Kernel, Lanes, Level, MOST_BYTES};
use crate::support::{Candidate, Support};

/// Disparities of one search at most.
pub(crate) const MAX_DISPARITIES: usize = 256;

/// Taps of one row.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TapRow {
    dy: i8,
    /// Columns, at most [`TAP_REACH_PX`] away.
    dx: &'static [i8],
}

/// Furthest column of a tap.
const TAP_REACH_PX: usize = 4;

/// Offsets whose census words are summed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Taps {
    /// A 3x3 grid 4 px apart with the four points between: 13 words for the reach of 81.
    Quincunx,
    /// Every pixel of a 5x5 window.
    Window5x5,
}

/// Taps that are known when the search is compiled.
trait Known {
    const ROWS: &'static [TapRow];
    /// How many they are.
    const COUNT: usize = {
        let (mut count, mut row) = (0, 0);
        while row < Self::ROWS.len() {
            count += Self::ROWS[row].dx.len();
            row += 1;
        }
        count
    };
}

struct Quincunx;

impl Known for Quincunx {
    const ROWS: &'static [TapRow] = &[
        TapRow {
            dy: -4,
            dx: &[-4, 0, 4],
        },
        TapRow { dy: -2, dx: &[-2, 2] },
        TapRow {
            dy: 0,
            dx: &[-4, 0, 4],
        },
        TapRow { dy: 2, dx: &[-2, 2] },
        TapRow {
            dy: 4,
            dx: &[-4, 0, 4],
        },
    ];
}

struct Window5x5;

impl Known for Window5x5 {
    const ROWS: &'static [TapRow] = &[
        TapRow {
            dy: -2,
            dx: &[-2, -1, 0, 1, 2],
        },
        TapRow {
            dy: -1,
            dx: &[-2, -1, 0, 1, 2],
        },
        TapRow {
            dy: 0,
            dx: &[-2, -1, 0, 1, 2],
        },
        TapRow {
            dy: 1,
            dx: &[-2, -1, 0, 1, 2],
        },
        TapRow {
            dy: 2,
            dx: &[-2, -1, 0, 1, 2],
        },
    ];
}

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
        match self.taps {
            Taps::Quincunx => self.search_with::<Quincunx>(level, views, candidates, found),
            Taps::Window5x5 => self.search_with::<Window5x5>(level, views, candidates, found),
        }
    }

    fn search_with<T: Known>(
        &self,
        level: Level,
        views: &Views<'_>,
        candidates: &[Candidate],
        found: &mut Vec<Support>,
    ) {
        let bits = u16::try_from(T::COUNT * views.pattern.bits()).unwrap_or(u16::MAX);
        level.run(SearchAll {
            search: self,
            views,
            words: [Words::of(views.left), Words::of(views.right)],
            max_cost: self.max_cost * f32::from(bits),
            candidates,
            found,
            taps: PhantomData::<T>,
        });
    }
}

/// A candidate's best match.
#[derive(Debug, Clone, Copy, Default)]
struct Match {
    at: Candidate,
    /// Disparities that were searched.
    lowest: usize,
    end: usize,
    /// The best one, and its cost between those of its neighbours.
    disparity: usize,
    costs: [u16; 3],
}

impl Match {
    /// Offset in -0.5..=0.5 of the minimum of two lines of equal slope through the best cost and its neighbours.
    fn offset_px(&self) -> f32 {
        if self.disparity == self.lowest || self.disparity + 1 >= self.end {
            return 0.0;
        }
        let [before, here, after] = self.costs.map(f32::from);
        let steepest = before.max(after) - here;
        if steepest <= 0.0 {
            0.0
        } else {
            (before - after) / (2.0 * steepest)
        }
    }
}

/// Candidates searched before any is searched back.
const BATCH: usize = 64;

struct SearchAll<'a, T> {
    search: &'a Search,
    views: &'a Views<'a>,
    /// The left and the right view's.
    words: [Words<'a>; 2],
    max_cost: f32,
    candidates: &'a [Candidate],
    found: &'a mut Vec<Support>,
    taps: PhantomData<T>,
}

impl<T: Known> Kernel for SearchAll<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(mut self, lanes: L) {
        let mut costs = Costs::default();
        for batch in self.candidates.chunks(BATCH) {
            // No search waits for what the one before decides: a wrong guess costs as much as a search.
            let mut matches = [Match::default(); BATCH];
            let mut matched = 0;
            for &candidate in batch {
                let is_match = self.look(lanes, candidate, &mut costs, &mut matches[matched]);
                matched += usize::from(is_match);
            }
            for found in &matches[..matched] {
                self.look_back(lanes, found, &mut costs);
            }
        }
    }
}

impl<T: Known> SearchAll<'_, T> {
    /// Whether a candidate has a match that looks like it, and nothing else does.
    #[inline(always)]
    fn look<L: Lanes>(&self, lanes: L, at: Candidate, costs: &mut Costs, found: &mut Match) -> bool {
        let Candidate { x, y } = at;
        let Some(Range { start: lowest, end }) = self.views.searched(x, y) else {
            return false;
        };
        let n = end - lowest;
        let [left, right] = &self.words;
        let (one, many) = (left.position(x, y), right.position(0, y).wrapping_sub(x) + lowest);
        sum_costs::<L, T, false>(lanes, (left, one), (right, many), n, costs);
        let (least, best, elsewhere) = lanes.first_least_and_else(costs.searched(n), Costs::SAME_PX);
        *found = Match {
            at,
            lowest,
            end,
            disparity: lowest + best,
            costs: costs.around(best),
        };
        let (cost, other) = (f32::from(least), f32::from(elsewhere));
        // If nothing is that far, uniqueness can't be told.
        (cost <= self.max_cost) & (elsewhere < u16::MAX) & (cost < self.search.uniqueness * other)
    }

    /// Keeps a match if the right view's pixel has the left one's for its own.
    #[inline(always)]
    fn look_back<L: Lanes>(&mut self, lanes: L, found: &Match, costs: &mut Costs) {
        let (Candidate { x, y }, disparity) = (found.at, found.disparity);
        // From the right view's pixel `x - d` the left view's candidates are `x - d + d'`. It may lie left of the window, where
        // the left view has no candidates but further right.
        let skipped = found.lowest.max(disparity.saturating_sub(x));
        let first = x + skipped - disparity;
        let n = (self.views.end(found.lowest) - skipped).min(self.views.width - first);
        let [left, right] = &self.words;
        let (one, many) = (
            right.position(0, y).wrapping_sub(x) + disparity,
            left.position(first, y),
        );
        sum_costs::<L, T, true>(lanes, (right, one), (left, many), n, costs);
        let (_, back) = lanes.first_least(costs.searched(n));
        if (back + skipped).abs_diff(disparity) <= self.search.left_right_px {
            let whole = f32::from(u16::try_from(disparity).unwrap_or(u16::MAX));
            let offset = if self.search.subpixel {
                found.offset_px()
            } else {
                0.0
            };
            self.found.push(Support {
                x,
                y,
                disparity_px: (whole + offset).max(0.0),
            });
        }
    }
}

impl Views<'_> {
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

    /// The cost `best`, between its neighbours'.
    #[inline(always)]
    fn around(&self, best: usize) -> [u16; 3] {
        let at = Self::MARGIN + best;
        [self.0[at - 1], self.0[at], self.0[at + 1]]
    }
}

/// Costs are compared in blocks of this length, the longest vector.
const BLOCK: usize = MOST_BYTES;
/// Planes of any pattern.
const MOST_PLANES: usize = 3;

/// A view's words.
struct Words<'a> {
    planes: [&'a [u8]; MOST_PLANES],
    census: &'a Census,
}

impl<'a> Words<'a> {
    fn of(census: &'a Census) -> Self {
        let mut planes: [&[u8]; MOST_PLANES] = [&[]; _];
        for (data, plane) in planes.iter_mut().zip(census.planes()) {
            *data = plane.bytes();
        }
        Self { planes, census }
    }

    /// Where the word of a pixel is in its plane.
    #[inline(always)]
    fn position(&self, x: usize, y: usize) -> usize {
        self.census.planes()[0].position(self.census.index(x), y)
    }
}

/// The cost of disparity `d < n`: Hamming distance of the words around `one` to the words around `many`, `d` further in
/// its rows; the rest of the last block is as large as can be. The right view's rows are mirrored: it is `one` in a search `BACK`.
#[inline(always)]
fn sum_costs<L: Lanes, T: Known, const BACK: bool>(
    lanes: L,
    one: (&Words<'_>, usize),
    (many, at): (&Words<'_>, usize),
    n: usize,
    costs: &mut Costs,
) {
    let mut done = 0;
    while done < n {
        let many = (many, at + done);
        // Two vectors at a time share the words of the one.
        if done + L::BYTES < n {
            sum_vectors::<L, T, BACK, 2>(lanes, one, many, &mut costs.0[Costs::MARGIN + done..]);
            done += 2 * L::BYTES;
        } else {
            sum_vectors::<L, T, BACK, 1>(lanes, one, many, &mut costs.0[Costs::MARGIN + done..]);
            done += L::BYTES;
        }
    }
    costs.0[Costs::MARGIN + n..Costs::MARGIN + n.next_multiple_of(BLOCK)].fill(u16::MAX);
}

/// `N` vectors of costs. Their sums stay in registers over all taps.
#[inline(always)]
fn sum_vectors<L: Lanes, T: Known, const BACK: bool, const N: usize>(
    lanes: L,
    (one, one_at): (&Words<'_>, usize),
    (many, many_at): (&Words<'_>, usize),
    costs: &mut [u16],
) {
    let planes = one.census.planes();
    let stride = planes[0].stride().cast_signed();
    let many_stride = many.census.planes()[0].stride().cast_signed();
    // Bytes are twice as fast as 16 bits, as long as a sum fits one; all taps of a plane do.
    let planes_that_fit = usize::from(u8::MAX) / (8 * T::COUNT);
    let mut sums = [lanes.splat(0); N];
    for p in 0..planes.len() {
        if p > 0 && p % planes_that_fit == 0 {
            add_to_costs(lanes, &sums, costs, p == planes_that_fit);
            sums = [lanes.splat(0); N];
        }
        for row in T::ROWS {
            // Rows have margins of a block more than any disparity reaches.
            let dy = isize::from(row.dy);
            let ones = one_at.wrapping_add_signed(dy * stride) - TAP_REACH_PX;
            let ones = &one.planes[p][ones..][..2 * TAP_REACH_PX + 1];
            let words = many_at.wrapping_add_signed(dy * many_stride) - TAP_REACH_PX;
            let words = &many.planes[p][words..][..2 * TAP_REACH_PX + N * L::BYTES];
            for &dx in row.dx {
                // Their order in the left and in the right view's rows.
                let (along, against) = (
                    TAP_REACH_PX.wrapping_add_signed(dx.into()),
                    TAP_REACH_PX.wrapping_add_signed(-isize::from(dx)),
                );
                let (one_at, many_at) = if BACK { (against, along) } else { (along, against) };
                let word = lanes.splat(ones[one_at]);
                for (k, sum) in sums.iter_mut().enumerate() {
                    let differing = lanes.xor(word, lanes.load(&words[many_at + k * L::BYTES..]));
                    *sum = lanes.add(*sum, lanes.count_ones(differing));
                }
            }
        }
    }
    add_to_costs(lanes, &sums, costs, planes.len() <= planes_that_fit);
}

/// Adds sums in bytes to `costs`, or replaces them.
#[inline(always)]
fn add_to_costs<L: Lanes, const N: usize>(lanes: L, sums: &[L::V; N], costs: &mut [u16], replaces: bool) {
    for (sum, costs) in sums.iter().zip(costs.chunks_exact_mut(L::BYTES)) {
        if replaces {
            lanes.widen(*sum, costs);
            continue;
        }
        let mut words = [0; MOST_BYTES];
        lanes.widen(*sum, &mut words);
        for (cost, word) in costs.iter_mut().zip(words) {
            *cost += word;
        }
    }
}

#[cfg(test)]
mod tests;
