"""Bytes of results as numpy arrays."""

from __future__ import annotations

import importlib
from io import BytesIO
from typing import Any

import numpy as np

from ._schema import COMPRESSION, DISPARITY_ENCODING
from .errors import MalformedReplyError, MissingPackageError

MAX_BYTES = 12 * 4096 * 4096
"""Largest payload that is decompressed: a point cloud of 4096 x 4096 px."""


def _zstd() -> Any:
    try:
        return importlib.import_module("compression.zstd")
    except ImportError:
        return importlib.import_module("backports.zstd")


def require_decompressor(compression: str) -> Any:
    """Return an object that decompresses up to so many bytes, or None for plain payloads."""
    try:
        if compression == "zstd":
            return _zstd().ZstdDecompressor()
        if compression == "lz4":
            return importlib.import_module("lz4.frame").LZ4FrameDecompressor()
    except ImportError as why:
        raise MissingPackageError(
            f"results with compression {compression!r} can't be read: install stereo-client[compression], or ask for 'none'"
        ) from why
    return None


def plain(data: bytes, compression: int) -> bytes:
    """Return a payload as it was before it was compressed."""
    decompressor = require_decompressor(COMPRESSION.name.get(compression, "unknown")) if data else None
    if decompressor is None:
        return data
    try:
        restored: bytes = decompressor.decompress(data, max_length=MAX_BYTES + 1)
    # Each library has its own error, and those that are not installed can't be named.
    except Exception as why:
        raise MalformedReplyError(f"a compressed part of the result is damaged ({why}): ask again") from why
    if len(restored) > MAX_BYTES or not decompressor.eof:
        raise MalformedReplyError("a compressed part of the result is damaged or larger than any result: ask again")
    return restored


def array(data: bytes, dtype: str, columns: int, what: str) -> np.ndarray[Any, Any]:
    """Return `columns` numbers a row; the rows are counted."""
    numbers = _numbers(data, dtype, what)
    if numbers.size % columns:
        raise MalformedReplyError(f"the result's {what} are not whole: the client and the server don't fit")
    return numbers.reshape(-1, columns) if columns > 1 else numbers


def _numbers(data: bytes, dtype: str, what: str) -> np.ndarray[Any, Any]:
    try:
        numbers = np.frombuffer(data, dtype)
    except ValueError as why:
        raise MalformedReplyError(f"the result's {what} are not whole: the client and the server don't fit") from why
    return numbers.astype(numbers.dtype.newbyteorder("="), copy=False)


def rows(data: bytes, dtype: str, size: tuple[int, int], step: int, what: str) -> np.ndarray[Any, Any]:
    """Return a map of (height, width), whose rows begin every `step` bytes (0 = without padding)."""
    height, width = size
    length = width * np.dtype(dtype).itemsize
    step = step or length
    if height == 0 or width == 0 or step < length or len(data) < step * (height - 1) + length:
        raise MalformedReplyError(f"the result's {what} is not whole: the client and the server don't fit")
    if step == length:
        return _numbers(data[: length * height], dtype, what).reshape(height, width)
    return np.stack([_numbers(data[y * step : y * step + length], dtype, what) for y in range(height)])


def disparity_px(message: Any) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Return a `stereo.v1.Disparity` as (height, width) pixels, NaN = invalid."""
    size = (message.height, message.width)
    encoding = DISPARITY_ENCODING.name.get(message.encoding)
    if encoding == "png16":
        fixed = _png16(message.data, size)
    else:
        data = plain(message.data, message.compression)
        if encoding == "f32":
            return rows(data, "<f4", size, message.step, "disparity").copy()
        if encoding != "u16":
            raise MalformedReplyError(
                "the result's disparity has an encoding that this client does not know: update it"
            )
        fixed = rows(data, "<u2", size, message.step, "disparity")
    disparity = fixed.astype(np.float32)
    disparity *= np.float32(1 / 256)
    disparity[fixed == 0] = np.nan
    return disparity


def _png16(data: bytes, size: tuple[int, int]) -> np.ndarray[Any, np.dtype[np.uint16]]:
    try:
        pillow = importlib.import_module("PIL.Image")
    except ImportError as why:
        raise MissingPackageError(
            "disparities as PNG files can't be read: install stereo-client[pillow], or ask for disparity_encoding 'u16'"
        ) from why
    try:
        with pillow.open(BytesIO(data)) as picture:
            fixed = np.asarray(picture).astype(np.uint16)
    except (OSError, ValueError) as why:
        raise MalformedReplyError("the result's disparity is no PNG that can be read: ask again") from why
    if fixed.shape != size:
        raise MalformedReplyError("the result's disparity is not whole: the client and the server don't fit")
    return fixed
