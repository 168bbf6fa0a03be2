//! Binary little-endian PLY, with the left image's colours where there are some.

use crate::Surface;

const VERTEX_BYTES: usize = 3 * 4 + 3;
const FACE_BYTES: usize = 1 + 3 * 4;

impl Surface<'_> {
    /// A PLY file; `colors` has red, green and blue of each point.
    #[must_use]
    pub fn ply(&self, colors: Option<&[[u8; 3]]>) -> Vec<u8> {
        let (vertices, faces) = (self.points.len(), self.triangles.len());
        let space = match self.is_metric {
            true => "metres in the left camera's frame: x right, y down, z forward",
            false => "not calibrated: x = column and y = row in px, z = -disparity in px",
        };
        let properties = match colors {
            Some(_) => "property uchar red\nproperty uchar green\nproperty uchar blue\n",
            None => "",
        };
        let header = format!(
            "ply\nformat binary_little_endian 1.0\ncomment {}\ncomment {space}\n\
             element vertex {vertices}\n\
             property float x\nproperty float y\nproperty float z\n\
             {properties}\
             element face {faces}\nproperty list uchar int vertex_indices\nend_header\n",
            self.generator,
        );
        let mut file = Vec::with_capacity(header.len() + vertices * VERTEX_BYTES + faces * FACE_BYTES);
        file.extend_from_slice(header.as_bytes());
        for (i, point) in self.points.iter().enumerate() {
            file.extend_from_slice(point.map(f32::to_le_bytes).as_flattened());
            if let Some(colors) = colors {
                file.extend_from_slice(&colors.get(i).copied().unwrap_or_default());
            }
        }
        for triangle in self.triangles {
            file.push(3);
            file.extend_from_slice(triangle.map(u32::to_le_bytes).as_flattened());
        }
        file
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_colours_there_is_none_in_the_header_and_none_in_the_body() {
        let surface = Surface {
            points: &[[1.0, 2.0, 3.0]],
            triangles: &[[0, 0, 0]],
            is_metric: true,
            generator: "test",
        };
        let file = surface.ply(None);
        let text = String::from_utf8_lossy(&file);
        assert!(text.starts_with("ply\nformat binary_little_endian 1.0\ncomment test\ncomment metres"));
        assert!(!text.contains("red"));
        assert!(file.ends_with(&[&[3][..], &[0; 12]].concat()));
        let colored = surface.ply(Some(&[[7, 8, 9]]));
        assert_eq!(
            colored.len(),
            file.len() + 3 + "property uchar red\nproperty uchar green\nproperty uchar blue\n".len()
        );
    }
}
