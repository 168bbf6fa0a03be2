//! The Delaunay mesh over the support points (spade), grown in place from iteration to iteration.
//!
//! The window's four corners are vertices too, with the disparity of the nearest support, so that every pixel lies in a
//! triangle.

use std::ops::Range;

use spade::handles::FixedVertexHandle;
use spade::{DelaunayTriangulation, HasPosition, Point2, Triangulation as _};

use crate::mesh::Vertex;
use crate::support::Support;

/// Vertices 0 to 3 are the corners.
pub(crate) const CORNERS: usize = 4;

#[derive(Debug, Clone, Copy)]
struct Node {
    position: Point2<f64>,
    disparity_px: f32,
}

impl HasPosition for Node {
    type Scalar = f64;
    fn position(&self) -> Point2<f64> {
        self.position
    }
}

impl From<&Support> for Node {
    fn from(support: &Support) -> Self {
        let [x, y] = [support.x, support.y].map(|at| f64::from(u16::try_from(at).unwrap_or(u16::MAX)));
        Self {
            position: Point2::new(x, y),
            disparity_px: support.disparity_px,
        }
    }
}

/// Three vertices with the indices they have in the mesh.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Triangle {
    pub(crate) indices: [usize; 3],
    pub(crate) vertices: [Vertex; 3],
}

impl Triangle {
    /// Whether one of its vertices is a corner of the window, whose disparity is a guess.
    pub(crate) fn has_corner(&self) -> bool {
        self.indices.iter().any(|&index| index < CORNERS)
    }
}

/// The mesh of one frame.
#[derive(Debug, Default)]
pub(crate) struct Triangulation {
    mesh: DelaunayTriangulation<Node>,
}

impl Triangulation {
    /// The mesh of `supports`, in the order given, and the corners of a `width` x `height` window.
    pub(crate) fn rebuild(&mut self, supports: &[Support], width: usize, height: usize) {
        let corners =
            [(0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)].map(|(x, y)| Support {
                x,
                y,
                disparity_px: nearest_disparity_px(supports, x, y),
            });
        self.mesh.clear();
        let nodes: Vec<Node> = corners.iter().chain(supports).map(Node::from).collect();
        if let Ok(mesh) = DelaunayTriangulation::bulk_load_stable(nodes) {
            // Fails on coordinates that are no numbers only; ours are whole pixels.
            self.mesh = mesh;
        }
    }

    /// Adds supports; they should be in spatial order, each near the one before.
    pub(crate) fn insert(&mut self, supports: &[Support]) {
        for support in supports {
            let inserted = self.mesh.insert(Node::from(support));
            debug_assert!(inserted.is_ok(), "pixel coordinates are finite and small");
        }
    }

    /// Number of vertices, corners included.
    pub(crate) fn vertices(&self) -> usize {
        self.mesh.num_vertices()
    }

    /// Number of triangles.
    pub(crate) fn triangles(&self) -> usize {
        self.mesh.num_inner_faces()
    }

    /// The triangles with at least one vertex of index `first_new` or more.
    pub(crate) fn triangles_from(&self, first_new: usize) -> impl Iterator<Item = Triangle> + '_ {
        self.triangles_of(first_new, first_new..self.vertices())
    }

    /// Those of the triangles from vertex `first_new` on whose first new vertex is one of `vertices`. After insertions those are the ones that
    /// changed: every triangle that Delaunay insertion makes has the inserted point as a vertex. They come in the order of their
    /// first new vertices, so neighbours in it are neighbours in the image.
    pub(crate) fn triangles_of(
        &self,
        first_new: usize,
        vertices: Range<usize>,
    ) -> impl Iterator<Item = Triangle> + '_ {
        vertices.flat_map(move |index| {
            let vertex = self.mesh.vertex(FixedVertexHandle::from_index(index));
            vertex.out_edges().filter_map(move |edge| {
                let others = [edge.to(), edge.next().to()];
                let indices = others.map(|other| other.fix().index());
                let is_first = indices.iter().all(|&other| other < first_new || other > index);
                (is_first && !edge.is_outer_edge()).then(|| Triangle {
                    indices: [index, indices[0], indices[1]],
                    vertices: [vertex, others[0], others[1]].map(|vertex| to_vertex(vertex.data())),
                })
            })
        })
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "whole pixels below 2^24 are exact in f32"
)]
fn to_vertex(node: &Node) -> Vertex {
    Vertex {
        u: node.position.x as f32,
        v: node.position.y as f32,
        disparity: node.disparity_px,
    }
}

/// Zero without supports: a scene without texture is as good as infinitely far.
fn nearest_disparity_px(supports: &[Support], x: usize, y: usize) -> f32 {
    supports
        .iter()
        .min_by_key(|support| support.x.abs_diff(x).pow(2) + support.y.abs_diff(y).pow(2))
        .map_or(0.0, |support| support.disparity_px)
}

#[cfg(test)]
mod tests;
