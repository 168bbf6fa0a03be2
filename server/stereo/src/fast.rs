//! FAST corners (Rosten and Drummond 2006), best of each bin: the paper's first supports (section III-A).
//!
//! A pixel is a corner if 9 contiguous pixels of the 16 on a circle of radius 3 are all brighter, or all darker, than it by
//! a threshold. Its score is the largest threshold at which it still is one. Bins keep the image evenly covered.

use crate::plane::Plane;
use crate::support::{BORDER_PX, Candidate};

/// Bins over the image, columns x rows (paper: "sampled from 12x10 spatial-bins").
const BINS: (usize, usize) = (12, 10);
/// Corners kept a bin; the paper leaves it open. 8 makes 960 supports at most, as many as its figures show.
const PER_BIN: usize = 8;
/// Gray levels a circle pixel must differ by more than; the paper leaves it open.
const THRESHOLD: i16 = 10;
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
    bins: Vec<Vec<(i16, Candidate)>>,
    /// Scores of three rows: a corner must be the best of its 3x3 neighbourhood.
    rows: [Vec<i16>; 3],
}

impl Corners {
    /// The corners of the padded left image, in order of their bins.
    pub(crate) fn find(&mut self, image: &Plane, found: &mut Vec<Candidate>) {
        let Self { bins, rows } = self;
        found.clear();
        let (width, height) = (image.width(), image.height());
        let (bin_width, bin_height) = (width.div_ceil(BINS.0), height.div_ceil(BINS.1));
        bins.resize_with(BINS.0 * BINS.1, Vec::new);
        bins.iter_mut().for_each(Vec::clear);
        for row in &mut *rows {
            row.clear();
            row.resize(width, 0);
        }
        for y in BORDER_PX..height - BORDER_PX + 1 {
            rows.rotate_left(1);
            rows[2].fill(0);
            if y < height - BORDER_PX {
                score_row(image, y, &mut rows[2]);
            }
            let y = y - 1;
            for x in BORDER_PX..width - BORDER_PX {
                let score = rows[1][x];
                let is_best = score > 0
                    && (0..3).all(|row| (x - 1..=x + 1).all(|at| rows[row][at] <= score))
                    // Of equals, the first.
                    && rows[0][x - 1..=x + 1].iter().all(|&other| other < score)
                    && rows[1][x - 1] < score;
                if is_best {
                    bins[y / bin_height * BINS.0 + x / bin_width].push((score, Candidate { x, y }));
                }
            }
        }
        for bin in bins {
            // Of equals, the first.
            bin.sort_unstable_by_key(|&(score, at)| (std::cmp::Reverse(score), at.y, at.x));
            found.extend(bin.iter().take(PER_BIN).map(|&(_, corner)| corner));
        }
    }
}

/// Scores of row `y`, 0 where there is no corner.
fn score_row(image: &Plane, y: usize, scores: &mut [i16]) {
    let rows: [&[u8]; 7] = [-3, -2, -1, 0, 1, 2, 3].map(|dy| image.row(y, dy));
    let margin = image.margin_left();
    for (x, score) in scores
        .iter_mut()
        .enumerate()
        .take(image.width() - BORDER_PX)
        .skip(BORDER_PX)
    {
        let at = |dx: i8, dy: i8| {
            let row = rows[usize::from(3i8.wrapping_add(dy).unsigned_abs())];
            i16::from(row[(margin + x).wrapping_add_signed(isize::from(dx))])
        };
        let centre = at(0, 0);
        // Any 9 of 16 in a row contain two neighbours of these four: a cheap way to dismiss most pixels.
        let cross = [CIRCLE[0], CIRCLE[4], CIRCLE[8], CIRCLE[12]].map(|(dx, dy)| at(dx, dy) - centre);
        let brighter = cross.iter().filter(|&&step| step > THRESHOLD).count();
        let darker = cross.iter().filter(|&&step| step < -THRESHOLD).count();
        if brighter >= 2 || darker >= 2 {
            *score = arc_score(CIRCLE.map(|(dx, dy)| at(dx, dy) - centre));
        }
    }
}

/// The largest t such that an arc of the circle is brighter than t or darker than -t; 0 unless above the threshold.
fn arc_score(steps: [i16; 16]) -> i16 {
    let mut best = 0;
    for first in 0..16 {
        let arc = || (first..first + ARC).map(|k| steps[k % 16]);
        let brighter = arc().min().unwrap_or(0);
        let darker = -arc().max().unwrap_or(0);
        best = best.max(brighter).max(darker);
    }
    if best > THRESHOLD { best } else { 0 }
}

#[cfg(test)]
mod tests;
