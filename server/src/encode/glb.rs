//! The mesh as binary glTF 2.0, textured with the left image.
//!
//! glTF's frame is x right, y up, -z forward, so y and z of the camera's frame change sign; two signs are a rotation,
//! so triangles stay counter-clockwise seen from the camera. With calibration the unit is glTF's metre and the camera
//! is at the origin. Without, positions are pixels and disparities (see `surface`) and the node scales them to 1 mm a
//! pixel: an upright relief of the left view, near parts raised, instead of a model of several hundred metres.

use bytemuck::cast_slice;
use png::{BitDepth, ColorType};
use serde_json::{Value, json};

use super::internal;
use super::png::Picture;
use super::surface::Surface;
use crate::decode::{self, Side};
use crate::job::{ImageEncoding, MatchedFrame, PixelFormat};
use crate::status::ServiceError;

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

/// The frame's mesh as a GLB file; an empty mesh is a file with an empty node.
pub(super) fn encode(frame: &MatchedFrame<'_>) -> Result<Vec<u8>, ServiceError> {
    let surface = Surface::new(frame)?;
    let calibrated = frame.request.calibration.is_some();
    let mut root = json!({
        "asset": { "version": "2.0", "generator": concat!("stereod ", env!("CARGO_PKG_VERSION")) },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "name": "left view" }],
    });
    if !calibrated {
        root["nodes"][0]["scale"] = json!([
            UNCALIBRATED_M_PER_PX,
            UNCALIBRATED_M_PER_PX,
            UNCALIBRATED_M_PER_PX
        ]);
        root["nodes"][0]["extras"] = json!({ "units": "x and -y in px, z = disparity in px" });
    }
    let mut chunk = Chunk::default();
    if !surface.triangles.is_empty() {
        describe(&mut root, &mut chunk, &surface, frame)?;
    }
    container(&root, &chunk.bytes)
}

/// Adds mesh, material and texture to `root`, and their bytes to `chunk`.
fn describe(
    root: &mut Value,
    chunk: &mut Chunk,
    surface: &Surface,
    frame: &MatchedFrame<'_>,
) -> Result<(), ServiceError> {
    let positions: Vec<[f32; 3]> = surface.points.iter().map(|&[x, y, z]| [x, -y, -z]).collect();
    let uvs = surface.uvs(frame.map.shape());
    let (image, mime_type) = texture(frame)?;
    let bounds = |keep: fn(f32, f32) -> f32| {
        positions
            .iter()
            .copied()
            .reduce(|a, b| [keep(a[0], b[0]), keep(a[1], b[1]), keep(a[2], b[2])])
    };
    let views = [
        chunk.view(cast_slice(&positions), Some(ARRAY_BUFFER)),
        chunk.view(cast_slice(&uvs), Some(ARRAY_BUFFER)),
        chunk.view(cast_slice(&surface.triangles), Some(ELEMENT_ARRAY_BUFFER)),
        chunk.view(&image, None),
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
    root["images"] = json!([{ "bufferView": 3, "mimeType": mime_type }]);
    root["accessors"] = json!([
        {
            "bufferView": 0, "componentType": FLOAT, "type": "VEC3", "count": positions.len(),
            "min": bounds(f32::min), "max": bounds(f32::max),
        },
        { "bufferView": 1, "componentType": FLOAT, "type": "VEC2", "count": uvs.len() },
        { "bufferView": 2, "componentType": UNSIGNED_INT, "type": "SCALAR", "count": surface.triangles.len() * 3 },
    ]);
    root["bufferViews"] = json!(views);
    root["buffers"] = json!([{ "byteLength": chunk.bytes.len() }]);
    Ok(())
}

/// The left image as a file and its type: as it came if it was a file, else as a PNG.
fn texture(frame: &MatchedFrame<'_>) -> Result<(Vec<u8>, &'static str), ServiceError> {
    let left = &frame.request.left;
    let (pixels, color) = match left.encoding {
        ImageEncoding::Png => return Ok((left.data.to_vec(), "image/png")),
        ImageEncoding::Jpeg => return Ok((left.data.to_vec(), "image/jpeg")),
        ImageEncoding::Raw(PixelFormat::Mono8 | PixelFormat::Mono16) => {
            let gray = frame.left_gray;
            let rows: Vec<&[u8]> = (0..gray.height_px()).map(|y| gray.row(y)).collect();
            (rows.concat(), ColorType::Grayscale)
        }
        ImageEncoding::Raw(_) => (decode::color(Side::Left, left)?.rgb, ColorType::Rgb),
    };
    let picture = Picture {
        width_px: frame.left_gray.width_px(),
        height_px: frame.left_gray.height_px(),
        color,
        depth: BitDepth::Eight,
    };
    Ok((picture.write(&pixels)?, "image/png"))
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
fn container(root: &Value, binary: &[u8]) -> Result<Vec<u8>, ServiceError> {
    let mut text = serde_json::to_vec(root).map_err(|why| internal(&format!("writing a GLB: {why}")))?;
    text.resize(text.len().next_multiple_of(4), b' ');
    let binary_length = if binary.is_empty() { 0 } else { 8 + binary.len() };
    let length = 12 + 8 + text.len() + binary_length;
    let word = |n: usize| {
        u32::try_from(n)
            .map(u32::to_le_bytes)
            .map_err(|_| internal("a GLB is over 4 GB"))
    };
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

#[cfg(test)]
mod tests;
