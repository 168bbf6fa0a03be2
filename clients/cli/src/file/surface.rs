//! The mesh of a result as points in space, and as a file.

use stereo_client::v1::{Image, ImageEncoding, MeshSpace, StereoResult};
use stereo_surface::Texture;

use super::missing;
use crate::failure::Failure;

/// A mesh whose vertices are all finite: x right, y down, z forward in metres; in pixels with the disparity negated without a
/// calibration, so that nothing opens mirrored.
#[derive(Debug)]
pub(super) struct Surface {
    pub(super) points: Vec<[f32; 3]>,
    /// Places in the left image, 0 to 1 from its left edge and from its top edge.
    pub(super) uvs: Vec<[f32; 2]>,
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) is_metric: bool,
}

impl Surface {
    pub(super) fn of(result: &StereoResult) -> Result<Self, Failure> {
        let mesh = result.mesh.as_ref().ok_or_else(|| missing("mesh", result))?;
        let is_metric = mesh.space() == MeshSpace::Metres;
        let sent: Vec<[f32; 3]> = triples(&mesh.positions)
            .map(|p| p.map(f32::from_le_bytes))
            .collect();
        let uvs: Vec<[f32; 2]> = mesh
            .uvs
            .as_chunks::<8>()
            .0
            .iter()
            .map(|&[a, b, c, d, e, f, g, h]| [[a, b, c, d], [e, f, g, h]].map(f32::from_le_bytes))
            .collect();
        let mut surface = Self {
            points: Vec::with_capacity(sent.len()),
            uvs: Vec::with_capacity(sent.len()),
            triangles: Vec::new(),
            is_metric,
        };
        let placed: Vec<Option<u32>> = sent
            .iter()
            .zip(&uvs)
            .map(|(&[x, y, z], &uv)| {
                let point = [x, y, if is_metric { z } else { -z }];
                let index = u32::try_from(surface.points.len()).ok()?;
                point.iter().all(|x| x.is_finite()).then(|| {
                    surface.points.push(point);
                    surface.uvs.push(uv);
                    index
                })
            })
            .collect();
        let index = |i: u32| placed.get(i as usize).copied().flatten();
        surface.triangles = triples(&mesh.indices)
            .filter_map(|triangle| {
                let [a, b, c] = triangle.map(u32::from_le_bytes);
                Some([index(a)?, index(b)?, index(c)?])
            })
            .collect();
        Ok(surface)
    }

    fn as_file(&self) -> stereo_surface::Surface<'_> {
        stereo_surface::Surface {
            points: &self.points,
            triangles: &self.triangles,
            is_metric: self.is_metric,
            generator: concat!("stereo ", env!("CARGO_PKG_VERSION")),
        }
    }

    /// A GLB file, textured with the left image.
    pub(super) fn glb(&self, left: &Image) -> Result<Vec<u8>, Failure> {
        let texture = Texture {
            file: &left.data,
            media_type: match left.encoding() {
                ImageEncoding::Jpeg => "image/jpeg",
                _ => "image/png",
            },
            uvs: &self.uvs,
        };
        let file = self.as_file().glb(texture);
        file.map_err(|why| Failure::failed(format!("{why}: ask for fewer triangles")))
    }

    /// A PLY file with the left image's colours, if they can be read.
    pub(super) fn ply(&self, left: &Image) -> Vec<u8> {
        let picture = image::load_from_memory(&left.data)
            .ok()
            .map(image::DynamicImage::into_rgb8);
        let colors: Option<Vec<[u8; 3]>> = picture.map(|picture| {
            let color = |&[u, v]: &[f32; 2]| {
                let [x, y] = [(u, picture.width()), (v, picture.height())].map(|(at, side)| pixel(at, side));
                picture.get_pixel(x, y).0
            };
            self.uvs.iter().map(color).collect()
        });
        self.as_file().ply(colors.as_deref())
    }
}

/// The pixel at a place from 0 to 1 along a side.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "a side has some thousands of pixels at most, and the place is clamped to it"
)]
fn pixel(at: f32, side: u32) -> u32 {
    ((at * side as f32).max(0.0) as u32).min(side.saturating_sub(1))
}

/// Twelve bytes as three numbers of four.
fn triples(bytes: &[u8]) -> impl Iterator<Item = [[u8; 4]; 3]> {
    let triple =
        |&[a, b, c, d, e, f, g, h, i, j, k, l]: &[u8; 12]| [[a, b, c, d], [e, f, g, h], [i, j, k, l]];
    bytes.as_chunks::<12>().0.iter().map(triple)
}

#[cfg(test)]
mod tests {
    use stereo_client::v1::Mesh;

    use super::*;

    fn floats(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|value| value.to_le_bytes()).collect()
    }

    #[test]
    fn vertices_at_infinity_go_with_their_triangles() {
        let (far, uv) = ([f32::INFINITY, 0.0, f32::INFINITY], [0.5; 2]);
        let positions = [[0.0; 3], far, [1.0; 3], [2.0; 3]];
        let mesh = Mesh {
            space: MeshSpace::Metres.into(),
            positions: floats(positions.as_flattened()).into(),
            uvs: floats([uv; 4].as_flattened()).into(),
            indices: [0_u32, 1, 2, 0, 2, 3]
                .iter()
                .flat_map(|i| i.to_le_bytes())
                .collect::<Vec<_>>()
                .into(),
            ..Mesh::default()
        };
        let result = StereoResult {
            mesh: Some(mesh),
            ..StereoResult::default()
        };
        let surface = Surface::of(&result).unwrap();
        assert_eq!(surface.points, [[0.0; 3], [1.0; 3], [2.0; 3]]);
        assert_eq!(surface.triangles, [[0, 1, 2]]);
        assert!(Surface::of(&StereoResult::default()).is_err());
    }
}
