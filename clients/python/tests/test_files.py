"""Results as files and pictures."""

from __future__ import annotations

import io
import json
import struct

import numpy as np
import PIL.Image
import pytest
from scene import CALIBRATION, Scene

from stereo_client import Client, InputError, Result
from stereo_client.colors import scale
from stereo_client.files import png


@pytest.fixture
def result(client: Client, scene: Scene) -> Result:
    return client.match(scene.left, scene.right, budget_ms=5000, calibration=CALIBRATION)


def test_png_is_kittis_and_reads_back(result: Result, tmp_path):
    result.save(tmp_path / "d.png")
    fixed = np.asarray(PIL.Image.open(tmp_path / "d.png"))
    np.testing.assert_array_equal(fixed, np.nan_to_num(result.disparity * 256, nan=0).astype(np.uint16))
    result.save(tmp_path / "z.png", "depth")
    depth_mm = np.asarray(PIL.Image.open(tmp_path / "z.png"))
    np.testing.assert_allclose(depth_mm, np.nan_to_num(result.depth_m * 1000, nan=0), atol=0.5)
    result.save(tmp_path / "c.png", "confidence")
    np.testing.assert_array_equal(np.asarray(PIL.Image.open(tmp_path / "c.png")), result.confidence)


@pytest.mark.parametrize(
    ("shape", "dtype"), [((5, 7), np.uint8), ((3, 4), np.uint16), ((1, 1, 3), np.uint8), ((9, 2, 3), np.uint8)]
)
def test_any_picture_is_a_png(shape, dtype):
    pixels = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, shape, dtype)
    np.testing.assert_array_equal(np.asarray(PIL.Image.open(io.BytesIO(png(pixels)))), pixels)


def test_arrays_read_back(result: Result, tmp_path):
    result.save(tmp_path / "d.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "d.npy"), result.disparity)
    result.save(tmp_path / "all.npz")
    with np.load(tmp_path / "all.npz") as arrays:
        assert set(arrays) == {"disparity", "confidence", "depth_m", "mesh_positions", "mesh_triangles", "mesh_uvs"}
        np.testing.assert_array_equal(arrays["depth_m"], result.depth_m)
    result.save(tmp_path / "d.pfm")
    head, size, _, body = (tmp_path / "d.pfm").read_bytes().split(b"\n", 3)
    assert (head, size) == (b"Pf", b"320 240")
    values = np.frombuffer(body, "<f4").reshape(240, 320)[::-1]
    np.testing.assert_array_equal(values, np.nan_to_num(result.disparity, nan=np.inf))


def test_ply_has_every_vertex_and_triangle(result: Result, tmp_path):
    result.save(tmp_path / "m.ply")
    head, body = (tmp_path / "m.ply").read_bytes().split(b"end_header\n")
    vertices, triangles = len(result.mesh.positions), len(result.mesh.triangles)
    assert f"element vertex {vertices}\n".encode() in head
    assert b"property uchar red" in head
    assert len(body) == vertices * 15 + triangles * 13
    np.testing.assert_array_equal(np.frombuffer(body[:12], "<f4"), result.mesh.positions[0])
    result.save(tmp_path / "p.ply", "points")
    head, body = (tmp_path / "p.ply").read_bytes().split(b"end_header\n")
    assert b"element face" not in head
    assert len(body) == len(result.points.positions) * 15


@pytest.mark.parametrize("calibration", [CALIBRATION, None])
def test_glb_is_whole_textured_and_upright(client: Client, scene: Scene, tmp_path, calibration):
    result = client.match(scene.left, scene.right, budget_ms=5000, calibration=calibration)
    result.save(tmp_path / "m.glb")
    file = (tmp_path / "m.glb").read_bytes()
    magic, version, length, json_length, kind = struct.unpack_from("<4sIII4s", file)
    assert (magic, version, length, kind) == (b"glTF", 2, len(file), b"JSON")
    root = json.loads(file[20 : 20 + json_length])
    binary = file[28 + json_length :]
    assert len(binary) == root["buffers"][0]["byteLength"]

    def view(number: int) -> bytes:
        entry = root["bufferViews"][number]
        return binary[entry["byteOffset"] :][: entry["byteLength"]]

    positions = np.frombuffer(view(0), "<f4").reshape(-1, 3)
    assert len(positions) == root["accessors"][0]["count"]
    np.testing.assert_allclose(positions.min(axis=0), root["accessors"][0]["min"], rtol=1e-6)
    assert np.frombuffer(view(1), "<u4").max() < len(positions)
    if calibration:
        np.testing.assert_array_equal(positions, result.mesh.positions * np.array([1, -1, -1], np.float32))
    else:
        # Upright, and near is towards the viewer.
        np.testing.assert_allclose(
            positions, result.mesh.positions * np.array([0.001, -0.001, 0.001], np.float32), rtol=1e-6
        )
    texture = PIL.Image.open(io.BytesIO(view(root["images"][0]["bufferView"])))
    np.testing.assert_array_equal(np.asarray(texture.convert("L")), scene.left)


def test_colours_are_ordered_and_invalid_is_black(result: Result, tmp_path):
    picture = result.colorize()
    assert picture.shape == (240, 320, 3)
    assert (picture[np.isnan(result.disparity)] == 0).all()
    luminance = picture.astype(float) @ [0.2126, 0.7152, 0.0722]
    near, far = (np.nanmedian(luminance[result.disparity.round() == px]) for px in (24, 8))
    assert near > 2 * far
    assert (np.diff(scale().astype(float) @ [0.2126, 0.7152, 0.0722]) > -1.0).all()
    np.testing.assert_array_equal(result.colorize(near=1000, far=999)[np.isfinite(result.disparity)][0], scale()[0])
    result.save(tmp_path / "c.png", "color")
    np.testing.assert_array_equal(np.asarray(PIL.Image.open(tmp_path / "c.png")), picture)


def test_a_file_that_can_not_be_written_so_says_what_can(result: Result, tmp_path):
    with pytest.raises(InputError, match=r"use one of \.png, \.pfm"):
        result.save(tmp_path / "x.tiff")
    with pytest.raises(InputError, match="they hold mesh, points"):
        result.save(tmp_path / "x.ply", "depth")
    assert not list(tmp_path.iterdir())


def test_opencvs_form_is_sixteenths_with_the_invalid_below_the_range(client: Client, scene: Scene):
    result = client.match(scene.left, scene.right, budget_ms=5000, min_disparity=4)
    fixed = result.to_opencv()
    assert fixed.dtype == np.int16
    is_valid = np.isfinite(result.disparity)
    assert (fixed[~is_valid] == 16 * 3).all()
    np.testing.assert_array_equal(fixed[is_valid], np.rint(result.disparity[is_valid] * 16).astype(np.int16))


def test_open3d_gets_the_mesh_and_the_points(result: Result):
    pytest.importorskip("open3d", exc_type=ImportError)
    mesh = result.to_open3d()
    np.testing.assert_allclose(np.asarray(mesh.vertices), result.mesh.positions)
    assert mesh.has_vertex_colors()
    assert len(result.to_open3d("points").points) == len(result.points.positions)


def test_rerun_gets_what_it_can_show(result: Result):
    pytest.importorskip("rerun", exc_type=ImportError)
    for what, name in [("mesh", "Mesh3D"), ("points", "Points3D"), ("depth", "DepthImage"), ("color", "Image")]:
        assert type(result.to_rerun(what)).__name__ == name


def test_what_can_not_be_converted_says_what_can(result: Result):
    with pytest.raises(InputError, match="choose one of mesh, points"):
        result.to_open3d("depth")
