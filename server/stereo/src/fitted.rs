//! The mesh of a map, with as many triangles as a budget allows of those that hold.

use crate::mesh::{Mesh, MeshParams};
use crate::output_mesh::{Evidence, Writer};
use crate::simd::Level;
use crate::surface::Surface;

/// What a mesh is fitted to.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Source<'a> {
    /// Disparities in 1/64 px.
    pub(crate) map: &'a [u16],
    pub(crate) width: usize,
    /// Whether they are guesses.
    pub(crate) is_guess: bool,
}

/// So many times the budget are planned at most.
const MOST_PLANNED: f64 = 4.0;
/// Share of the budget that is aimed at: how many hold is estimated.
const AIM: f64 = 0.93;
/// Triangles that are judged for the estimate, about.
const SAMPLE: usize = 256;

/// Adds to `out` the mesh of `source`, at most `params.max_triangles` triangles.
///
/// Triangles that don't hold are left out, so that more are planned than may be sent where the budget binds: as many as some
/// of them, judged before, let expect. If too many hold then, fewer are planned.
pub(crate) fn write(
    level: Level,
    (surface, writer): (&mut Surface, &mut Writer),
    source: Source<'_>,
    evidence: Evidence<'_>,
    params: &MeshParams,
    out: &mut Mesh,
) {
    let Source { map, width, is_guess } = source;
    surface.fit(level, map, width, params.tolerance_px);
    let budget = usize::try_from(params.max_triangles).unwrap_or(usize::MAX);
    let mut plan = budget;
    if !surface.cut(plan) && !params.keep_rejected {
        let sample = surface.facets(is_guess).step_by((budget / SAMPLE).clamp(1, 16));
        let share = writer.share_kept(level, sample, evidence, params);
        plan = planned(budget, share);
        surface.cut(plan);
    }
    let (vertices, triangles) = (out.vertices.len(), out.triangles.len());
    loop {
        let mesh = (surface.nodes(), surface.facets(is_guess));
        writer.write(level, mesh, evidence, params, out);
        if out.triangles.len() - triangles <= budget {
            return;
        }
        // Of a plan for the budget itself, no more than that are sent.
        out.vertices.truncate(vertices);
        out.triangles.truncate(triangles);
        plan = budget.midpoint(plan);
        surface.cut(plan);
    }
}

/// Triangles to plan if `share` of as many as the budget hold.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "at most four million"
)]
fn planned(budget: usize, share: f64) -> usize {
    let wanted = (AIM / share).clamp(1.0, 1e6);
    // The finer a mesh, the more of it holds: what holds grows by the power of 4/3, about, of what is planned.
    let factor = (wanted * wanted.sqrt()).sqrt().min(MOST_PLANNED);
    (factor * budget as f64) as usize
}

#[cfg(test)]
mod tests;
