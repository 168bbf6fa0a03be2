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
    assert "3 of 3 rungs" in done.stdout
    with PIL.Image.open(tmp_path / "depth.png") as picture:
        assert picture.size == (320, 240)


def test_a_script_that_fails_ends_with_the_sentence(files, tmp_path):
    done = run("depth.py", *files, "http://127.0.0.1:1", cwd=tmp_path)
    assert done.returncode == 1
    assert "nothing listens at http://127.0.0.1:1" in done.stderr.splitlines()[-1]


def test_the_readmes_first_lines_are_the_example():
    example = (EXAMPLES / "depth.py").read_text()
    assert example in (ROOT / "README.md").read_text()


def test_the_schema_is_the_servers():
    ours = Path(stereo_client.__file__).with_name("stereo.v1.binpb").read_bytes()
    assert ours == (ROOT / "proto/src/gen/stereo.v1.binpb").read_bytes()


def test_http_is_used_without_zenoh_being_loaded(server: Server):
    code = f"import sys, stereo_client; stereo_client.Client({server.url!r}).info(); assert 'zenoh' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_everything_public_has_a_docstring():
    for name in stereo_client.__all__:
        assert getattr(stereo_client, name).__doc__ or name == "ImageLike", name
