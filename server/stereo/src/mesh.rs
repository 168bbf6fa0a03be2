//! The mesh that is sent: vertices in pixels and disparity, triangles as indices.

use crate::error::ParamsError;

/// How fine a mesh is, and which triangles it keeps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeshParams {
    /// How far a dense result may be from a plane that still fits it, in px (0.1..=64): vertices are put where that is
    /// exceeded. The mesh of a rung of mesh iterations has the vertices that were matched, whatever the tolerance.
    pub tolerance_px: f32,
    /// Triangles at most ([`Self::MIN_TRIANGLES`]..=[`Self::MAX_TRIANGLES`]). If the tolerance needs more, vertices go where
    /// they gain the most: where much of the image is far off. A rung of mesh iterations with more triangles gets a mesh
    /// that is fitted to them within the budget.
    pub max_triangles: u32,
    /// Keep triangles that span a depth discontinuity or failed validation as well.
    pub keep_rejected: bool,
    /// A triangle without texture, which can't be validated, spans a discontinuity if its vertex disparities differ by more
    /// than this, in px (0.5..=64).
    pub max_disparity_step_px: f32,
    /// A triangle with texture failed validation if less than this share of its textured pixels lies on it (0..=1).
    pub min_valid_share: f32,
}

impl MeshParams {
    /// The smallest budget: a mesh of any image has two triangles for each of up to 50 squares.
    pub const MIN_TRIANGLES: u32 = 100;
    /// The largest budget.
    pub const MAX_TRIANGLES: u32 = 1_000_000;

    /// Checks every range.
    ///
    /// # Errors
    /// The first [`ParamsError::OutOfRange`] found.
    pub fn validate(&self) -> Result<(), ParamsError> {
        let check = |name, is_good, expected, got| match is_good {
            true => Ok(()),
            false => Err(ParamsError::OutOfRange { name, expected, got }),
        };
        let Self {
            tolerance_px,
            max_triangles,
            keep_rejected: _,
            max_disparity_step_px,
            min_valid_share,
        } = *self;
        check(
            "tolerance_px",
            (0.1..=64.0).contains(&tolerance_px),
            "0.1 to 64",
            tolerance_px.into(),
        )?;
        check(
            "max_triangles",
            (Self::MIN_TRIANGLES..=Self::MAX_TRIANGLES).contains(&max_triangles),
            "100 to 1000000",
            max_triangles.into(),
        )?;
        check(
            "max_disparity_step_px",
            (0.5..=64.0).contains(&max_disparity_step_px),
            "0.5 to 64",
            max_disparity_step_px.into(),
        )?;
        check(
            "min_valid_share",
            (0.0..=1.0).contains(&min_valid_share),
            "0 to 1",
            min_valid_share.into(),
        )
    }
}

impl Default for MeshParams {
    fn default() -> Self {
        Self {
            tolerance_px: 1.0,
            max_triangles: 20_000,
            keep_rejected: false,
            max_disparity_step_px: 4.0,
            min_valid_share: 0.5,
        }
    }
}

/// A vertex in the left view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vertex {
    /// Column in px, pixel centres at whole numbers.
    pub u: f32,
    /// Row in px.
    pub v: f32,
    /// Disparity in px.
    pub disparity: f32,
}

/// A triangle mesh over the left view. Triangles are counter-clockwise as seen by the camera with y up, that is
/// clockwise in pixel coordinates with y down: `(b - a) x (c - a) < 0`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// The vertices; each is used by at least one triangle.
    pub vertices: Vec<Vertex>,
    /// Three indices into `vertices` a triangle.
    pub triangles: Vec<[u32; 3]>,
}
