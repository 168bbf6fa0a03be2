"""The package itself, and its examples."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import PIL.Image
import pytest
from conftest import ROOT
from scene import Scene
from server import Server
from test_match import encoded

import stereo_client

EXAMPLES = Path(__file__).parents[1] / "examples"


def run(example: str, *args: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    program = EXAMPLES / example
    return subprocess.run([sys.executable, program, *args], capture_output=True, text=True, cwd=cwd, check=False)


@pytest.fixture
def files(scene: Scene, tmp_path) -> tuple[str, str]:
    for name, pixels in [("left", scene.left), ("right", scene.right)]:
        PIL.Image.fromarray(pixels).save(tmp_path / f"{name}.png")
    return str(tmp_path / "left.png"), str(tmp_path / "right.png")


def test_the_newcomers_script_has_at_most_eight_lines_and_shows_depth(server: Server, files, tmp_path):
    assert len((EXAMPLES / "depth.py").read_text().splitlines()) <= 8
    done = run("depth.py", *files, server.url, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "of budget 200 ms" in done.stdout
    with PIL.Image.open(tmp_path / "depth.png") as picture:
        assert picture.size == (320, 240)


def test_a_script_that_fails_ends_with_the_sentence(files, tmp_path):
    done = run("depth.py", *files, "http://127.0.0.1:1", cwd=tmp_path)
    assert done.returncode == 1
    assert "nothing listens at http://127.0.0.1:1" in done.stderr.splitlines()[-1]


def test_a_folder_is_played_as_a_camera_and_its_results_are_watched(server: Server, scene: Scene, tmp_path):
    for side, pixels in (("left", scene.left), ("right", scene.right)):
        (tmp_path / side).mkdir()
        (tmp_path / side / "0.png").write_bytes(encoded(pixels))
    watching = [sys.executable, "-u", EXAMPLES / "stream.py", server.zenoh(), "played"]
    playing = [
        sys.executable,
        EXAMPLES / "camera.py",
        tmp_path,
        "--server",
        server.zenoh(),
        "--camera",
        "played",
        "--rate",
        "20",
        "--repeat",
    ]
    with (
        subprocess.Popen(watching, stdout=subprocess.PIPE, text=True) as watcher,
        subprocess.Popen(playing, stdout=subprocess.PIPE, text=True) as player,
    ):
        assert player.stdout is not None
        assert watcher.stdout is not None
        assert player.stdout.readline() == "played is served by stereod\n"
        assert "by stereod" in watcher.stdout.readline()
        player.kill()
        watcher.kill()


@pytest.mark.parametrize("example", ["depth.py", "stream.py"])
def test_the_readme_has_the_examples(example: str):
    assert (EXAMPLES / example).read_text() in (ROOT / "README.md").read_text()


def test_the_schema_is_the_servers():
    ours = Path(stereo_client.__file__).with_name("stereo.v1.binpb").read_bytes()
    assert ours == (ROOT / "proto/src/gen/stereo.v1.binpb").read_bytes()


def test_http_is_used_without_zenoh_being_loaded(server: Server):
    code = f"import sys, stereo_client; stereo_client.Client({server.url!r}).info(); assert 'zenoh' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("transport", ["http", "zenoh"])
def test_a_script_that_closes_nothing_ends_all_the_same(server: Server, files, transport: str, tmp_path):
    url = server.url if transport == "http" else server.zenoh()
    code = f"import stereo_client; print(stereo_client.Client({url!r}).match({files[0]!r}, {files[1]!r}, budget_ms=5000).shape)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "(240, 320)\n"
    assert done.stderr == ""


def test_everything_public_has_a_docstring():
    for name in stereo_client.__all__:
        assert getattr(stereo_client, name).__doc__ or name == "ImageLike", name
