//! The working state of one frame, and the stages that lead from one rung to the next.

use crate::census::{Census, Pattern};
use crate::certainty;
use crate::changes::Changes;
use crate::coarse::Coarse;
use crate::confidence::{CostScale, rate_costs};
use crate::cost::Scratch;
use crate::disparity::{DisparityMap, FIXED_PER_PX};
use crate::fast::Corners;
use crate::fitted;
use crate::fork_join::{self, ForkJoin, Serial};
use crate::gradient::Gradient;
use crate::image::{GrayView, Roi, Shape, StereoPair};
use crate::ladder::{Recipe, Rung, Work};
use crate::mesh::{Mesh, MeshParams};
use crate::output_mesh::{Evidence, Facet, Writer};
use crate::paper::Occupancy;
use crate::params::Params;
use crate::plane::{CACHE_LINE, MARGIN_X, MARGIN_Y, Plane};
use crate::propagate;
use crate::publish::{self, Before, Published, Record};
use crate::simd::Level;
use crate::smooth;
use crate::support::{self, Buckets, Candidate, Support};
use crate::surface::Surface;
use crate::triangulation::Triangulation;

mod dense;
mod meshing;
mod recovery;
mod regions;

pub(crate) use regions::Regions;

/// Where the way to a rung goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stage {
    /// Choose the pixels to search for, or start whatever else leads to the rung.
    Choose,
    /// Look for corners from row `row` on.
    Corners { row: usize },
    /// Search candidate `next` and the following ones.
    Search { next: usize },
    /// Insert matched support `next` and the following ones into the mesh.
    Insert { next: usize },
    /// Rasterise the triangles that changed, those of new vertex `next` and the following ones.
    Interpolate { next: usize },
    /// Make the candidates of propagation.
    Propagate,
    /// Evaluate costs from row `row` on.
    Evaluate { row: usize },
    /// Do a part of the dense rungs' work.
    Dense(dense::Part),
    /// Do a part of the work to get back what the dense rungs lost.
    Recover(recovery::Part),
    /// Rate and write the result.
    Publish,
}

impl Stage {
    /// For people.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Choose | Self::Corners { .. } => "choose",
            Self::Search { .. } => "search",
            Self::Insert { .. } => "triangulate",
            Self::Interpolate { .. } => "interpolate",
            Self::Propagate => "propagate",
            Self::Evaluate { .. } => "evaluate",
            Self::Dense(part) => part.name(),
            Self::Recover(part) => part.name(),
            Self::Publish => "publish",
        }
    }
}

/// Context around a region of interest, px: supports there shape the mesh within.
const CONTEXT_PX: usize = 32;

/// Whether a rung's result is a map, not a mesh.
fn is_dense(rung: &Rung) -> bool {
    matches!(rung.work, Work::HalfBand | Work::Full)
}

/// Pixels of this confidence confirm a mesh. In a dense map what was filled in confirms nothing.
fn confirmed_from(is_dense: bool) -> u8 {
    if is_dense { certainty::CONFIRMED_FROM } else { 1 }
}

/// All scratch of a matcher. Positions are relative to the window, disparities to the smallest one searched.
#[derive(Debug, Default)]
pub(crate) struct Frame {
    level: Level,
    /// The part of the image that is worked on.
    window: Window,
    left: Plane,
    right: Plane,
    real_columns: (Columns, Columns),
    left_census: Census,
    right_census: Census,
    gradient: Gradient,
    choosing: support::Scratch,
    corners: Corners,
    candidates: Vec<Candidate>,
    /// What each piece of a search found.
    found: Vec<Vec<Support>>,
    /// Matched in this iteration; then moved to `supports`.
    fresh: Vec<Support>,
    supports: Vec<Support>,
    /// The support of each cell.
    cells: Vec<Option<Support>>,
    buckets: Buckets,
    triangulation: Triangulation,
    /// Vertices the mesh had when it was last rasterised.
    rasterised_vertices: usize,
    occupancy: Occupancy,
    /// D_it: the mesh's planes.
    interpolated: Vec<u16>,
    /// What propagation tries, or a dense rung's result before it is smoothed.
    proposed: Vec<u16>,
    /// What recovery tries, which gives it its size; then what is smoothed so far.
    lent: Vec<u16>,
    /// D_f and C_f.
    disparity: Vec<u16>,
    cost: Vec<u8>,
    /// Whether the frame has them yet.
    has_costs: bool,
    confidence: Vec<u8>,
    half: Coarse,
    quarter: Coarse,
    smoothing: Vec<smooth::Scratch>,
    surface: Surface,
    mesh_writer: Writer,
    /// Where the candidates to evaluate changed.
    changes: Changes,
    lending: propagate::Scratch,
    published: Record,
    scratch: Vec<Scratch>,
}

type Columns = std::ops::Range<usize>;

/// The window within the image, and the disparities searched in it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Window {
    pub(crate) roi: Roi,
    pub(crate) min_disparity_px: usize,
    pub(crate) disparities: usize,
}

impl Default for Window {
    fn default() -> Self {
        Self {
            roi: Roi {
                x: 0,
                y: 0,
                width: 0,
                height: 0,
            },
            min_disparity_px: 0,
            disparities: 0,
        }
    }
}

impl Window {
    /// The region of interest with its context, at least as large as the smallest image.
    fn of(shape: Shape, params: &Params) -> Self {
        let roi = params.roi.unwrap_or(Roi::full(shape));
        let extend = |from: usize, length: usize, n: usize| {
            let first = from.saturating_sub(CONTEXT_PX);
            (first, (from + length + CONTEXT_PX).min(n) - first)
        };
        let (x, width) = extend(roi.x, roi.width, shape.width_px());
        let (y, height) = extend(roi.y, roi.height, shape.height_px());
        Self {
            roi: Roi { x, y, width, height },
            min_disparity_px: usize::from(params.range.min_px),
            disparities: usize::from(params.range.count),
        }
    }

    /// Largest relative disparity in 1/64 px.
    fn max_fixed(&self) -> u16 {
        u16::try_from((self.disparities - 1) * usize::from(FIXED_PER_PX)).unwrap_or(u16::MAX)
    }
}

/// One view and what is made of it.
struct View<'a> {
    source: GrayView<'a>,
    /// The source's pixel that becomes column 0, row 0.
    origin: (isize, usize),
    /// Columns that show real pixels.
    columns: Columns,
    plane: &'a mut Plane,
    census: &'a mut Census,
    /// The left view's.
    gradient: Option<&'a mut Gradient>,
}

/// Rows that are taken in at a time, while they are in the cache.
const ROWS_AT_A_TIME: usize = 32;

impl View<'_> {
    /// Copies the view, or one piece of it after the other into the same place; codes and gradients follow as soon as the
    /// rows they look at are there.
    fn take_in(mut self, level: Level, pattern: Pattern) {
        let height = self.census.height();
        let is_kept = self.plane.height() == height;
        let mut copied = 0;
        for top in (0..height).step_by(ROWS_AT_A_TIME) {
            let rows = top..(top + ROWS_AT_A_TIME).min(height);
            if is_kept {
                let needed = rows.end + 2 * MARGIN_Y;
                self.plane.copy_from(&self.source, self.origin, copied..needed);
                copied = needed;
            } else {
                self.plane.show(&self.source, self.origin, top);
            }
            if let Some(gradient) = &mut self.gradient {
                gradient.compute(level, self.plane, rows.clone());
            }
            self.census
                .compute_rows(level, pattern, self.plane, self.columns.clone(), rows);
        }
    }
}

impl Frame {
    /// Room for images of `shape`.
    pub(crate) fn reshape(&mut self, level: Level, shape: Shape, params: &Params, recipe: &Recipe) {
        self.level = level;
        self.window = Window::of(shape, params);
        let Roi { width, height, .. } = self.window.roi;
        // Every row begins with a cache line.
        let margins = (2 * MARGIN_X + self.window.disparities + width).next_multiple_of(CACHE_LINE) - width;
        let held = if recipe.looks_back() {
            height
        } else {
            height.min(ROWS_AT_A_TIME)
        };
        self.left.reshape(width, held, MARGIN_X, margins - MARGIN_X);
        let left = self.window.disparities + MARGIN_X;
        self.right.reshape(width, held, left, margins - left);
        self.left_census
            .reshape(recipe.pattern, &self.left, height, false);
        self.right_census
            .reshape(recipe.pattern, &self.right, height, true);
        self.gradient.reshape(width, height);
        self.buckets.reshape(width, height);
        for map in [&mut self.interpolated, &mut self.proposed, &mut self.disparity] {
            map.resize(width * height, 0);
        }
        self.cost.resize(width * height, 0);
        self.confidence.resize(width * height, 0);
    }

    /// Takes in a pair and forgets the one before.
    pub(crate) fn begin(&mut self, pair: StereoPair<'_>, recipe: &Recipe, join: &dyn ForkJoin) {
        let Window {
            roi,
            min_disparity_px,
            ..
        } = self.window;
        let columns = self.real_columns(pair.left().width_px());
        self.real_columns = columns.clone();
        let left_px = roi.x.cast_signed();
        let left = View {
            source: pair.left(),
            origin: (left_px, roi.y),
            columns: columns.0,
            plane: &mut self.left,
            census: &mut self.left_census,
            gradient: Some(&mut self.gradient),
        };
        let right = View {
            source: pair.right(),
            origin: (left_px.saturating_sub_unsigned(min_disparity_px), roi.y),
            columns: columns.1,
            plane: &mut self.right,
            census: &mut self.right_census,
            gradient: None,
        };
        let level = self.level;
        fork_join::for_each(join, [left, right].into_iter(), |_, view| {
            view.take_in(level, recipe.pattern);
        });
        self.has_costs = false;
        self.supports.clear();
        self.rasterised_vertices = 0;
    }

    /// Columns of the padded rows of both views that show real pixels.
    fn real_columns(&self, image_width: usize) -> (Columns, Columns) {
        let Window {
            roi,
            min_disparity_px,
            disparities,
        } = self.window;
        let left = MARGIN_X.saturating_sub(roi.x)..(image_width - roi.x + MARGIN_X).min(self.left.stride());
        let origin = disparities + MARGIN_X + min_disparity_px;
        let right = origin.saturating_sub(roi.x)..(image_width + origin - roi.x).min(self.right.stride());
        (left, right)
    }

    fn width(&self) -> usize {
        self.window.roi.width
    }

    fn height(&self) -> usize {
        self.window.roi.height
    }

    /// Does the step `stage` of the way to `rung`; `None` when the rung is reached.
    pub(crate) fn step(
        &mut self,
        stage: Stage,
        rung: &Rung,
        recipe: &Recipe,
        join: &dyn ForkJoin,
    ) -> Option<Stage> {
        match stage {
            Stage::Choose => Some(self.choose(rung, recipe)),
            Stage::Corners { row } => Some(self.find_corners(row)),
            Stage::Search { next } => Some(self.search(next, rung, recipe, join)),
            Stage::Insert { next } => Some(self.insert(next)),
            Stage::Interpolate { next } => Some(self.interpolate(next, rung, join)),
            Stage::Propagate => Some(self.propagate()),
            Stage::Evaluate { row } => self.evaluate(row, rung, recipe, join),
            Stage::Dense(part) => Some(self.dense_step(part, join)),
            Stage::Recover(part) => Some(self.recovery_step(part, rung, recipe, join)),
            Stage::Publish => None,
        }
    }

    /// Rates and writes the result so far to `out`, which may hold the one before (see `publish`).
    pub(crate) fn publish(
        &mut self,
        rung: &Rung,
        recipe: &Recipe,
        (shape, params): (Shape, &Params),
        (out, replaces): (&mut DisparityMap, bool),
        join: &dyn ForkJoin,
    ) -> Published {
        let scale = CostScale::of(recipe);
        let confidence = match rung.work {
            Work::Mesh { .. } | Work::Propagate | Work::Paper { .. } => {
                publish::Confidence::OfCosts(scale, &self.cost)
            }
            Work::HalfBand | Work::Full => publish::Confidence::OfCertainties {
                scale: dense::scale(scale),
                certainties: self.half.result().1,
                width: self.half.width(),
                costs: (rung.work == Work::Full).then_some(&self.cost[..]),
            },
        };
        let maps = publish::Maps {
            window: self.window,
            mask: &self.gradient.mask,
            interpolated: &self.interpolated,
            disparity: &self.disparity,
            confidence,
        };
        let is_plain = params.roi.is_none() && params.focus.is_empty();
        let before = match rung.work {
            _ if !replaces => Before::Nothing,
            // Where regions have been, the output holds their result.
            Work::Mesh { .. } if is_plain => Before::ResultBut(&self.changes, rung.window.radius()),
            Work::Propagate if is_plain => Before::ResultBut(&self.changes, 0),
            _ => Before::Result,
        };
        let out = (out, before, &mut self.published);
        publish::publish(self.level, &maps, (shape, params), out, join)
    }

    /// Share of the pixels whose disparity explains the images badly, by the costs of mesh rungs.
    pub(crate) fn failed_share(&self) -> f32 {
        propagate::failed_share(self.level, &self.cost)
    }

    /// Writes the mesh to `out`, in the image's pixels and disparities: the one that was matched, or one that is made anew from
    /// the map after a dense rung, if there are more triangles than wanted, or if `regions` are ahead of the rest.
    pub(crate) fn write_mesh(
        &mut self,
        (rung, recipe): (&Rung, &Recipe),
        regions: Option<&mut Regions>,
        params: &MeshParams,
        out: &mut Mesh,
    ) {
        let is_dense = is_dense(rung);
        // Publishing has rated the pixels on the way.
        let scale = CostScale::of(recipe);
        if is_dense {
            self.rate_dense(rung, scale, &Serial);
        } else {
            rate_costs(self.level, scale, &self.cost, &mut self.confidence);
        }
        if let Some(regions) = regions {
            let maps = regions.compose(self, is_dense, recipe);
            let evidence = Evidence {
                window: self.window,
                mask: &self.gradient.mask,
                disparity: &maps.disparity,
                confidence: &maps.confidence,
                confirmed_from: 1,
            };
            let source = fitted::Source {
                map: &maps.interpolated,
                width: self.window.roi.width,
                is_guess: false,
            };
            let scratch = (&mut self.surface, &mut self.mesh_writer);
            return fitted::write(self.level, scratch, source, evidence, params, out);
        }
        let evidence = Evidence {
            window: self.window,
            mask: &self.gradient.mask,
            disparity: &self.disparity,
            confidence: &self.confidence,
            confirmed_from: confirmed_from(is_dense),
        };
        if !is_dense && self.triangulation.triangles() <= params.max_triangles as usize {
            let facets = self.triangulation.triangles_from(0).map(Facet::from);
            let mesh = (self.triangulation.vertices(), facets);
            return self.mesh_writer.write(self.level, mesh, evidence, params, out);
        }
        let source = fitted::Source {
            map: if is_dense {
                &self.disparity
            } else {
                &self.interpolated
            },
            width: self.window.roi.width,
            // Without a support, nothing in the map has been matched.
            is_guess: self.supports.is_empty(),
        };
        let scratch = (&mut self.surface, &mut self.mesh_writer);
        fitted::write(self.level, scratch, source, evidence, params, out);
    }
}

#[cfg(test)]
mod tests;
