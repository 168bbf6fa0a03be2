"""Results as objects of other libraries, where these are installed."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import InputError, MissingPackageError
from .files import vertex_colors

if TYPE_CHECKING:
    from .result import Result


def _package(module: str, extra: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as why:
        raise MissingPackageError(
            f"{module} is needed for this and can't be loaded ({why}): pip install 'stereo-client[{extra}]'"
        ) from why


def _choose(what: str, choices: tuple[str, ...]) -> None:
    if what not in choices:
        raise InputError(f"{what!r} can't be converted to this: choose one of {', '.join(choices)}")


def to_open3d(result: Result, what: str) -> Any:
    """See `Result.to_open3d`."""
    _choose(what, ("mesh", "points"))
    o3d = _package("open3d", "open3d")
    vectors = o3d.utility.Vector3dVector
    if what == "points":
        points = result.points
        cloud = o3d.geometry.PointCloud(vectors(points.positions.astype(np.float64)))
        if points.colors is not None:
            cloud.colors = vectors(points.colors / 255)
        return cloud
    mesh, colors = result.mesh, vertex_colors(result)
    surface = o3d.geometry.TriangleMesh(
        vectors(mesh.positions.astype(np.float64)), o3d.utility.Vector3iVector(mesh.triangles.astype(np.int32))
    )
    if colors is not None:
        surface.vertex_colors = vectors(colors / 255)
    return surface


def to_opencv(result: Result) -> np.ndarray[Any, np.dtype[np.int16]]:
    """See `Result.to_opencv`."""
    invalid = 16 * (result.search_range_px[0] - 1)
    return np.nan_to_num(np.rint(result.disparity * 16), nan=invalid).astype(np.int16)


def to_rerun(result: Result, what: str) -> Any:
    """See `Result.to_rerun`."""
    _choose(what, ("mesh", "points", "depth", "color"))
    rr = _package("rerun", "rerun")
    if what == "depth":
        return rr.DepthImage(result.depth_m, meter=1.0)
    if what == "color":
        return rr.Image(result.colorize())
    if what == "points":
        return rr.Points3D(result.points.positions, colors=result.points.colors)
    mesh = result.mesh
    return rr.Mesh3D(
        vertex_positions=mesh.positions, triangle_indices=mesh.triangles, vertex_colors=vertex_colors(result)
    )
