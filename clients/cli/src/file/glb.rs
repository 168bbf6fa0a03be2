//! The mesh as binary glTF 2.0, textured with the left image: x right, y up, -z forward, in metres; without a calibration 1 mm a pixel.

use serde_json::{Value, json};
use stereo_client::v1::{Image, ImageEncoding};

use super::surface::Surface;
use crate::failure::Failure;

/// Metres that stand for a pixel where nothing is known about the camera.
const UNCALIBRATED_M_PER_PX: f32 = 0.001;
/// glTF's numbers for component types, buffer targets and filters.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;
const LINEAR: u32 = 9729;
const LINEAR_MIPMAP_LINEAR: u32 = 9987;

/// An empty mesh is a file with an empty node.
pub(super) fn encode(surface: &Surface, left: &Image) -> Result<Vec<u8>, Failure> {
    let mut root = json!({
        "asset": { "version": "2.0", "generator": concat!("stereo ", env!("CARGO_PKG_VERSION")) },
        "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "name": "left view" }],
    });
    let mut binary = Vec::new();
    if !surface.triangles.is_empty() {
        binary = describe(&mut root, surface, left);
    }
    container(&root, &binary)
}

/// Adds mesh, material and texture to `root`: their bytes.
fn describe(root: &mut Value, surface: &Surface, left: &Image) -> Vec<u8> {
    let scale = if surface.is_metric {
        1.0
    } else {
        UNCALIBRATED_M_PER_PX
    };
    let positions: Vec<[f32; 3]> = surface
        .points
        .iter()
        .map(|&[x, y, z]| [scale * x, -scale * y, -scale * z])
        .collect();
    let bound = |keep: fn(f32, f32) -> f32| {
        let both = |a: [f32; 3], b: [f32; 3]| std::array::from_fn(|i| keep(a[i], b[i]));
        positions.iter().copied().reduce(both)
    };
    let mime_type = match left.encoding() {
        ImageEncoding::Jpeg => "image/jpeg",
        _ => "image/png",
    };
    let numbers =
        |values: &[f32]| -> Vec<u8> { values.iter().flat_map(|value| value.to_le_bytes()).collect() };
    let indices = surface.triangles.as_flattened().iter();
    let parts = [
        (numbers(positions.as_flattened()), Some(ARRAY_BUFFER)),
        (numbers(surface.uvs.as_flattened()), Some(ARRAY_BUFFER)),
        (
            indices.flat_map(|index| index.to_le_bytes()).collect(),
            Some(ELEMENT_ARRAY_BUFFER),
        ),
        (left.data.to_vec(), None),
    ];
    let mut binary = Vec::new();
    let views = parts.map(|(part, target)| {
        let mut view = json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": part.len() });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        binary.extend(part);
        binary.resize(binary.len().next_multiple_of(4), 0);
        view
    });
    root["extensionsUsed"] = json!(["KHR_materials_unlit"]);
    root["nodes"][0]["mesh"] = json!(0);
    root["meshes"] = json!([{
        "name": "surface",
        "primitives": [{ "attributes": { "POSITION": 0, "TEXCOORD_0": 1 }, "indices": 2, "material": 0 }],
    }]);
    root["materials"] = json!([{
        "doubleSided": true,
        "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "metallicFactor": 0.0, "roughnessFactor": 1.0 },
        "extensions": { "KHR_materials_unlit": {} },
    }]);
    root["textures"] = json!([{ "source": 0, "sampler": 0 }]);
    root["samplers"] = json!([{ "magFilter": LINEAR, "minFilter": LINEAR_MIPMAP_LINEAR }]);
    root["images"] = json!([{ "bufferView": 3, "mimeType": mime_type }]);
    let count = positions.len();
    root["accessors"] = json!([
        {
            "bufferView": 0, "componentType": FLOAT, "type": "VEC3", "count": count,
            "min": bound(f32::min), "max": bound(f32::max),
        },
        { "bufferView": 1, "componentType": FLOAT, "type": "VEC2", "count": count },
        { "bufferView": 2, "componentType": UNSIGNED_INT, "type": "SCALAR", "count": 3 * surface.triangles.len() },
    ]);
    root["bufferViews"] = json!(views);
    root["buffers"] = json!([{ "byteLength": binary.len() }]);
    binary
}

/// Header, JSON chunk padded with spaces, binary chunk if there is one.
fn container(root: &Value, binary: &[u8]) -> Result<Vec<u8>, Failure> {
    let mut text = root.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let chunks: &[(&[u8; 4], &[u8])] = match binary {
        [] => &[(b"JSON", &text)],
        _ => &[(b"JSON", &text), (b"BIN\0", binary)],
    };
    let word = |n: usize| {
        u32::try_from(n)
            .map(u32::to_le_bytes)
            .map_err(|_| Failure::failed("a GLB can't be over 4 GB: ask for fewer triangles"))
    };
    let length = 12 + chunks.iter().map(|(_, data)| 8 + data.len()).sum::<usize>();
    let mut file = b"glTF\x02\0\0\0".to_vec();
    file.extend(word(length)?);
    for (kind, data) in chunks {
        file.extend(word(data.len())?);
        file.extend(*kind);
        file.extend(*data);
    }
    Ok(file)
}
