"""Results as files."""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from ._schema import IMAGE_ENCODING
from .errors import InputError

if TYPE_CHECKING:
    from .result import Result

What: TypeAlias = Literal["disparity", "depth", "confidence", "color", "mesh", "points"]

_Array: TypeAlias = "np.ndarray[Any, Any]"


def save(result: Result, path: str | os.PathLike[str], what: What | None) -> None:
    """Write what of a result the path's suffix says; see `Result.save`."""
    path = Path(path)
    formats: dict[str, tuple[Callable[[Result, str], bytes], tuple[str, ...]]] = {
        ".png": (_png_of, ("disparity", "depth", "confidence", "color")),
        ".pfm": (_pfm_of, ("disparity", "depth")),
        ".npy": (_npy_of, ("disparity", "depth", "confidence")),
        ".npz": (_npz_of, ("everything",)),
        ".ply": (_ply_of, ("mesh", "points")),
        ".glb": (_glb_of, ("mesh",)),
    }
    if path.suffix.lower() not in formats:
        raise InputError(f"{path} has no suffix that says how to write it: use one of {', '.join(formats)}")
    write, choices = formats[path.suffix.lower()]
    if (what or choices[0]) not in choices:
        raise InputError(f"{path.suffix} files can't hold {what}: they hold {', '.join(choices)}")
    data = write(result, what or choices[0])
    # Renamed into place, so that nobody ever finds half a file.
    partial = path.with_name(path.name + ".part")
    partial.write_bytes(data)
    partial.replace(path)


def png(pixels: _Array) -> bytes:
    """Return (height, width) of uint8 or uint16, or (height, width, 3) of uint8, as a PNG file."""
    height, width = pixels.shape[:2]
    depth, color = pixels.dtype.itemsize * 8, 2 if pixels.ndim == 3 else 0
    body = pixels.astype(pixels.dtype.newbyteorder(">")).reshape(height, -1).view(np.uint8)
    # Filter "up": each row less the one above, which smooth maps compress well with.
    differences = np.diff(body, axis=0, prepend=np.zeros((1, body.shape[1]), np.uint8))
    filtered = np.concatenate([np.full((height, 1), 2, np.uint8), differences], axis=1)
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, 0)),
        (b"IDAT", zlib.compress(filtered.tobytes(), 6)),
        (b"IEND", b""),
    )
    parts = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def _fixed(values: _Array, per_unit: float) -> _Array:
    """Return numbers in fixed point, 0 = invalid; a valid one is at least 1."""
    fixed = np.nan_to_num(np.rint(values * per_unit), nan=0).clip(0, 65535).astype(np.uint16)
    fixed[np.isfinite(values) & (fixed == 0)] = 1
    return fixed


def _png_of(result: Result, what: str) -> bytes:
    if what == "color":
        return png(result.colorize())
    if what == "confidence":
        return png(result.confidence)
    return png(_fixed(result.disparity, 256) if what == "disparity" else _fixed(result.depth_m, 1000))


def _map(result: Result, what: str) -> _Array:
    if what == "disparity":
        return result.disparity
    return result.depth_m if what == "depth" else result.confidence


def _pfm_of(result: Result, what: str) -> bytes:
    """Rows from bottom to top, invalid = infinity, as Middlebury has it."""
    values = np.nan_to_num(_map(result, what), nan=np.inf, posinf=np.inf)
    head = f"Pf\n{values.shape[1]} {values.shape[0]}\n-1.0\n".encode()
    return head + values[::-1].astype("<f4").tobytes()


def _npy_of(result: Result, what: str) -> bytes:
    file = BytesIO()
    np.save(file, _map(result, what), allow_pickle=False)
    return file.getvalue()


def _npz_of(result: Result, _what: str) -> bytes:
    arrays: dict[str, _Array] = {name: _map(result, name) for name in ("disparity", "confidence") if result.has(name)}
    if result.calibration is not None:
        arrays["depth_m"] = result.depth_m
    if result.has("mesh"):
        mesh = result.mesh
        arrays |= {"mesh_positions": mesh.positions, "mesh_triangles": mesh.triangles, "mesh_uvs": mesh.uvs}
    file = BytesIO()
    # Its types take an array's name for the parameter of newer versions.
    write: Any = np.savez_compressed
    write(file, **arrays)
    return file.getvalue()


def _placed(result: Result) -> tuple[_Array, _Array]:
    """Return finite positions and triangles between them; in pixels, with the disparity negated so that nothing is mirrored."""
    mesh = result.mesh
    positions = mesh.positions if mesh.is_metric else mesh.positions * np.array([1, 1, -1], np.float32)
    is_there = np.asarray(np.isfinite(positions).all(axis=1))
    triangles = mesh.triangles[is_there[mesh.triangles].all(axis=1)] if len(mesh.triangles) else mesh.triangles
    return np.where(is_there[:, None], positions, 0).astype("<f4"), triangles.astype("<u4")


def vertex_colors(result: Result) -> _Array | None:
    """Return the colour of each vertex of the mesh, where it is known: as sent, or of the left image."""
    mesh, picture = result.mesh, result.left_rgb
    if mesh.colors is not None or picture is None:
        return mesh.colors
    height, width = picture.shape[:2]
    x, y = (mesh.uvs * np.array([width, height], np.float32)).astype(int).T
    sampled: _Array = picture[y.clip(0, height - 1), x.clip(0, width - 1)]
    return sampled


def _ply_of(result: Result, what: str) -> bytes:
    if what == "points":
        positions, colors, triangles = result.points.positions.astype("<f4"), result.points.colors, None
    else:
        positions, triangles = _placed(result)
        colors = vertex_colors(result)
    fields: list[tuple[str, Any]] = [(axis, "<f4") for axis in "xyz"]
    if colors is not None:
        fields += [(name, "u1") for name in ("red", "green", "blue")]
    vertices = np.zeros(len(positions), fields)
    for i, axis in enumerate("xyz"):
        vertices[axis] = positions[:, i]
    if colors is not None:
        for i, name in enumerate(("red", "green", "blue")):
            vertices[name] = colors[:, i]
    names = {"<f4": "float", "u1": "uchar"}
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    head += [f"property {names[kind]} {name}" for name, kind in fields]
    body = vertices.tobytes()
    if triangles is not None:
        head += [f"element face {len(triangles)}", "property list uchar uint vertex_indices"]
        faces = np.zeros(len(triangles), [("count", "u1"), ("corners", "<u4", 3)])
        faces["count"], faces["corners"] = 3, triangles
        body += faces.tobytes()
    return "\n".join([*head, "end_header\n"]).encode() + body


def _texture(result: Result) -> tuple[bytes, str] | None:
    """Return the left image as a file and its type, as it came if it was a file."""
    left = result._left
    if left is None:
        return None
    encoding = IMAGE_ENCODING.name[left.encoding]
    if encoding in ("png", "jpeg"):
        return left.data, f"image/{encoding}"
    picture = result.left_rgb
    return None if picture is None else (png(picture), "image/png")


def _glb_of(result: Result, _what: str) -> bytes:
    """Binary glTF 2.0: x right, y up, -z forward, in metres; without a calibration 1 mm a pixel, as the service's own."""
    positions, triangles = _placed(result)
    scale = 1.0 if result.mesh.is_metric else 0.001
    positions = positions * np.array([scale, -scale, -scale], np.float32)
    views: list[dict[str, Any]] = []
    chunk = bytearray()

    def view(data: bytes, target: int | None) -> int:
        views.append(
            {"buffer": 0, "byteOffset": len(chunk), "byteLength": len(data)} | ({"target": target} if target else {})
        )
        chunk.extend(data + bytes(-len(data) % 4))
        return len(views) - 1

    root: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "stereo-client"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
    }
    root["nodes"] = [{"name": "left view"}]
    if len(triangles):
        float32, uint32, vertex_buffer, index_buffer = 5126, 5125, 34962, 34963
        bounds = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
        count = len(positions)
        root["accessors"] = [
            {
                "bufferView": view(positions.astype("<f4").tobytes(), vertex_buffer),
                "componentType": float32,
                "type": "VEC3",
                "count": count,
            }
            | bounds,
            {
                "bufferView": view(triangles.tobytes(), index_buffer),
                "componentType": uint32,
                "type": "SCALAR",
                "count": triangles.size,
            },
            {
                "bufferView": view(result.mesh.uvs.astype("<f4").tobytes(), vertex_buffer),
                "componentType": float32,
                "type": "VEC2",
                "count": count,
            },
        ]
        material: dict[str, Any] = {"doubleSided": True, "extensions": {"KHR_materials_unlit": {}}}
        material["pbrMetallicRoughness"] = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
        texture = _texture(result)
        if texture is not None:
            data, mime_type = texture
            root["images"] = [{"bufferView": view(data, None), "mimeType": mime_type}]
            root["samplers"] = [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}]
            root["textures"] = [{"source": 0, "sampler": 0}]
            material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
        root["extensionsUsed"] = ["KHR_materials_unlit"]
        root["materials"] = [material]
        attributes = {"POSITION": 0, "TEXCOORD_0": 2}
        root["meshes"] = [{"name": "surface", "primitives": [{"attributes": attributes, "indices": 1, "material": 0}]}]
        root["nodes"][0]["mesh"] = 0
        root["bufferViews"], root["buffers"] = views, [{"byteLength": len(chunk)}]
    text = json.dumps(root).encode()
    text += b" " * (-len(text) % 4)
    parts = struct.pack("<I4s", len(text), b"JSON") + text
    if chunk:
        parts += struct.pack("<I4s", len(chunk), b"BIN\0") + chunk
    return struct.pack("<4sII", b"glTF", 2, 12 + len(parts)) + parts
