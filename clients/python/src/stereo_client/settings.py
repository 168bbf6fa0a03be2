"""What a server does with the frames of a camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Any, Literal, TypeAlias, cast

from . import _schema
from .errors import InputError
from .options import CHOICES, PLAIN, Calibration, MeshOptions, Region, ServiceOptions, options_message, set_duration
from .report import ms

PairingKey: TypeAlias = Literal["sequence", "time"]


@dataclass(frozen=True)
class Pairing:
    """How single images of a camera are brought together.

    Attributes
    ----------
    key : str or None
        `sequence` or `time`; None: by sequence where both images have one, else by time.
    tolerance_ms : float or timedelta or None
        Largest difference of the two timestamps, above 0 and up to 1 s. Default 10 ms.
    patience_ms : float or timedelta or None
        How long an image waits for its other half, above 0 and up to 10 s. Default 200 ms.
    """

    key: PairingKey | None = None
    tolerance_ms: float | timedelta | None = None
    patience_ms: float | timedelta | None = None


@dataclass(frozen=True)
class Settings:
    """What a server does with the frames of one camera.

    Attributes
    ----------
    options : dict
        Options for frames that have none of their own; the latency budget bounds all frames.
    calibration : Calibration or None
        For frames that have none of their own.
    pairing : Pairing
        How single images are brought together.
    revision : int
        Counts the changes.
    """

    options: ServiceOptions = field(default_factory=ServiceOptions)
    calibration: Calibration | None = None
    pairing: Pairing = field(default_factory=Pairing)
    revision: int = 0

    @classmethod
    def from_message(cls, message: Any) -> Settings:
        """Return what a `stereo.v1.CameraSettings` says."""
        given = message.pairing
        key = _schema.PAIRING_KEY.name.get(given.key)
        return cls(
            options=_options(message.options),
            calibration=Calibration.from_message(message.calibration) if message.HasField("calibration") else None,
            pairing=Pairing(
                key=cast("PairingKey", key) if key in ("sequence", "time") else None,
                tolerance_ms=ms(given.tolerance) if given.HasField("tolerance") else None,
                patience_ms=ms(given.patience) if given.HasField("patience") else None,
            ),
            revision=int(message.revision),
        )


def settings_message(options: Mapping[str, Any], calibration: Calibration | None, pairing: Pairing | None) -> Any:
    """Return the `stereo.v1.CameraSettings`; it is never empty, which would only read them."""
    message = _schema.CameraSettings(options=options_message(options))
    message.options.SetInParent()
    if calibration is not None:
        message.calibration.CopyFrom(calibration.to_message())
    if pairing is not None:
        if pairing.key is not None:
            if pairing.key not in ("sequence", "time"):
                raise InputError(f"key can't be {pairing.key!r}: it is one of sequence, time")
            message.pairing.key = _schema.PAIRING_KEY.number[pairing.key]
        for name, value in (("tolerance", pairing.tolerance_ms), ("patience", pairing.patience_ms)):
            if value is not None:
                set_duration(getattr(message.pairing, name), f"{name}_ms", value)
    return message


def _options(message: Any) -> ServiceOptions:
    """Return options as keyword arguments."""
    options: dict[str, Any] = {name: getattr(message, name) for name in PLAIN if message.HasField(name)}
    if message.HasField("latency_budget"):
        options["budget_ms"] = ms(message.latency_budget)
    for name, enum in CHOICES.items():
        if value := getattr(message, name):
            options[name] = enum.name[value]
    if message.outputs:
        options["outputs"] = [_schema.OUTPUT.name[output] for output in message.outputs]
    if message.HasField("roi"):
        options["roi"] = Region(message.roi.x, message.roi.y, message.roi.width, message.roi.height)
    if message.HasField("mesh"):
        mesh = message.mesh
        options["mesh"] = {name: getattr(mesh, name) for name in MeshOptions.__annotations__ if mesh.HasField(name)}
    return cast("ServiceOptions", options)
