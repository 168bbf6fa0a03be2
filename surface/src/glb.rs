//! Binary glTF 2.0, textured with the left image.
//!
//! glTF's frame is x right, y up, -z forward, so y and z of the camera's frame change sign; two signs are a rotation, so triangles stay
//! counter-clockwise seen from the camera. Of metres, the unit is glTF's metre and the camera is at the origin. Of pixels, the node scales
//! them to 1 mm a pixel: an upright relief of the left view, near parts raised, instead of a model of several hundred metres.

use bytemuck::cast_slice;
use serde_json::{Value, json};

use crate::Surface;

/// Metres that stand for a pixel where nothing is known about the camera.
const UNCALIBRATED_M_PER_PX: f64 = 0.001;

/// glTF's numbers for component types, buffer targets, filters and wrapping.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;
const LINEAR: u32 = 9729;
const LINEAR_MIPMAP_LINEAR: u32 = 9987;
const CLAMP_TO_EDGE: u32 = 33071;

/// The left image, and where points are in it.
#[derive(Debug, Clone, Copy)]
pub struct Texture<'a> {
    /// The image as a file.
    pub file: &'a [u8],
    /// Its type: `image/png` or `image/jpeg`.
    pub media_type: &'a str,
    /// A place for each point: 0 to 1 from the image's left and top edge.
    pub uvs: &'a [[f32; 2]],
}

/// A GLB has 32 bits for its length.
#[derive(Debug, thiserror::Error)]
#[error("a GLB can't be over 4 GB")]
pub struct TooLarge;

impl Surface<'_> {
    /// A GLB file; an empty mesh is a file with an empty node.
    ///
    /// # Errors
    /// [`TooLarge`] if it had over 4 GB.
    pub fn glb(&self, texture: Texture<'_>) -> Result<Vec<u8>, TooLarge> {
        let mut root = json!({
            "asset": { "version": "2.0", "generator": self.generator },
            "scene": 0,
            "scenes": [{ "nodes": [0] }],
            "nodes": [{ "name": "left view" }],
        });
        if !self.is_metric {
            let scale = [UNCALIBRATED_M_PER_PX; 3];
            root["nodes"][0]["scale"] = json!(scale);
            root["nodes"][0]["extras"] = json!({ "units": "x and -y in px, z = disparity in px" });
        }
        let mut chunk = Chunk::default();
        if !self.triangles.is_empty() {
            self.describe(&mut root, &mut chunk, texture);
        }
        container(&root, &chunk.bytes)
    }

    /// Adds mesh, material and texture to `root`, and their bytes to `chunk`.
    fn describe(&self, root: &mut Value, chunk: &mut Chunk, texture: Texture<'_>) {
        let positions: Vec<[f32; 3]> = self.points.iter().map(|&[x, y, z]| [x, -y, -z]).collect();
        let bounds = |keep: fn(f32, f32) -> f32| {
            positions
                .iter()
                .copied()
                .reduce(|a, b| [keep(a[0], b[0]), keep(a[1], b[1]), keep(a[2], b[2])])
        };
        let views = [
            chunk.view(cast_slice(&positions), Some(ARRAY_BUFFER)),
            chunk.view(cast_slice(texture.uvs), Some(ARRAY_BUFFER)),
            chunk.view(cast_slice(self.triangles), Some(ELEMENT_ARRAY_BUFFER)),
            chunk.view(texture.file, None),
        ];
        root["extensionsUsed"] = json!(["KHR_materials_unlit"]);
        root["nodes"][0]["mesh"] = json!(0);
        root["meshes"] = json!([{
            "name": "surface",
            "primitives": [{ "attributes": { "POSITION": 0, "TEXCOORD_0": 1 }, "indices": 2, "material": 0 }],
        }]);
        root["materials"] = json!([{
            "name": "left image",
            "doubleSided": true,
            "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "metallicFactor": 0.0, "roughnessFactor": 1.0 },
            "extensions": { "KHR_materials_unlit": {} },
        }]);
        root["textures"] = json!([{ "source": 0, "sampler": 0 }]);
        root["samplers"] = json!([{
            "magFilter": LINEAR, "minFilter": LINEAR_MIPMAP_LINEAR, "wrapS": CLAMP_TO_EDGE, "wrapT": CLAMP_TO_EDGE,
        }]);
        root["images"] = json!([{ "bufferView": 3, "mimeType": texture.media_type }]);
        root["accessors"] = json!([
            {
                "bufferView": 0, "componentType": FLOAT, "type": "VEC3", "count": positions.len(),
                "min": bounds(f32::min), "max": bounds(f32::max),
            },
            { "bufferView": 1, "componentType": FLOAT, "type": "VEC2", "count": texture.uvs.len() },
            { "bufferView": 2, "componentType": UNSIGNED_INT, "type": "SCALAR", "count": self.triangles.len() * 3 },
        ]);
        root["bufferViews"] = json!(views);
        root["buffers"] = json!([{ "byteLength": chunk.bytes.len() }]);
    }
}

/// The binary chunk as it grows.
#[derive(Default)]
struct Chunk {
    bytes: Vec<u8>,
}

impl Chunk {
    /// Appends `part`, padded to the 4 bytes that glTF aligns to, and describes it.
    fn view(&mut self, part: &[u8], target: Option<u32>) -> Value {
        let mut view = json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": part.len() });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.bytes.extend_from_slice(part);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        view
    }
}

/// The GLB container: header, JSON chunk padded with spaces, binary chunk if there is one.
fn container(root: &Value, binary: &[u8]) -> Result<Vec<u8>, TooLarge> {
    let mut text = root.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let binary_length = if binary.is_empty() { 0 } else { 8 + binary.len() };
    let length = 12 + 8 + text.len() + binary_length;
    let word = |n: usize| u32::try_from(n).map(u32::to_le_bytes).map_err(|_| TooLarge);
    let mut file = Vec::with_capacity(length);
    file.extend_from_slice(b"glTF");
    file.extend_from_slice(&2_u32.to_le_bytes());
    file.extend_from_slice(&word(length)?);
    file.extend_from_slice(&word(text.len())?);
    file.extend_from_slice(b"JSON");
    file.extend_from_slice(&text);
    if !binary.is_empty() {
        file.extend_from_slice(&word(binary.len())?);
        file.extend_from_slice(b"BIN\0");
        file.extend_from_slice(binary);
    }
    Ok(file)
}
