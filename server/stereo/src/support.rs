//! Support points: which pixels are searched for, and which matches are kept.

use crate::gradient::Gradient;

/// A pixel of the left view to be searched for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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

/// The best pixel of a cell so far.
#[derive(Debug, Clone, Copy)]
struct Strongest {
    strength: u8,
    at: Candidate,
    /// Pixels that count.
    eligible: usize,
}

const NONE_YET: Strongest = Strongest {
    strength: 0,
    at: Candidate { x: 0, y: 0 },
    eligible: 0,
};

/// Pixels that the mesh does not explain: those with a cost above a limit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Unexplained<'a> {
    /// Cost of every pixel of the window.
    pub(crate) cost: &'a [u8],
    /// Largest cost of an explained pixel.
    pub(crate) explained_up_to: u8,
}

/// In every cell of `cell_px` x `cell_px` of a window of `width` x `height`, the pixel with the strongest horizontal
/// gradient, in snake order of the cells: neighbours in the list are neighbours in the image, which is what incremental
/// triangulation likes.
///
/// With `unexplained`, only those pixels count, and only cells with at least `cell_px / 2` of them. This is the paper's
/// C_b with another choice within the cell: the pixel that can be matched best, not the one that matches worst.
pub(crate) fn strongest_per_cell(
    gradient: &Gradient,
    (width, height): (usize, usize),
    cell_px: usize,
    unexplained: Option<Unexplained<'_>>,
    found: &mut Vec<Candidate>,
) {
    found.clear();
    let enough = if unexplained.is_some() { cell_px / 2 } else { 1 };
    let mut cells = vec![NONE_YET; width.div_ceil(cell_px)];
    for (row_of_cells, top) in (0..height).step_by(cell_px).enumerate() {
        cells.fill(NONE_YET);
        for y in top.max(BORDER_PX)..(top + cell_px).min(height - BORDER_PX) {
            let row = y * width..(y + 1) * width;
            let strengths = &gradient.strength[row.clone()];
            let costs = unexplained.map(|pixels| (&pixels.cost[row], pixels.explained_up_to));
            for (cell, left) in cells.iter_mut().zip((0..width).step_by(cell_px)) {
                for x in left.max(BORDER_PX)..(left + cell_px).min(width - BORDER_PX) {
                    let strength = strengths[x];
                    if strength < MIN_STRENGTH || costs.is_some_and(|(costs, up_to)| costs[x] <= up_to) {
                        continue;
                    }
                    cell.eligible += 1;
                    if strength > cell.strength {
                        (cell.strength, cell.at) = (strength, Candidate { x, y });
                    }
                }
            }
        }
        let start = found.len();
        found.extend(
            cells
                .iter()
                .filter(|cell| cell.eligible >= enough)
                .map(|cell| cell.at),
        );
        if row_of_cells % 2 == 1 {
            found[start..].reverse();
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
        let keep: Vec<bool> = fresh
            .iter()
            .map(|support| self.has_supporters(support, buckets))
            .collect();
        let mut keep = keep.into_iter();
        fresh.retain(|_| keep.next().unwrap_or(false));
    }

    fn has_supporters(&self, support: &Support, buckets: &Buckets) -> bool {
        let near = |other: &Support| {
            other.x.abs_diff(support.x) <= self.radius_px
                && other.y.abs_diff(support.y) <= self.radius_px
                && (other.disparity_px - support.disparity_px).abs() <= self.tolerance_px
        };
        // The support finds itself too.
        buckets
            .around(support, self.radius_px)
            .filter(|other| near(other))
            .nth(self.supporters)
            .is_some()
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

    /// The supports of all buckets that reach within `radius_px` of `support`.
    fn around(&self, support: &Support, radius_px: usize) -> impl Iterator<Item = &Support> {
        let span = |at: usize, n: usize| {
            at.saturating_sub(radius_px) / BUCKET_PX..=((at + radius_px) / BUCKET_PX).min(n - 1)
        };
        let columns = span(support.x, self.columns);
        span(support.y, self.rows).flat_map(move |row| {
            let first = self.starts[row * self.columns + columns.start()] as usize;
            let end = self.starts[row * self.columns + columns.end() + 1] as usize;
            &self.sorted[first..end]
        })
    }
}

#[cfg(test)]
mod tests;
