"""A running server, and pairs to send it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from scene import Scene, render
from server import Server

from stereo_client import Client

ROOT = Path(__file__).parents[3]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--stereod", default=str(ROOT / "target/release/stereod"), help="the server's program")


@pytest.fixture(scope="session")
def program(pytestconfig: pytest.Config) -> str:
    path = pytestconfig.getoption("--stereod")
    if not Path(path).is_file():
        pytest.exit(
            f"there is no {path}: build it with `cargo build --release --workspace --bin stereod`, or say where with --stereod"
        )
    return str(path)


@pytest.fixture(scope="session")
def server(program: str) -> Iterator[Server]:
    with Server.start(program) as server:
        yield server


@pytest.fixture
def client(server: Server) -> Iterator[Client]:
    with Client(server.url) as client:
        yield client


@pytest.fixture(scope="session")
def scene() -> Scene:
    return render()


@pytest.fixture(scope="session")
def real_pair() -> tuple[Path, Path]:
    """A real pair with its truth beside it, where the data is."""
    folder = ROOT / "../shared/data/middlebury2014/motorcycle"
    if not folder.is_dir():
        pytest.skip("there is no ../shared/data/middlebury2014/motorcycle")
    return folder / "left.png", folder / "right.png"
