"""What was found for one pair, as numpy arrays."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from . import colors, convert, files
from ._payload import array, disparity_px, plain, rows
from ._schema import MESH_SPACE, Image, StereoResult
from .errors import MalformedReplyError, MissingPartError
from .images import rgb
from .options import Calibration, Region
from .report import Report

if TYPE_CHECKING:
    from .files import What

Float32Array: TypeAlias = "np.ndarray[Any, np.dtype[np.float32]]"
UInt8Array: TypeAlias = "np.ndarray[Any, np.dtype[np.uint8]]"
UInt32Array: TypeAlias = "np.ndarray[Any, np.dtype[np.uint32]]"


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangle mesh over the left image, of `n` vertices and `m` triangles.

    Attributes
    ----------
    positions : float32 (n, 3)
        In metres (x right, y down, z forward) if `is_metric`, else column, row and disparity in pixels.
    triangles : uint32 (m, 3)
        Vertex numbers, counter-clockwise as seen by the camera with y up.
    uvs : float32 (n, 2)
        Place in the left image, 0 to 1 from its left and from its top edge.
    disparities : float32 (n,)
        Disparity of each vertex in pixels.
    colors : uint8 (n, 3) or None
        Red, green and blue in the left image, if they were asked for.
    is_metric : bool
        Whether positions are in metres: the request had a calibration.
    """

    positions: Float32Array
    triangles: UInt32Array
    uvs: Float32Array
    disparities: Float32Array
    colors: UInt8Array | None
    is_metric: bool


@dataclass(frozen=True, eq=False)
class Points:
    """One 3D point for each valid pixel, row by row, in metres in the left camera's frame.

    Attributes
    ----------
    positions : float32 (n, 3)
        x right, y down, z forward, in metres.
    colors : uint8 (n, 3) or None
        Red, green and blue in the left image, where that is known.
    """

    positions: Float32Array
    colors: UInt8Array | None


class Result:
    """What was found for one pair. Maps have the left image's size; parts are decoded when they are first looked at.

    `disparity = x_left - x_right >= 0` in pixels, `depth_m = focal_px * baseline_m / (disparity + doffs_px)`; the frame is x right,
    y down, z forward. A part that the result does not have raises `MissingPartError`, which says how to ask for it.
    """

    def __init__(self, message: Any, left: Any = None) -> None:
        self._message = message
        self._left = None
        if left is not None:
            # A copy, for a part of the request would hold all of it.
            self._left = Image()
            self._left.CopyFrom(left)

    @property
    def message(self) -> Any:
        """The `stereo.v1.StereoResult` itself."""
        return self._message

    @property
    def request_id(self) -> str:
        """The request's id."""
        return str(self._message.request_id)

    @property
    def camera(self) -> str:
        """The camera's name, or empty."""
        return str(self._message.camera_id)

    @property
    def sequence(self) -> int | None:
        """The camera's frame number, if it had one."""
        return int(self._message.sequence) if self._message.HasField("sequence") else None

    @property
    def capture_time_ns(self) -> int | None:
        """When the pair was taken, in ns since 1970, if that is known."""
        if not self._message.HasField("capture_time"):
            return None
        time = self._message.capture_time
        return int(time.seconds) * 1_000_000_000 + int(time.nanos)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the maps."""
        part = self._message.disparity if self._message.HasField("disparity") else self._part("depth")
        return int(part.height), int(part.width)

    @property
    def calibration(self) -> Calibration | None:
        """The request's geometry, if it had one."""
        for name in ("disparity", "depth"):
            part = getattr(self._message, name)
            if self._message.HasField(name) and part.HasField("calibration"):
                return Calibration.from_message(part.calibration)
        return None

    @property
    def valid_window(self) -> Region:
        """The pixels that were matched: the whole image, or the region of interest."""
        part = self._message.disparity if self._message.HasField("disparity") else self._part("depth")
        window = part.valid_window
        return Region(window.x, window.y, window.width, window.height)

    @property
    def search_range_px(self) -> tuple[int, int]:
        """First disparity searched, and the end of the search, itself not searched."""
        part = self._part("disparity")
        return int(part.min_disparity_px), int(part.max_disparity_px)

    @cached_property
    def report(self) -> Report:
        """What was done and how long it took."""
        return Report.from_message(self._part("report"))

    @cached_property
    def disparity(self) -> Float32Array:
        """Disparity in pixels: float32 (height, width), NaN = invalid."""
        part = self._part("disparity")
        if not part.data:
            raise missing("disparity")
        return disparity_px(part)

    @cached_property
    def confidence(self) -> UInt8Array:
        """Confidence of each pixel: uint8 (height, width), 0 (invalid or not validated) to 254."""
        part = self._part("disparity", "confidence")
        if not part.confidence:
            raise missing("confidence")
        data = plain(part.confidence, part.compression)
        return rows(data, "u1", (part.height, part.width), 0, "confidence")

    @cached_property
    def depth_m(self) -> Float32Array:
        """Depth along the optical axis in metres: float32 (height, width), NaN = invalid. Needs a calibration."""
        if self._message.HasField("depth"):
            part = self._message.depth
            data = plain(part.data, part.compression)
            return rows(data, "<f4", (part.height, part.width), part.step, "depth").copy()
        calibration = self._calibrated("depth")
        parallax_px = self.disparity + np.float32(calibration.doffs_px)
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.float32(calibration.focal_px * calibration.baseline_m) / parallax_px
        depth[~(parallax_px > 0) | ~np.isfinite(depth)] = np.nan
        return depth

    @cached_property
    def mesh(self) -> Mesh:
        """Triangle mesh over the left image."""
        part = self._part("mesh")
        data = {
            name: plain(getattr(part, name), part.compression)
            for name in ("positions", "indices", "uvs", "disparities", "colors")
        }
        mesh = Mesh(
            positions=array(data["positions"], "<f4", 3, "mesh positions"),
            triangles=array(data["indices"], "<u4", 3, "mesh triangles"),
            uvs=array(data["uvs"], "<f4", 2, "mesh uvs"),
            disparities=array(data["disparities"], "<f4", 1, "mesh disparities"),
            colors=array(data["colors"], "u1", 3, "mesh colors") if data["colors"] else None,
            is_metric=part.space == MESH_SPACE.number["metres"],
        )
        if mesh.triangles.size and int(mesh.triangles.max()) >= len(mesh.positions):
            raise MalformedReplyError("the result's mesh is not whole: the client and the server don't fit")
        return mesh

    @cached_property
    def points(self) -> Points:
        """One 3D point for each valid pixel in metres. Needs a calibration."""
        if self._message.HasField("points"):
            part = self._message.points
            data = plain(part.colors, part.compression)
            positions = array(plain(part.positions, part.compression), "<f4", 3, "points")
            return Points(positions, array(data, "u1", 3, "point colors") if data else None)
        calibration = self._calibrated("points")
        y, x = np.nonzero(np.isfinite(self.depth_m))
        z = self.depth_m[y, x]
        per_px = z / np.float32(calibration.focal_px)
        positions = np.stack(
            [(x - np.float32(calibration.cx_px)) * per_px, (y - np.float32(calibration.cy_px)) * per_px, z], axis=1
        ).astype(np.float32)
        picture = self.left_rgb
        return Points(positions, None if picture is None or picture.shape[:2] != self.shape else picture[y, x])

    @cached_property
    def left_rgb(self) -> UInt8Array | None:
        """The left image: uint8 (height, width, 3). None for results of streams, or if it is a file and Pillow is not installed."""
        return None if self._left is None else rgb(self._left)

    def has(self, part: str) -> bool:
        """Whether the server sent `disparity`, `confidence`, `depth`, `mesh`, `points` or `report`."""
        if part == "confidence":
            return bool(self._message.disparity.confidence)
        if part == "disparity":
            return bool(self._message.disparity.data)
        return bool(self._message.HasField(part))

    def colorize(self, near: float | None = None, far: float | None = None) -> UInt8Array:
        """Return disparity in colours: uint8 (height, width, 3) RGB; near is warm and light, far is cold and dark, invalid is black.

        Parameters
        ----------
        near, far : float, optional
            Disparities in pixels at the ends of the scale. Default: the 98th and the 2nd percentile of the valid ones.
        """
        return colors.colorize(self.disparity, near, far)

    def save(self, path: str | os.PathLike[str], what: What | None = None) -> None:
        """Write a file; its format is that of the path's suffix.

        Parameters
        ----------
        path : path
            `.png`, `.pfm`, `.npy`, `.npz`, `.ply` or `.glb`.
        what : str, optional
            `disparity` (the default for maps: a 16-bit PNG in 1/256 px as KITTI has it, PFM, or NPY), `depth` (16-bit PNG in mm, PFM
            or NPY in metres), `confidence`, `color` (PNG as `colorize` makes it), `mesh` (the default for PLY and GLB) or `points`
            (PLY). NPZ has all there is.
        """
        files.save(self, path, what)

    def to_open3d(self, what: str = "mesh") -> Any:
        """Return an `open3d.geometry.TriangleMesh`, or a `PointCloud` for `points`, in metres if calibrated."""
        return convert.to_open3d(self, what)

    def to_opencv(self) -> np.ndarray[Any, np.dtype[np.int16]]:
        """Return disparity as OpenCV's matchers do: int16 (height, width) in 1/16 px, invalid = 16 * (smallest searched - 1)."""
        return convert.to_opencv(self)

    def to_rerun(self, what: str = "mesh") -> Any:
        """Return a Rerun archetype to log: `mesh` (Mesh3D), `points` (Points3D), `depth` (DepthImage) or `color` (Image)."""
        return convert.to_rerun(self, what)

    def __repr__(self) -> str:
        parts = [part for part in ("disparity", "confidence", "depth", "mesh", "points") if self.has(part)]
        report = f": {self.report}" if self.has("report") else ""
        return f"<Result with {', '.join(parts) or 'no parts'}{report}>"

    def __reduce__(self) -> tuple[Any, ...]:
        """Survive pickling, as results of process pools have to."""
        left = None if self._left is None else self._left.SerializeToString()
        return (_from_bytes, (self._message.SerializeToString(), left))

    def _part(self, name: str, wanted: str | None = None) -> Any:
        if not self._message.HasField(name):
            raise missing(wanted or name)
        return getattr(self._message, name)

    def _calibrated(self, wanted: str) -> Calibration:
        calibration = self.calibration
        if calibration is None:
            raise MissingPartError(
                f"there is no {wanted} without a calibration: give "
                "calibration=Calibration(focal_px=.., cx_px=.., cy_px=.., baseline_m=..)"
            )
        return calibration


def _from_bytes(message: bytes, left: bytes | None) -> Result:
    return Result(StereoResult.FromString(message), None if left is None else Image.FromString(left))


def missing(part: str) -> MissingPartError:
    """Return the error of a part that is not there."""
    return MissingPartError(
        f"the result has no {part}: ask for it with outputs=['{part}', ..] (a short budget may leave it out)"
    )
