//! FAST corners (Rosten and Drummond 2006), best of each bin: the paper's first supports (section III-A).
//!
//! A pixel is a corner if 9 contiguous pixels of the 16 on a circle of radius 3 are all brighter, or all darker, than it by
//! a threshold. Its score is the largest threshold at which it still is one. Bins keep the image evenly covered.

use std::ops::Range;

use crate::marks;
use crate::plane::Plane;
use crate::simd::{Kernel, Lanes, Level, MOST_BYTES};
use crate::support::{BORDER_PX, Candidate};

/// Bins over the image, columns x rows (paper: "sampled from 12x10 spatial-bins").
const BINS: (usize, usize) = (12, 10);
/// Corners kept a bin; the paper leaves it open. 8 makes 960 supports at most, as many as its figures show.
const PER_BIN: usize = 8;
/// Gray levels a circle pixel must differ by more than; the paper leaves it open.
const THRESHOLD: u8 = 10;
/// Contiguous circle pixels that make a corner.
const ARC: usize = 9;

/// Offsets of the circle, clockwise from the top.
const CIRCLE: [(i8, i8); 16] = [
    (0, -3),
    (1, -3),
    (2, -2),
    (3, -1),
    (3, 0),
    (3, 1),
    (2, 2),
    (1, 3),
    (0, 3),
    (-1, 3),
    (-2, 2),
    (-3, 1),
    (-3, 0),
    (-3, -1),
    (-2, -2),
    (-1, -3),
];

/// Finds corners.
#[derive(Debug, Default)]
pub(crate) struct Corners {
    /// Those of each bin, with their scores.
    bins: Vec<Vec<(u8, Candidate)>>,
    /// Scores of [`ROWS`] rows: a corner must be the best of its 3x3 neighbourhood.
    scores: [Vec<u8>; ROWS],
    /// The best ones of a row.
    marks: Vec<u8>,
}

/// Rows of a neighbourhood.
const ROWS: usize = 3;

impl Corners {
    /// Forgets the corners so far; those of `image` follow.
    pub(crate) fn begin(&mut self, image: &Plane) {
        self.bins.resize_with(BINS.0 * BINS.1, Vec::new);
        self.bins.iter_mut().for_each(Vec::clear);
        for row in &mut self.scores {
            row.clear();
            row.resize(image.width() + MOST_BYTES, 0);
        }
    }

    /// Finds the corners in the next `count` rows from `row` on of the padded left image, the first time from row 0; the
    /// answer is the row to go on with, `None` after the last one.
    pub(crate) fn find(&mut self, level: Level, image: &Plane, row: usize, count: usize) -> Option<usize> {
        let end = (row + count).min(image.height());
        level.run(Find {
            corners: self,
            image,
            rows: row..end,
        });
        (end < image.height()).then_some(end)
    }

    /// The corners found, in order of their bins.
    pub(crate) fn best(&mut self, found: &mut Vec<Candidate>) {
        found.clear();
        for bin in &mut self.bins {
            // Of equals, the first.
            bin.sort_unstable_by_key(|&(score, at)| (std::cmp::Reverse(score), at.y, at.x));
            found.extend(bin.iter().take(PER_BIN).map(|&(_, corner)| corner));
        }
    }
}

/// Scores rows, and puts the best of the rows above them into their bins.
struct Find<'a> {
    corners: &'a mut Corners,
    image: &'a Plane,
    rows: Range<usize>,
}

impl Kernel for Find<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self { corners, image, rows } = self;
        let Corners { bins, scores, marks } = corners;
        let (width, height) = (image.width(), image.height());
        let (bin_width, bin_height) = (width.div_ceil(BINS.0), height.div_ceil(BINS.1));
        let inside = BORDER_PX..width - BORDER_PX;
        for y in rows {
            let row = &mut scores[y % ROWS];
            row.fill(0);
            if (BORDER_PX..height - BORDER_PX).contains(&y) {
                score_row(lanes, image, y, row);
                row[..inside.start].fill(0);
                row[inside.end..].fill(0);
            }
            let Some(y) = y
                .checked_sub(1)
                .filter(|y| (BORDER_PX..height - BORDER_PX).contains(y))
            else {
                continue;
            };
            let [above, here, below] = [y + ROWS - 1, y, y + 1].map(|y| &scores[y % ROWS][..]);
            mark_best([above, here, below], inside.clone(), (marks, width));
            let bins = &mut bins[y / bin_height * BINS.0..][..BINS.0];
            for x in marks::positions(marks) {
                bins[x / bin_width].push((here[x], Candidate { x, y }));
            }
        }
    }
}

/// Marks the scores of the middle row that no neighbour exceeds; of equals, the first.
#[inline(always)]
fn mark_best(
    [above, here, below]: [&[u8]; ROWS],
    inside: Range<usize>,
    (marks, width): (&mut Vec<u8>, usize),
) {
    marks::clear(marks, width);
    let n = inside.len();
    // One slice for each column of the neighbourhood, so that the loop needs no bounds checks.
    let from = inside.start - 1;
    let [above, sides, below] =
        [above, here, below].map(|row| [&row[from..][..n], &row[from + 1..][..n], &row[from + 2..][..n]]);
    let marks = &mut marks[inside][..n];
    for x in 0..n {
        let own = sides[1][x];
        let before = above[0][x].max(above[1][x]).max(above[2][x]).max(sides[0][x]);
        let after = below[0][x].max(below[1][x]).max(below[2][x]).max(sides[2][x]);
        marks[x] = u8::from(own > before) & u8::from(own >= after);
    }
}

/// Scores of row `y`, 0 where there is no corner; what is next to the border means nothing.
#[inline(always)]
fn score_row<L: Lanes>(lanes: L, image: &Plane, y: usize, scores: &mut [u8]) {
    // The circle's pixels of column 0 and those right of it.
    let circle =
        CIRCLE.map(|(dx, dy)| &image.row(y, dy)[image.margin_left().wrapping_add_signed(isize::from(dx))..]);
    let centres = &image.row(y, 0)[image.margin_left()..];
    let threshold = lanes.splat(THRESHOLD);
    let columns = (0..image.width() - BORDER_PX).step_by(L::BYTES);
    for (x, scores) in columns.zip(scores.chunks_exact_mut(L::BYTES)) {
        let centre = lanes.load(&centres[x..]);
        let mut brighter = [centre; CIRCLE.len()];
        let mut darker = brighter;
        // Any 9 of 16 in a row contain two neighbours of these four: a cheap way to dismiss most pixels.
        for k in [0, 4, 8, 12] {
            let pixel = lanes.load(&circle[k][x..]);
            brighter[k] = lanes.sub_saturating(pixel, centre);
            darker[k] = lanes.sub_saturating(centre, pixel);
        }
        let most = lanes.max(cross(lanes, &brighter), cross(lanes, &darker));
        if lanes.total(lanes.sub_saturating(most, threshold)) == 0 {
            continue;
        }
        for k in 0..CIRCLE.len() {
            let pixel = lanes.load(&circle[k][x..]);
            brighter[k] = lanes.sub_saturating(pixel, centre);
            darker[k] = lanes.sub_saturating(centre, pixel);
        }
        let best = lanes.max(best_arc(lanes, brighter), best_arc(lanes, darker));
        let is_none = lanes.equal(lanes.max(best, threshold), threshold);
        lanes.store(lanes.and(best, lanes.not(is_none)), scores);
    }
}

/// What the best two neighbours of the circle's top, right, bottom and left reach together.
#[inline(always)]
fn cross<L: Lanes>(lanes: L, steps: &[L::V; CIRCLE.len()]) -> L::V {
    lanes.min(lanes.max(steps[0], steps[8]), lanes.max(steps[4], steps[12]))
}

/// What the best arc of the circle reaches as a whole: the largest threshold at which there is a corner.
#[inline(always)]
fn best_arc<L: Lanes>(lanes: L, steps: [L::V; CIRCLE.len()]) -> L::V {
    // What 1 pixel reaches, then 2, 4 and 8 in a row.
    let mut reached = steps;
    for further in [1, 2, 4] {
        let shorter = reached;
        for (k, reached) in reached.iter_mut().enumerate() {
            *reached = lanes.min(shorter[k], shorter[(k + further) % CIRCLE.len()]);
        }
    }
    let mut best = lanes.splat(0);
    for (k, eight) in reached.into_iter().enumerate() {
        let ninth = steps[(k + ARC - 1) % CIRCLE.len()];
        best = lanes.max(best, lanes.min(eight, ninth));
    }
    best
}

#[cfg(test)]
mod tests;
