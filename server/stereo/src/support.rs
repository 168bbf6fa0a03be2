//! Support points: which pixels are searched for, and which matches are kept.

use crate::gradient::Gradient;
use crate::simd::{Kernel, Lanes, Level, MOST_BYTES};

/// A pixel of the left view to be searched for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Candidate {
    pub(crate) x: usize,
    pub(crate) y: usize,
}

/// A matched pixel: a vertex of the mesh (the paper's s_n = (u, v, d)).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Support {
    /// Column in px.
    pub(crate) x: usize,
    /// Row in px.
    pub(crate) y: usize,
    /// Disparity above the smallest, in px.
    pub(crate) disparity_px: f32,
}

/// Least |gx| / 4 of a candidate.
const MIN_STRENGTH: u8 = 4;
/// Candidates keep this distance from the border, so that every tap sees real pixels.
pub(crate) const BORDER_PX: usize = 4;

/// Pixels that the mesh does not explain: those with a cost above a limit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Unexplained<'a> {
    /// Cost of every pixel of the window.
    pub(crate) cost: &'a [u8],
    /// Largest cost of an explained pixel.
    pub(crate) explained_up_to: u8,
    /// So many of them make a cell worth a search; at most 255.
    pub(crate) enough: usize,
}

/// In every cell of `cell_px` x `cell_px` (a power of two) of a window of `width` x `height`, the pixel with the strongest horizontal
/// gradient, in snake order of the cells: neighbours in the list are neighbours in the image, which is what incremental
/// triangulation likes.
///
/// With `unexplained`, only those pixels count, and only cells with enough of them. This is the paper's C_b with another
/// choice within the cell: the pixel that can be matched best, not the one that matches worst.
pub(crate) fn strongest_per_cell(
    level: Level,
    gradient: &Gradient,
    size: (usize, usize),
    cell_px: usize,
    unexplained: Option<Unexplained<'_>>,
    (scratch, found): (&mut Scratch, &mut Vec<Candidate>),
) {
    level.run(Strongest {
        gradient,
        size,
        cell_px,
        unexplained,
        scratch,
        found,
    });
}

/// Scratch of a choice: for every column of a row of cells, strength of the best pixel with, below it, how early its row comes;
/// and how many pixels are eligible.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    best: Vec<u16>,
    eligible: Vec<u8>,
    /// How many are eligible in as many columns as two cells have, at most, from each column on.
    counts: Vec<u8>,
    /// Costs of a row where everything counts as unexplained.
    everything: Vec<u8>,
}

struct Strongest<'a> {
    gradient: &'a Gradient,
    size: (usize, usize),
    cell_px: usize,
    unexplained: Option<Unexplained<'a>>,
    scratch: &'a mut Scratch,
    found: &'a mut Vec<Candidate>,
}

impl Kernel for Strongest<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self {
            gradient,
            size: (width, height),
            cell_px,
            unexplained,
            scratch,
            found,
        } = self;
        found.clear();
        let enough = unexplained.map_or(1, |pixels| pixels.enough);
        // Whole rows at a time, so that there is nothing to decide pixel by pixel.
        let Scratch {
            best,
            eligible,
            counts,
            everything,
        } = scratch;
        let padded = (width + cell_px).next_multiple_of(MOST_BYTES);
        best.resize(width, 0);
        for row in [&mut *eligible, &mut *counts] {
            row.clear();
            row.resize(padded, 0);
        }
        everything.resize(width, u8::MAX);
        for (row_of_cells, top) in (0..height).step_by(cell_px).enumerate() {
            best.fill(0);
            eligible.fill(0);
            for y in top.max(BORDER_PX)..(top + cell_px).min(height - BORDER_PX) {
                let row = y * width..(y + 1) * width;
                let strengths = &gradient.strength[row.clone()];
                let (costs, explained_up_to) = match &unexplained {
                    Some(pixels) => (&pixels.cost[row], pixels.explained_up_to),
                    None => (&everything[..], 0),
                };
                let earliness = u16::try_from(top + cell_px - 1 - y).unwrap_or(0);
                let columns = best
                    .iter_mut()
                    .zip(&mut eligible[..width])
                    .zip(strengths.iter().zip(costs));
                for ((best, eligible), (strength, cost)) in columns {
                    let counts = u8::from(*strength >= MIN_STRENGTH) & u8::from(*cost > explained_up_to);
                    let key = (u16::from(*strength) << 8 | earliness) & u16::from(counts).wrapping_neg();
                    *best = (*best).max(key);
                    *eligible += counts;
                }
            }
            for border in [0..BORDER_PX, width - BORDER_PX..width] {
                eligible[border.clone()].fill(0);
                best[border].fill(0);
            }
            // Of one column, then of two, then of four, so that it takes as few steps as a cell's side has bits.
            let mut step = 1;
            while step < cell_px {
                let n = padded - step;
                let sums = eligible[..n].iter().zip(&eligible[step..]);
                for (count, (here, there)) in counts[..n].iter_mut().zip(sums) {
                    *count = here.saturating_add(*there);
                }
                std::mem::swap(eligible, counts);
                step *= 2;
            }
            let start = found.len();
            for (column, best) in best.chunks(cell_px).enumerate() {
                if usize::from(eligible[column * cell_px]) < enough {
                    continue;
                }
                // Of equals the first column, `max_by_key` being for the last.
                if let Some((x, key)) = best.iter().enumerate().rev().max_by_key(|&(_, key)| key) {
                    let y = top + cell_px - 1 - usize::from(key & 0xFF);
                    let x = column * cell_px + x;
                    found.push(Candidate { x, y });
                }
            }
            if row_of_cells % 2 == 1 {
                found[start..].reverse();
            }
        }
    }
}

/// When a support is believed: enough others nearby have about its disparity (after ELAS).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Consistency {
    /// Others within this many px in both directions count as near.
    pub(crate) radius_px: usize,
    /// Largest difference in disparity, px.
    pub(crate) tolerance_px: f32,
    /// How many are needed.
    pub(crate) supporters: usize,
}

impl Consistency {
    /// Removes from `fresh` what has too few supporters among `fresh` and `known`.
    pub(crate) fn retain(&self, fresh: &mut Vec<Support>, known: &[Support], buckets: &mut Buckets) {
        buckets.fill(fresh.iter().chain(known));
        let mut keep = std::mem::take(&mut buckets.keep);
        keep.clear();
        keep.extend(fresh.iter().map(|support| self.has_supporters(support, buckets)));
        let mut kept = keep.iter();
        fresh.retain(|_| kept.next().copied().unwrap_or(false));
        buckets.keep = keep;
    }

    fn has_supporters(&self, support: &Support, buckets: &Buckets) -> bool {
        // Counted in whole rows of buckets: to look at a few more is quicker than to decide after each. The support finds
        // itself too.
        let mut found = 0;
        for others in buckets.around(support, self.radius_px) {
            for other in others {
                let is_near = (other.x.abs_diff(support.x) <= self.radius_px)
                    & (other.y.abs_diff(support.y) <= self.radius_px)
                    & ((other.disparity_px - support.disparity_px).abs() <= self.tolerance_px);
                found += usize::from(is_near);
            }
            if found > self.supporters {
                return true;
            }
        }
        false
    }
}

/// Disparities this far from what their neighbours say, in px, say no more than they: the evaluation tests a pixel to either
/// side.
const REDUNDANT_PX: f32 = 1.0;

/// Leaves out what those around say already. Of the cells of `cell_px`, every second one may go, like the black squares of a
/// chessboard: if its support lies within [`REDUNDANT_PX`] of the line through its neighbours on both sides, or above and
/// below, and not outside of the other one.
pub(crate) fn thin(
    supports: &mut Vec<Support>,
    (width, height): (usize, usize),
    cell_px: usize,
    cells: &mut Vec<Option<Support>>,
) {
    let (columns, rows) = (width.div_ceil(cell_px), height.div_ceil(cell_px));
    let cell = |support: &Support| (support.x / cell_px, support.y / cell_px);
    cells.clear();
    cells.resize(columns * rows, None);
    for support in &*supports {
        let (column, row) = cell(support);
        cells[row * columns + column] = Some(*support);
    }
    supports.retain(|support| {
        let (column, row) = cell(support);
        let is_inside = (1..columns - 1).contains(&column) && (1..rows - 1).contains(&row);
        if (column + row).is_multiple_of(2) || !is_inside {
            return true;
        }
        let at = row * columns + column;
        let beside = support.lies_between(cells[at - 1], cells[at + 1], |of| of.x);
        let over = support.lies_between(cells[at - columns], cells[at + columns], |of| of.y);
        beside.or(over) != Some(true) || over == Some(false)
    });
}

impl Support {
    /// Whether its disparity is the one of the line through its neighbours `along` an axis, if there are both.
    fn lies_between(
        &self,
        one: Option<Self>,
        other: Option<Self>,
        along: fn(&Self) -> usize,
    ) -> Option<bool> {
        let (one, other) = (one?, other?);
        let [at, from, to] = [self, &one, &other].map(|of| along(of) as f32);
        let share = (at - from) / (to - from);
        let expected = one.disparity_px + share * (other.disparity_px - one.disparity_px);
        Some((self.disparity_px - expected).abs() <= REDUNDANT_PX)
    }
}

/// Supports sorted into square buckets.
#[derive(Debug, Default)]
pub(crate) struct Buckets {
    columns: usize,
    rows: usize,
    /// `sorted[starts[b]..starts[b + 1]]` are the supports of bucket b.
    starts: Vec<u32>,
    sorted: Vec<Support>,
    /// Which supports stay.
    keep: Vec<bool>,
}

/// Side of a bucket in px.
const BUCKET_PX: usize = 20;

impl Buckets {
    pub(crate) fn reshape(&mut self, width: usize, height: usize) {
        (self.columns, self.rows) = (width.div_ceil(BUCKET_PX), height.div_ceil(BUCKET_PX));
    }

    fn of(&self, support: &Support) -> usize {
        support.y / BUCKET_PX * self.columns + support.x / BUCKET_PX
    }

    /// A counting sort.
    fn fill<'a>(&mut self, supports: impl Iterator<Item = &'a Support> + Clone) {
        self.starts.clear();
        self.starts.resize(self.columns * self.rows + 1, 0);
        self.sorted.clear();
        for support in supports.clone() {
            let bucket = self.of(support);
            self.starts[bucket] += 1;
            self.sorted.push(*support);
        }
        let mut end = 0;
        for start in &mut self.starts {
            end += *start;
            *start = end;
        }
        for support in supports {
            let bucket = self.of(support);
            self.starts[bucket] -= 1;
            self.sorted[self.starts[bucket] as usize] = *support;
        }
    }

    /// The supports of all buckets that reach within `radius_px` of `support`, by rows of buckets, its own one first.
    fn around(&self, support: &Support, radius_px: usize) -> impl Iterator<Item = &[Support]> {
        let span = |at: usize, n: usize| {
            at.saturating_sub(radius_px) / BUCKET_PX..=((at + radius_px) / BUCKET_PX).min(n - 1)
        };
        let columns = span(support.x, self.columns);
        let (rows, own) = (span(support.y, self.rows), support.y / BUCKET_PX);
        (own..=*rows.end()).chain(*rows.start()..own).map(move |row| {
            let first = self.starts[row * self.columns + columns.start()] as usize;
            let end = self.starts[row * self.columns + columns.end() + 1] as usize;
            &self.sorted[first..end]
        })
    }
}

#[cfg(test)]
mod tests;
