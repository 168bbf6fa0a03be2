"""What is wanted of a pair: options as keyword arguments, and the camera's geometry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import timedelta
from typing import Any, Literal, TypeAlias, TypedDict, cast, get_args

from . import _schema
from ._payload import require_decompressor
from .errors import InputError
from .images import PixelFormat

Preset: TypeAlias = Literal["default", "fast", "paper"]
Density: TypeAlias = Literal["semi_dense", "dense"]
PriorityClass: TypeAlias = Literal["deadline", "best_effort", "background"]
Output: TypeAlias = Literal["disparity", "confidence", "depth", "mesh", "points"]
DisparityEncoding: TypeAlias = Literal["u16", "f32", "png16"]
Compression: TypeAlias = Literal["none", "zstd", "lz4"]


@dataclass(frozen=True)
class Calibration:
    """Geometry of a rectified pair: `depth_m = focal_px * baseline_m / (disparity_px + doffs_px)`.

    Attributes
    ----------
    focal_px : float
        Focal length in pixels.
    cx_px, cy_px : float
        The left view's principal point: column and row in pixels.
    baseline_m : float
        Distance of the two cameras in metres.
    doffs_px : float
        `cx_right - cx_left` in pixels; 0 for most rectified pairs.
    """

    focal_px: float
    cx_px: float
    cy_px: float
    baseline_m: float
    doffs_px: float = 0.0

    @classmethod
    def from_matrices(cls, left: Any, right: Any) -> Calibration:
        """Return the geometry of two 3x4 projection matrices of a rectified pair, as ROS and OpenCV have them (P1, P2).

        The right one's last column is `-focal_px * baseline_m`.
        """
        focal_px = float(right[0][0])
        return cls(
            focal_px=focal_px,
            cx_px=float(left[0][2]),
            cy_px=float(left[1][2]),
            baseline_m=-float(right[0][3]) / focal_px,
            doffs_px=float(right[0][2]) - float(left[0][2]),
        )

    def to_message(self) -> Any:
        """Return the `stereo.v1.Calibration`."""
        return _schema.Calibration(**asdict(self))

    @classmethod
    def from_message(cls, message: Any) -> Calibration:
        """Return what a `stereo.v1.Calibration` says."""
        return cls(message.focal_px, message.cx_px, message.cy_px, message.baseline_m, message.doffs_px)


@dataclass(frozen=True)
class Region:
    """A rectangle of pixels: columns `x` to `x + width - 1`, rows `y` to `y + height - 1`."""

    x: int
    y: int
    width: int
    height: int


class MeshOptions(TypedDict, total=False):
    """How fine a mesh is, and which triangles it keeps."""

    tolerance_px: float
    """How far the disparity may be from a plane that fits it, 0.1 to 64 px. Default 1."""
    max_triangles: int
    """Triangles at most, 100 to 1000000. Default 20000."""
    keep_rejected: bool
    """Keeps triangles across depth discontinuities and those that failed validation. Default False."""
    max_disparity_step_px: float
    """Steepest triangle without texture, 0.5 to 64 px. Default 4."""
    min_valid_share: float
    """Share of a triangle's textured pixels that must lie on it, 0 to 1. Default 0.5."""


class ServiceOptions(TypedDict, total=False):
    """What is wanted of a frame. What is left out has the server's default; ranges are checked by the server."""

    budget_ms: float | timedelta
    """Time from the request's first byte at the server to the answer, in ms, above 0 and up to 60 s. Default 100."""
    max_iterations: int
    """Rungs of the ladder to run at most, 1 to 255. Default: all."""
    preset: Preset
    """`default`, `fast` (mesh iterations alone), or `paper` (the published algorithm)."""
    min_confidence: float
    """Drops pixels with less confidence, 0 to 1; 0.5 keeps the confident ones. Default 0."""
    num_disparities: int
    """Disparities searched, in px: 16 to 256 in steps of 16. Default 128."""
    min_disparity: int
    """Smallest disparity searched, in px. Default 0."""
    density: Density
    """`semi_dense`: pixels with texture (the default); `dense`: every pixel."""
    roi: Region | tuple[int, int, int, int]
    """Only this part of the left image is matched: x, y, width, height."""
    priority_class: PriorityClass
    """`deadline` (the default), `best_effort`, or `background` (no deadline)."""
    outputs: Sequence[Output]
    """Parts of the result. Default: disparity, confidence and mesh. Depth and points are made here if they were not asked for."""
    disparity_encoding: DisparityEncoding
    """How disparity travels: `u16` (1/256 px, the default), `f32`, or `png16` (needs Pillow)."""
    compression: Compression
    """How the result travels; `zstd` and `lz4` need stereo-client[compression]. Default `none`."""
    allow_downscale: bool
    """Under overload, match at half resolution rather than refuse. Default False."""
    mesh: MeshOptions
    """How fine the mesh is."""
    colors: bool
    """Whether mesh and points get the left image's colours. Default False."""
    mesh_is_optional: bool
    """Whether the mesh may be left out when time is short. Default False."""


class MatchOptions(ServiceOptions, total=False):
    """What is wanted of a frame, and what else goes with it."""

    calibration: Calibration | None
    """Geometry of the pair. Without: no depth, no points, and the mesh is in pixels."""
    request_id: str
    """The caller's name for the request, up to 128 printable ASCII characters; echoed."""
    camera: str
    """The camera's name, `[A-Za-z0-9_.-]{1,64}`; echoed."""
    sequence: int
    """Frame number of that camera; frames with both are a stream, in which a newer one takes an older one's place."""
    capture_time_ns: int
    """When the pair was taken, in ns since 1970 (`time.time_ns()`); echoed."""
    pixel_format: PixelFormat
    """What the channels of colour arrays are: `rgb` (the default), `bgr` as OpenCV has them, or `yuyv`."""


PLAIN = (
    "max_iterations",
    "min_confidence",
    "num_disparities",
    "min_disparity",
    "allow_downscale",
    "colors",
    "mesh_is_optional",
)
CHOICES = {
    "preset": _schema.PRESET,
    "density": _schema.DENSITY,
    "priority_class": _schema.PRIORITY_CLASS,
    "disparity_encoding": _schema.DISPARITY_ENCODING,
    "compression": _schema.COMPRESSION,
}
_CHOICE_TYPES = {
    "preset": Preset,
    "density": Density,
    "priority_class": PriorityClass,
    "disparity_encoding": DisparityEncoding,
    "compression": Compression,
}


def set_duration(field: Any, name: str, value: float | timedelta) -> None:
    """Write a duration given in ms, or as a timedelta, to a `google.protobuf.Duration`."""
    ms = value / timedelta(milliseconds=1) if isinstance(value, timedelta) else value
    try:
        ns = round(float(ms) * 1e6)
        field.seconds, field.nanos = divmod(ns, 1_000_000_000)
    except (TypeError, ValueError, OverflowError) as why:
        raise InputError(f"{name} is {value!r}: give a number of milliseconds, or a timedelta") from why


def options_message(options: Mapping[str, Any]) -> Any:
    """Return the `stereo.v1.Options` of keyword arguments."""
    unknown = sorted(options.keys() - ServiceOptions.__annotations__.keys())
    if unknown:
        known = ", ".join(MatchOptions.__annotations__)
        raise InputError(f"there is no option {', '.join(unknown)}: the options are {known}")
    message = _schema.Options()
    for name, value in options.items():
        if value is None:
            continue
        try:
            _set(message, name, value)
        except (TypeError, ValueError, OverflowError) as why:
            if isinstance(why, InputError):
                raise
            raise InputError(f"{name} can't be {value!r} ({why}): see help(stereo_client.MatchOptions)") from why
    return message


def _set(message: Any, name: str, value: Any) -> None:
    if name == "budget_ms":
        set_duration(message.latency_budget, name, value)
    elif name in PLAIN:
        setattr(message, name, value)
    elif name in CHOICES:
        if name == "compression":
            require_decompressor(value)
        setattr(message, name, _number(CHOICES[name], name, value, get_args(_CHOICE_TYPES[name])))
    elif name == "outputs":
        if isinstance(value, str):
            raise InputError(f"outputs is {value!r}: give a list such as ['disparity', 'mesh']")
        message.outputs.extend(_number(_schema.OUTPUT, name, output, get_args(Output)) for output in value)
    elif name == "roi":
        region = value if isinstance(value, Region) else Region(*value)
        message.roi.SetInParent()
        for field, number in asdict(region).items():
            setattr(message.roi, field, number)
    else:
        message.mesh.SetInParent()
        for field, number in cast("dict[str, Any]", value).items():
            if field not in MeshOptions.__annotations__:
                raise InputError(f"there is no mesh option {field}: they are {', '.join(MeshOptions.__annotations__)}")
            setattr(message.mesh, field, number)


def _number(enum: _schema.Enum, name: str, value: Any, known: tuple[str, ...]) -> int:
    if value not in known:
        raise InputError(f"{name} can't be {value!r}: it is one of {', '.join(known)}")
    return enum.number[value]


def request_message(left: Any, right: Any, options: Mapping[str, Any]) -> Any:
    """Return the `stereo.v1.StereoRequest` of two `stereo.v1.Image` and keyword arguments."""
    rest = dict(options)
    rest.pop("pixel_format", None)
    calibration: Calibration | None = rest.pop("calibration", None)
    names = {"request_id": "request_id", "camera": "camera_id", "sequence": "sequence"}
    fields = {field: rest.pop(name) for name, field in names.items() if name in rest}
    capture_time_ns = rest.pop("capture_time_ns", None)
    try:
        request = _schema.StereoRequest(left=left, right=right, **fields)
        if capture_time_ns is not None:
            request.capture_time.seconds, request.capture_time.nanos = divmod(int(capture_time_ns), 1_000_000_000)
        if calibration is not None:
            request.calibration.CopyFrom(calibration.to_message())
    except (TypeError, ValueError, AttributeError) as why:
        raise InputError(f"the request can't be written ({why}): see help(stereo_client.MatchOptions)") from why
    if rest:
        request.options.CopyFrom(options_message(rest))
    return request
