"""One pair: what goes in, what comes out."""

from __future__ import annotations

import io
import json
import pickle
import select
import threading
from datetime import timedelta

import numpy as np
import PIL.Image
import pytest
from scene import CALIBRATION, SQUARE_PX, WALL_PX, Scene
from server import Server

from stereo_client import Client, MissingPartError, Region, Result, StereoError


def encoded(pixels: np.ndarray, kind: str = "PNG") -> bytes:
    file = io.BytesIO()
    PIL.Image.fromarray(pixels).save(file, kind)
    return file.getvalue()


def match(client: Client, scene: Scene, **options) -> Result:
    return client.match(scene.left, scene.right, **({"budget_ms": 5000, "density": "dense"} | options))


def test_disparity_is_right_and_has_the_left_images_size(client: Client, scene: Scene):
    result = match(client, scene)
    assert result.shape == result.disparity.shape == scene.left.shape
    assert result.disparity.dtype == np.float32
    assert scene.wrong(result.disparity) < 0.03
    assert result.confidence.shape == scene.left.shape
    assert result.confidence.dtype == np.uint8


def test_a_real_pair_is_matched_as_its_truth_says(client: Client, real_pair):
    left, right = real_pair
    truth = np.asarray(PIL.Image.open(left.with_name("gt_noc.png"))).astype(np.float32) / 256
    result = client.match(left, right, budget_ms=10_000, density="dense", num_disparities=128)
    known = (truth > 0) & np.isfinite(result.disparity)
    assert (np.abs(result.disparity - truth)[known] < 3).mean() > 0.85


def test_pixels_that_are_not_matched_are_nan(client: Client, scene: Scene):
    result = match(client, scene, roi=(100, 50, 128, 96))
    assert result.valid_window == Region(100, 50, 128, 96)
    inside = np.zeros(result.shape, bool)
    inside[50:146, 100:228] = True
    assert np.isnan(result.disparity[~inside]).all()
    assert np.isfinite(result.disparity[inside]).mean() > 0.9
    semi_dense = match(client, scene, density="semi_dense", min_confidence=0.5)
    assert 0.1 < np.isnan(semi_dense.disparity).mean() < 1


def test_depth_is_focal_times_baseline_over_disparity(client: Client, scene: Scene):
    result = match(client, scene, calibration=CALIBRATION)
    assert result.calibration == CALIBRATION
    # f * B = 40 px m.
    assert np.nanmedian(result.depth_m[:60]) == pytest.approx(40 / WALL_PX, rel=0.02)
    assert np.nanmedian(result.depth_m[80:160, 140:200]) == pytest.approx(40 / SQUARE_PX, rel=0.02)


def test_depth_and_points_made_here_are_those_of_the_server(client: Client, scene: Scene):
    options = {"calibration": CALIBRATION, "disparity_encoding": "f32"}
    ours = match(client, scene, **options)
    theirs = match(client, scene, **options, outputs=["disparity", "depth", "points"], colors=True)
    assert not ours.has("depth")
    assert theirs.has("depth")
    np.testing.assert_allclose(ours.depth_m, theirs.depth_m, rtol=1e-5)
    np.testing.assert_allclose(ours.points.positions, theirs.points.positions, rtol=1e-4, atol=1e-4)
    np.testing.assert_array_equal(ours.points.colors, theirs.points.colors)


def test_the_mesh_lies_in_metres_in_the_cameras_frame(client: Client, scene: Scene):
    mesh = match(client, scene, calibration=CALIBRATION, colors=True, mesh={"max_triangles": 500}).mesh
    assert mesh.is_metric
    assert 0 < len(mesh.triangles) <= 500
    assert mesh.colors is not None
    assert mesh.positions.shape == mesh.colors.shape == (len(mesh.disparities), 3)
    z = 40 / mesh.disparities
    np.testing.assert_allclose(mesh.positions[:, 2], z, rtol=1e-4)
    column = mesh.uvs[:, 0] * 320 - 0.5
    np.testing.assert_allclose(mesh.positions[:, 0], (column - 160) * z / 400, rtol=1e-3, atol=1e-3)
    assert not match(client, scene).mesh.is_metric


@pytest.mark.parametrize(
    "form",
    ["pillow", "path", "str", "png", "jpeg", "memoryview", "bmp", "big endian", "32 bit", "channel", "rows apart"],
)
def test_every_form_of_an_image_is_the_same_image(client: Client, scene: Scene, form: str, tmp_path):
    def shaped(pixels: np.ndarray):
        path = tmp_path / f"{pixels[0, :20].tobytes().hex()}.png"
        path.write_bytes(encoded(pixels))
        wide = np.zeros((240, 640), np.uint8)
        wide[:, ::2] = pixels
        return {
            "pillow": PIL.Image.fromarray(pixels),
            "path": path,
            "str": str(path),
            "png": encoded(pixels),
            "jpeg": encoded(pixels, "JPEG"),
            "memoryview": memoryview(encoded(pixels)),
            "bmp": encoded(pixels, "BMP"),
            "big endian": pixels.astype(">u2") * 257,
            "32 bit": PIL.Image.fromarray(pixels.astype(np.int32) * 257),
            "channel": pixels[:, :, None],
            "rows apart": wide[:, ::2],
        }[form]

    plain, other = (
        match(client, scene),
        client.match(shaped(scene.left), shaped(scene.right), budget_ms=5000, density="dense"),
    )
    if form == "jpeg":
        assert scene.wrong(other.disparity) < 0.03
    else:
        np.testing.assert_array_equal(other.disparity, plain.disparity)


@pytest.mark.parametrize(
    ("pixel_format", "order"), [("rgb", [0, 1, 2]), ("bgr", [2, 1, 0]), ("rgb", [0, 1, 2, 3]), ("bgr", [2, 1, 0, 3])]
)
def test_colours_arrive_as_they_are_meant(client: Client, scene: Scene, pixel_format, order):
    tint = np.array([1.0, 0.6, 0.3, 1.0])
    left, right = ((pixels[:, :, None] * tint).astype(np.uint8)[:, :, order] for pixels in (scene.left, scene.right))
    result = client.match(left, right, budget_ms=5000, pixel_format=pixel_format, colors=True)
    assert result.left_rgb is not None
    np.testing.assert_array_equal(result.left_rgb, (scene.left[:, :, None] * tint[:3]).astype(np.uint8))
    red, green, blue = result.mesh.colors.astype(int).sum(axis=0)
    assert red > green > blue


def test_yuyv_is_taken(client: Client, scene: Scene):
    def packed(pixels: np.ndarray) -> np.ndarray:
        return np.stack([pixels, np.full_like(pixels, 128)], axis=2)

    result = client.match(packed(scene.left), packed(scene.right), pixel_format="yuyv", budget_ms=5000, density="dense")
    np.testing.assert_array_equal(result.disparity, match(client, scene).disparity)


@pytest.mark.parametrize("options", [{"compression": "zstd"}, {"compression": "lz4"}, {"disparity_encoding": "png16"}])
def test_however_a_result_travels_it_is_the_same(client: Client, scene: Scene, options):
    plain, other = match(client, scene, colors=True), match(client, scene, colors=True, **options)
    np.testing.assert_array_equal(other.disparity, plain.disparity)
    np.testing.assert_array_equal(other.confidence, plain.confidence)
    np.testing.assert_array_equal(other.mesh.positions, plain.mesh.positions)
    np.testing.assert_array_equal(other.mesh.colors, plain.mesh.colors)


def test_options_reach_the_server_and_the_report_comes_back(client: Client, scene: Scene):
    result = match(
        client,
        scene,
        budget_ms=timedelta(seconds=4),
        preset="fast",
        max_iterations=2,
        num_disparities=64,
        min_disparity=4,
        request_id="mine",
        camera="front",
        sequence=7,
        capture_time_ns=1_700_000_000_123_456_789,
        allow_downscale=False,
        mesh_is_optional=True,
        priority_class="best_effort",
    )
    assert (result.request_id, result.camera, result.sequence) == ("mine", "front", 7)
    assert result.capture_time_ns == 1_700_000_000_123_456_789
    assert result.search_range_px == (4, 68)
    report = result.report
    assert (report.budget_ms, report.iterations_asked) == (4000, 2)
    assert 1 <= report.iterations_run <= 2
    assert report.deadline_met
    assert 0 < report.matched_ms < report.total_ms
    assert f"{report.iterations_run} of 2 rungs" in str(report)
    assert match(client, scene, priority_class="background", budget_ms=None).report.budget_ms is None


def test_a_part_that_was_not_asked_for_says_how_to_get_it(client: Client, scene: Scene):
    result = match(client, scene, outputs=["confidence"])
    for part in ("disparity", "mesh"):
        with pytest.raises(MissingPartError, match=f"outputs=\\['{part}'"):
            getattr(result, part)
    with pytest.raises(MissingPartError, match="confidence"):
        _ = match(client, scene, outputs=["disparity"]).confidence
    for part in ("depth_m", "points"):
        with pytest.raises(MissingPartError, match="calibration=Calibration"):
            getattr(match(client, scene), part)


def test_results_survive_pickling(client: Client, scene: Scene):
    result = match(client, scene)
    again = pickle.loads(pickle.dumps(result))
    np.testing.assert_array_equal(again.disparity, result.disparity)
    np.testing.assert_array_equal(again.left_rgb, result.left_rgb)
    assert again.report == result.report


def test_threads_share_a_client(client: Client, scene: Scene):
    densities: list[float] = []
    threads = [threading.Thread(target=lambda: densities.append(match(client, scene).report.density)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(densities) == 4


def test_a_connection_that_was_closed_while_it_rested_is_replaced(program: str, scene: Scene):
    with Server.start(program, "--header-timeout-ms", "50") as server, Client(server.url) as client:
        match(client, scene)
        # Readable = the server has closed it.
        resting = client._async._transport._http._idle[0]._wire._socket
        select.select([resting], [], [])
        match(client, scene)


def test_a_closed_client_says_so(server: Server, scene: Scene):
    client = Client(server.url)
    client.close()
    client.close()
    with pytest.raises(StereoError, match="has been closed"):
        match(client, scene)
    with pytest.raises(StereoError, match="has been closed"):
        client.match_many([])


def test_info_tells_version_and_limits(client: Client):
    info = client.info()
    assert {"version", "limits", "presets"} <= info.keys()
    assert json.dumps(info)
