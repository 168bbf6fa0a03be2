//! The mesh as points in space, for the 3D file formats.
//!
//! With calibration: metres in the left camera's frame, x right, y down, z forward. Without: columns and rows in
//! pixels and `z = -disparity`, which has the same handedness and keeps near things near, so that nothing opens
//! mirrored.

use stereo::{Mesh, Shape, Vertex};

use super::internal;
use crate::job::MatchedFrame;
use crate::status::ServiceError;

/// Points that exist, and the triangles between them.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Surface {
    /// Positions, all finite.
    pub(crate) points: Vec<[f32; 3]>,
    /// The same points in the left view: column and row in px, pixel centres at whole numbers.
    pub(crate) pixels: Vec<[f32; 2]>,
    /// The disparity of each of them in px.
    pub(crate) disparities_px: Vec<f32>,
    /// Three indices of `points` a triangle, counter-clockwise as seen by the camera.
    pub(crate) triangles: Vec<[u32; 3]>,
}

impl Surface {
    /// The frame's mesh without the vertices at or behind infinity and their triangles.
    pub(crate) fn new(frame: &MatchedFrame<'_>) -> Result<Self, ServiceError> {
        let mesh = frame
            .mesh
            .ok_or_else(|| internal("no mesh was made for a body that needs one"))?;
        let calibration = frame.request.calibration.as_ref();
        Ok(Self::place(mesh, |vertex| match calibration {
            None => Some([vertex.u, vertex.v, -vertex.disparity]),
            Some(camera) => camera
                .point_m_from_pixel(vertex.u, vertex.v, vertex.disparity)
                .map(|p| p.map(narrow)),
        }))
    }

    /// The frame's surface as the file formats take it.
    pub(crate) fn as_file(&self, frame: &MatchedFrame<'_>) -> stereo_surface::Surface<'_> {
        stereo_surface::Surface {
            points: &self.points,
            triangles: &self.triangles,
            is_metric: frame.request.calibration.is_some(),
            generator: concat!("stereod ", env!("CARGO_PKG_VERSION")),
        }
    }

    /// Texture coordinates in an image of `shape`: 0 to 1 from the left and from the top edge; a pixel's centre is
    /// half a pixel from its edges.
    pub(crate) fn uvs(&self, shape: Shape) -> Vec<[f32; 2]> {
        // Sides are at most 4096 px, so they are exact.
        let side = |px: usize| f32::from(u16::try_from(px).unwrap_or(u16::MAX));
        let (width, height) = (side(shape.width_px()), side(shape.height_px()));
        self.pixels
            .iter()
            .map(|[u, v]| [(u + 0.5) / width, (v + 0.5) / height])
            .collect()
    }

    fn place(mesh: &Mesh, position: impl Fn(&Vertex) -> Option<[f32; 3]>) -> Self {
        let mut surface = Self::default();
        let placed: Vec<Option<u32>> = mesh
            .vertices
            .iter()
            .map(|vertex| {
                let point = position(vertex).filter(|p| p.iter().all(|x| x.is_finite()))?;
                let index = u32::try_from(surface.points.len()).ok()?;
                surface.points.push(point);
                surface.pixels.push([vertex.u, vertex.v]);
                surface.disparities_px.push(vertex.disparity);
                Some(index)
            })
            .collect();
        let index = |i: u32| placed.get(i as usize).copied().flatten();
        surface.triangles.extend(
            mesh.triangles
                .iter()
                .filter_map(|&[a, b, c]| Some([index(a)?, index(b)?, index(c)?])),
        );
        surface
    }
}

/// Files hold 32-bit floats; what they can't hold becomes infinite and is left out.
#[expect(
    clippy::cast_possible_truncation,
    reason = "rounding to the nearest f32 is what is wanted"
)]
fn narrow(x: f64) -> f32 {
    x as f32
}

#[cfg(test)]
mod tests {
    use stereo::{Mesh, Vertex};

    use super::Surface;

    #[test]
    fn vertices_at_infinity_go_with_their_triangles_and_the_rest_is_renumbered() {
        let vertex = |u: f32, disparity: f32| Vertex { u, v: 1.0, disparity };
        let mesh = Mesh {
            vertices: vec![
                vertex(0.0, 5.0),
                vertex(1.0, 0.0),
                vertex(2.0, 5.0),
                vertex(3.0, 5.0),
            ],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        let surface = Surface::place(&mesh, |v| {
            (v.disparity > 0.0).then(|| [v.u, v.v, 1.0 / v.disparity])
        });
        assert_eq!(surface.pixels, [[0.0, 1.0], [2.0, 1.0], [3.0, 1.0]]);
        assert_eq!(surface.triangles, [[0, 1, 2]]);
        let none = Surface::place(&mesh, |_| Some([f32::INFINITY; 3]));
        assert_eq!(none, Surface::default());
    }
}
