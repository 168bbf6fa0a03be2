//! Textured meshes as files that other programs open: binary glTF 2.0 and PLY. Whoever has the mesh places its points; only the formats
//! are known here.
#![forbid(unsafe_code)]

mod glb;
mod ply;

pub use glb::{Texture, TooLarge};

/// A mesh over the left image, whose points are all finite.
#[derive(Debug, Clone, Copy)]
pub struct Surface<'a> {
    /// In metres in the left camera's frame (x right, y down, z forward), or, without a calibration, column and row in pixels and the
    /// disparity negated, which has the same handedness and keeps near things near, so that nothing opens mirrored.
    pub points: &'a [[f32; 3]],
    /// Three indices of `points` a triangle, counter-clockwise as seen by the camera.
    pub triangles: &'a [[u32; 3]],
    /// Whether `points` are metres.
    pub is_metric: bool,
    /// Who makes the file: a name and a version.
    pub generator: &'a str,
}
