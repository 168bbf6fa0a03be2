//! The mesh of a map: vertices where planes stop fitting.
//!
//! A grid of nodes, about two pixels apart, lies over the window. Its coarsest mesh has two triangles for each of a few root
//! squares; a triangle is split in two at the node in the middle of its longest side, together with the one on the other side
//! (right-triangulated irregular networks: Evans, Kirkpatrick, Townsend 2001). A node so needs two coarser ones, and every
//! choice of nodes that contains what they need is a mesh without cracks.
//!
//! ```text
//! for every node, finest first:
//!     miss  = how far the map is from the middle of the side that the node splits
//!     gain  = miss, saturating, times the pixels around it; 0 if it is within the tolerance
//!     worth = max(gain, worth of the finer nodes that need this one)
//! split at the nodes of worth, and where the budget binds at those of the most worth
//! ```
//! Nothing is searched or inserted one by one: the time is that of one look at each node, whatever the scene.

use crate::disparity::FIXED_PER_PX;
use crate::mesh::Vertex;
use crate::output_mesh::Facet;
use crate::simd::{Kernel, Lanes, Level};

/// Distance of the finest nodes, about, in px.
const SPACING_PX: usize = 2;
/// Side of a root square, about, in px; larger if there would be too many.
const ROOT_PX: usize = 256;
/// Root squares: two triangles each have to fit into the smallest budget.
const MAX_ROOTS: usize = 50;
/// A miss of so many px counts half: across a jump, more of it says little more.
const JUMP_PX: f32 = 4.0;

/// A mesh over a map and what it is made with.
#[derive(Debug, Default)]
pub(crate) struct Surface {
    grid: Grid,
    /// The map at the nodes, in 1/64 px.
    heights: Vec<u16>,
    worth: Vec<f32>,
    /// What the nodes of a row gain for those beside them.
    sides: Vec<f32>,
    chosen: Vec<f32>,
    open: Vec<[Node; 3]>,
    /// Three nodes each: the ends of the longest side, then the third.
    triangles: Vec<[Node; 3]>,
}

/// Column and row of a node in the grid.
type Node = (u16, u16);

/// Where the nodes are.
#[derive(Debug, Default)]
struct Grid {
    /// Pixel columns and rows of the nodes.
    columns: Vec<u16>,
    rows: Vec<u16>,
    /// Nodes along the side of a root square, a power of two.
    side: usize,
}

impl Grid {
    fn lay_over(&mut self, width: usize, height: usize) {
        let mut root_px = ROOT_PX;
        let count = |length: usize, root_px: usize| ((length + root_px / 2) / root_px).max(1);
        while count(width, root_px) * count(height, root_px) > MAX_ROOTS {
            root_px *= 2;
        }
        let (across, down) = (count(width, root_px), count(height, root_px));
        let (root_width, root_height) = ((width - 1) / across, (height - 1) / down);
        // As many nodes a side as the mean side has room for, and never two on one pixel.
        let nodes = |px: usize, spacing: usize| 1 << (px / spacing).max(1).ilog2();
        let mean = (root_width * root_height).isqrt() * 181 / 128;
        self.side = nodes(mean, SPACING_PX).min(nodes(root_width.min(root_height), 1));
        for (places, n, length) in [(&mut self.columns, across, width), (&mut self.rows, down, height)] {
            let last = n * self.side;
            let place = |k: usize| u16::try_from((k * (length - 1) + last / 2) / last).unwrap_or(u16::MAX);
            places.clear();
            places.extend((0..=last).map(place));
        }
    }

    #[inline(always)]
    fn number(&self, (i, j): Node) -> usize {
        usize::from(j) * self.columns.len() + usize::from(i)
    }
}

impl Surface {
    /// Rates the nodes over `map` (rows of `width`), which may be `tolerance_px` from a plane that still fits it; to be followed by
    /// [`cut`](Self::cut).
    pub(crate) fn fit(&mut self, level: Level, map: &[u16], width: usize, tolerance_px: f32) {
        self.grid.lay_over(width, map.len() / width);
        let Grid { columns, rows, side } = &self.grid;
        self.heights.clear();
        for &y in rows {
            let row = &map[usize::from(y) * width..][..width];
            self.heights.extend(columns.iter().map(|&x| row[usize::from(x)]));
        }
        self.worth.clear();
        self.worth.resize(self.heights.len(), 0.0);
        level.run(Rate {
            heights: &self.heights,
            worth: &mut self.worth,
            sides: &mut self.sides,
            stride: columns.len(),
            side: *side,
            tolerance: 2.0 * tolerance_px * f32::from(FIXED_PER_PX),
        });
    }

    /// Number of nodes; those of a facet are below it.
    pub(crate) fn nodes(&self) -> usize {
        self.heights.len()
    }

    /// The triangles of the mesh; `is_guess` says so of the map.
    pub(crate) fn facets(&self, is_guess: bool) -> impl Iterator<Item = Facet> + '_ {
        self.triangles.iter().map(move |&[a, b, c]| Facet {
            indices: [self.grid.number(a), self.grid.number(b), self.grid.number(c)],
            vertices: [self.vertex(a), self.vertex(b), self.vertex(c)],
            is_guess,
        })
    }

    /// Where a node is, relative to the window.
    #[inline(always)]
    fn vertex(&self, node: Node) -> Vertex {
        Vertex {
            u: f32::from(self.grid.columns[usize::from(node.0)]),
            v: f32::from(self.grid.rows[usize::from(node.1)]),
            disparity: f32::from(self.heights[self.grid.number(node)]) / f32::from(FIXED_PER_PX),
        }
    }

    /// Makes the mesh with at most `budget` triangles: splits the root squares' triangles at the nodes of most worth. Whether
    /// that are all of worth.
    pub(crate) fn cut(&mut self, budget: usize) -> bool {
        let Grid { columns, rows, side } = &self.grid;
        let (across, down) = ((columns.len() - 1) / side, (rows.len() - 1) / side);
        // A node makes two triangles of two, or of one on the border.
        let affordable = budget.saturating_sub(2 * across * down) / 2;
        self.chosen.resize(self.worth.len(), 0.0);
        let mut count = 0;
        for &worth in &self.worth {
            self.chosen[count] = worth;
            count += usize::from(worth > 0.0);
        }
        let chosen = &mut self.chosen[..count];
        // Nodes of one worth are a coarse one and those it owes it to, mostly: all of them or none, or there were cracks.
        let is_complete = count <= affordable;
        let least = if !is_complete {
            *chosen.select_nth_unstable_by(affordable, |a, b| b.total_cmp(a)).1
        } else {
            0.0
        };
        #[expect(clippy::cast_possible_truncation, reason = "at most 4097 columns")]
        let [across, down, side] = [across, down, *side].map(|n| n as u16);
        self.triangles.clear();
        self.open.clear();
        for (i, j) in (0..down).flat_map(|j| (0..across).map(move |i| (i, j))) {
            let (odd, even) = ((i | 1, j | 1), ((i + 1) & !1, (j + 1) & !1));
            let corner = |(i, j): Node| (i * side, j * side);
            let (a, b) = (corner(odd), corner(even));
            // Both turn the same way, whichever way the diagonal runs.
            let (c, d) = (corner((odd.0, even.1)), corner((even.0, odd.1)));
            let flip = (odd.0 > even.0) != (odd.1 > even.1);
            let halves = if flip {
                [[a, b, c], [b, a, d]]
            } else {
                [[b, a, c], [a, b, d]]
            };
            self.open.extend(halves);
        }
        while let Some([a, b, c]) = self.open.pop() {
            let (i, j) = (a.0 + b.0, a.1 + b.1);
            if (i | j) & 1 == 0 {
                let middle = (i / 2, j / 2);
                if self.worth[self.grid.number(middle)] > least {
                    self.open.extend([[c, a, middle], [b, c, middle]]);
                    continue;
                }
            }
            self.triangles.push([a, b, c]);
        }
        is_complete
    }
}

/// What splitting at a node at `middle`, halfway between two `ends`, with `pixels` around it gains; all in 1/64 px but the
/// tolerance, in 1/128.
#[inline(always)]
fn gain(middle: u16, ends: [u16; 2], tolerance: f32, pixels: f32) -> f32 {
    let miss = (2 * i32::from(middle) - i32::from(ends[0]) - i32::from(ends[1])).abs() as f32;
    let jump = 2.0 * JUMP_PX * f32::from(FIXED_PER_PX);
    let gain = pixels * miss / (miss + jump);
    if miss > tolerance { gain } else { 0.0 }
}

/// Rates all nodes.
struct Rate<'a> {
    heights: &'a [u16],
    worth: &'a mut [f32],
    sides: &'a mut Vec<f32>,
    stride: usize,
    side: usize,
    /// In 1/128 px.
    tolerance: f32,
}

impl Rate<'_> {
    /// What splitting at `node`, in the middle between `a` and `b`, with `pixels` around it gains.
    #[inline(always)]
    fn gain(&self, node: usize, (a, b): (usize, usize), pixels: f32) -> f32 {
        gain(
            self.heights[node],
            [self.heights[a], self.heights[b]],
            self.tolerance,
            pixels,
        )
    }

    /// The nodes of step 1, which are three in four: whole rows at once. Coarser ones get values that are replaced later.
    #[inline(always)]
    fn rate_finest(&mut self, rows: usize) {
        let (stride, tolerance) = (self.stride, self.tolerance);
        let n = stride - 2;
        for j in (0..rows).step_by(2) {
            let heights = &self.heights[j * stride..][..stride];
            let (before, here, after) = (&heights[..n], &heights[1..=n], &heights[2..]);
            let worth = &mut self.worth[j * stride..][1..=n];
            for x in 0..n {
                worth[x] = gain(here[x], [before[x], after[x]], tolerance, 2.0);
            }
        }
        let sides = &mut *self.sides;
        sides.resize(stride, 0.0);
        for j in (1..rows).step_by(2) {
            let [above, here, below] = [j - 1, j, j + 1].map(|j| &self.heights[j * stride..][..stride]);
            for x in 0..stride {
                sides[x] = gain(here[x], [above[x], below[x]], tolerance, 2.0);
            }
            let (upper, lower) = self.worth.split_at_mut(j * stride);
            let (row, lower) = lower.split_at_mut(stride);
            let (over, under) = (&upper[upper.len() - stride..][1..=n], &lower[1..=n]);
            let (left, centre, right) = (&sides[..n], &sides[1..=n], &sides[2..stride]);
            let here = &here[1..=n];
            let (above, below) = ([&above[..n], &above[2..]], [&below[..n], &below[2..]]);
            (row[0], row[n + 1]) = (sides[0], sides[n + 1]);
            let row = &mut row[1..=n];
            for x in 0..n {
                // Diagonals run through the middle of the square that is twice as large.
                let falls = ((x + 1) ^ j) & 2 == 0;
                let (upper, lower) = if falls {
                    (above[0][x], below[1][x])
                } else {
                    (above[1][x], below[0][x])
                };
                let gain = gain(here[x], [upper, lower], tolerance, 4.0);
                let worth = gain.max(left[x]).max(right[x]).max(over[x]).max(under[x]);
                row[x] = if x % 2 == 0 { worth } else { centre[x] };
            }
        }
    }

    /// The most worth of the finer nodes that need the one at `node`.
    #[inline(always)]
    fn needed<const N: usize>(&self, nodes: [usize; N]) -> f32 {
        nodes.iter().fold(0.0, |most, &at| self.worth[at].max(most))
    }

    /// The nodes in the middle of the sides, `2 * step` long, of squares.
    #[inline(always)]
    fn rate_sides(&mut self, step: usize, rows: usize) {
        let (stride, finer) = (self.stride, step / 2);
        let pixels = (2 * step * step) as f32;
        for j in (0..rows).step_by(step) {
            let is_across = j % (2 * step) == 0;
            let first = if is_across { step } else { 0 };
            let reach = if is_across { step } else { step * stride };
            for i in (first..stride).step_by(2 * step) {
                let node = j * stride + i;
                let mut worth = self.gain(node, (node - reach, node + reach), pixels);
                let (up, down) = (j >= finer, j + finer < rows);
                let (left, right) = (i >= finer, i + finer < stride);
                for (inside, dj) in [(up, finer.wrapping_neg()), (down, finer)] {
                    for (also, di) in [(left, finer.wrapping_neg()), (right, finer)] {
                        if inside && also {
                            let at = node.wrapping_add(dj.wrapping_mul(stride)).wrapping_add(di);
                            worth = worth.max(self.worth[at]);
                        }
                    }
                }
                self.worth[node] = worth;
            }
        }
    }

    /// The nodes in the middle of squares of side `2 * step`.
    #[inline(always)]
    fn rate_squares(&mut self, step: usize, rows: usize) {
        let stride = self.stride;
        let pixels = (4 * step * step) as f32;
        for j in (step..rows).step_by(2 * step) {
            for i in (step..stride).step_by(2 * step) {
                let node = j * stride + i;
                // Diagonals run through the middle of the square that is twice as large.
                let falls = (i ^ j) & (2 * step) == 0;
                let reach = step * stride;
                let reach = if falls { reach + step } else { reach - step };
                let gain = self.gain(node, (node - reach, node + reach), pixels);
                let reach = step * stride;
                self.worth[node] =
                    gain.max(self.needed([node - step, node + step, node - reach, node + reach]));
            }
        }
    }
}

impl Kernel for Rate<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(mut self, _: L) {
        let rows = self.heights.len() / self.stride;
        self.rate_finest(rows);
        let mut step = 2;
        while step < self.side {
            self.rate_sides(step, rows);
            self.rate_squares(step, rows);
            step *= 2;
        }
        // The corners of the root squares split nothing.
        for j in (0..rows).step_by(self.side) {
            for i in (0..self.stride).step_by(self.side) {
                self.worth[j * self.stride + i] = 0.0;
            }
        }
    }
}

#[cfg(test)]
mod tests;
