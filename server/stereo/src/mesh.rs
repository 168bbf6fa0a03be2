//! The mesh that is sent: vertices in pixels and disparity, triangles as indices.

/// Which triangles a mesh keeps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeshParams {
    /// Keep triangles that span a depth discontinuity or failed validation as well.
    pub keep_rejected: bool,
    /// A triangle without texture, which can't be validated, spans a discontinuity if its vertex disparities differ by more
    /// than this, in px (0.5..=64).
    pub max_disparity_step_px: f32,
    /// A triangle with texture failed validation if less than this share of its textured pixels lies on it (0..=1).
    pub min_valid_share: f32,
}

impl Default for MeshParams {
    fn default() -> Self {
        Self {
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
