"""A rendered pair whose disparity is known: a wall, and a square before it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stereo_client import Calibration

WALL_PX, SQUARE_PX = 8, 24
CALIBRATION = Calibration(focal_px=400.0, cx_px=160.0, cy_px=120.0, baseline_m=0.1)


@dataclass(frozen=True)
class Scene:
    left: np.ndarray[Any, np.dtype[np.uint8]]
    right: np.ndarray[Any, np.dtype[np.uint8]]
    truth: np.ndarray[Any, np.dtype[np.float32]]
    """NaN where the right view does not see it."""

    def wrong(self, disparity: np.ndarray[Any, Any]) -> float:
        """Share of the disparities that are off by more than a pixel."""
        both = np.isfinite(disparity) & np.isfinite(self.truth)
        return float((np.abs(disparity - self.truth)[both] > 1).mean())


def render(height: int = 240, width: int = 320) -> Scene:
    random = np.random.default_rng(7)
    # Blurred noise: texture at several scales.
    texture = sum(
        np.kron(random.integers(0, 60, (height // n + 1, (width + 64) // n + 1)), np.ones((n, n)))[
            :height, : width + 64
        ]
        for n in (1, 2, 4, 8)
    ).astype(np.uint8)
    truth = np.full((height, width), WALL_PX, np.float32)
    truth[60:180, 120:220] = SQUARE_PX
    x = np.arange(width)
    left, right = texture[:, 32 : 32 + width].copy(), texture[:, 32 + WALL_PX : 32 + WALL_PX + width].copy()
    square = random.integers(0, 255, (120, 100)).astype(np.uint8)
    square = ((square.astype(int) + np.roll(square, 1, 0) + np.roll(square, 1, 1)) // 3).astype(np.uint8)
    left[60:180, 120:220] = square
    right[60:180, 120 - SQUARE_PX : 220 - SQUARE_PX] = square
    truth[:, x < WALL_PX] = np.nan
    truth[60:180, 120 - (SQUARE_PX - WALL_PX) : 120] = np.nan
    return Scene(left, right, truth)
