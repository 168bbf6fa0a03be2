"""Disparity in colours that the eye orders as the numbers are: lightness rises evenly from far to near."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

_LIGHTNESS = (0.30, 0.95)
_CHROMA = (0.14, 0.16)
_HUE_DEG = (290.0, 95.0)


@cache
def scale(steps: int = 256) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Return the scale from far to near, uint8 (steps, 3): a curve through Oklch, from dark violet over green to light yellow."""
    t = np.linspace(0, 1, steps)
    lightness, chroma, hue = (np.interp(t, (0, 1), ends) for ends in (_LIGHTNESS, _CHROMA, np.radians(_HUE_DEG)))
    lab = np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=1)
    # Oklab to linear sRGB (Ottosson 2020).
    cone = lab @ np.array(
        [[1, 1, 1], [0.3963377774, -0.1055613458, -0.0894841775], [0.2158037573, -0.0638541728, -1.2914855480]]
    )
    linear = cone**3 @ np.array(
        [
            [4.0767416621, -1.2684380046, -0.0041960863],
            [-3.3077115913, 2.6097574011, -0.7034186147],
            [0.2309699292, -0.3413193965, 1.7076147010],
        ]
    )
    linear = linear.clip(0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    steps_rgb: np.ndarray[Any, np.dtype[np.uint8]] = np.rint(encoded * 255).astype(np.uint8)
    return steps_rgb


def colorize(
    values: np.ndarray[Any, np.dtype[np.float32]], near: float | None, far: float | None
) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Return a map in colours: the largest values near, NaN black."""
    picture = np.zeros((*values.shape, 3), np.uint8)
    is_valid = np.isfinite(values)
    valid = values[is_valid]
    if valid.size:
        low = float(np.percentile(valid, 2)) if far is None else far
        high = float(np.percentile(valid, 98)) if near is None else near
        nearness = (valid - low) / max(high - low, 1e-6)
        picture[is_valid] = scale()[(nearness.clip(0, 1) * 255).astype(np.uint8)]
    return picture
