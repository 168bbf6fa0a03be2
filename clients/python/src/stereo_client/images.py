"""Images as the wire has them, from whatever they are here."""

from __future__ import annotations

import importlib
import os
import sys
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, Union

import numpy as np

from ._schema import IMAGE_ENCODING
from ._schema import Image as ImageMessage
from .errors import InputError, MissingPackageError

if TYPE_CHECKING:
    import PIL.Image

ImageLike: TypeAlias = Union[
    "np.ndarray[Any, Any]", "PIL.Image.Image", str, "os.PathLike[str]", bytes, bytearray, memoryview
]
"""A picture: a numpy array, a Pillow image, the path of a file, or the bytes of one.

Arrays are `uint8` or `uint16` of shape (height, width) for gray, or `uint8` of shape (height, width, 3 or 4) for colours. PNG and
JPEG files are sent as they are; other formats are read with Pillow.
"""

PixelFormat: TypeAlias = Literal["rgb", "bgr", "yuyv"]
"""What the channels of colour arrays are: `rgb` (with 4: RGBA), `bgr` as OpenCV has them (BGRA), or `yuyv` for shape (h, w, 2)."""

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"


def image_message(image: ImageLike, side: str, pixel_format: PixelFormat = "rgb") -> Any:
    """Return the `stereo.v1.Image` of a picture; `side` names it in errors."""
    if isinstance(image, (str, os.PathLike)):
        return _from_file(_read(Path(image), side), side, str(image))
    if isinstance(image, (bytes, bytearray, memoryview)):
        return _from_file(bytes(image), side, "the bytes given")
    if hasattr(image, "getbands") and hasattr(image, "convert"):
        return _from_pillow(image, side)
    return _from_array(np.asarray(image), side, pixel_format)


def _read(path: Path, side: str) -> bytes:
    try:
        return path.read_bytes()
    except OSError as why:
        raise InputError(f"the {side} image {path} can't be read ({why.strerror}): check the path") from why


def _from_file(data: bytes, side: str, name: str) -> Any:
    if data.startswith(_PNG):
        return ImageMessage(encoding=IMAGE_ENCODING.number["png"], data=data)
    if data.startswith(_JPEG):
        return ImageMessage(encoding=IMAGE_ENCODING.number["jpeg"], data=data)
    if not data:
        raise InputError(f"the {side} image ({name}) is empty: give a whole image file")
    try:
        pillow = importlib.import_module("PIL.Image")
    except ImportError as why:
        raise MissingPackageError(
            f"the {side} image ({name}) is neither PNG nor JPEG: convert it, or install stereo-client[pillow] to have it read"
        ) from why
    try:
        with pillow.open(BytesIO(data)) as picture:
            return _from_pillow(picture, side)
    except (OSError, ValueError) as why:
        raise InputError(f"the {side} image ({name}) is no image file that can be read: send PNG or JPEG") from why


def _from_pillow(picture: Any, side: str) -> Any:
    if picture.mode == "I":
        # 16-bit gray, as older versions of Pillow have it.
        return _from_array(np.asarray(picture).clip(0, 65535).astype(np.uint16), side, "rgb")
    if picture.mode not in ("L", "RGB", "RGBA", "I;16"):
        picture = picture.convert("L" if picture.mode in ("1", "LA") else "RGB")
    return _from_array(np.asarray(picture), side, "rgb")


def _from_array(pixels: np.ndarray[Any, Any], side: str, pixel_format: PixelFormat) -> Any:
    if pixels.ndim == 3 and pixels.shape[2] == 1:
        pixels = pixels[:, :, 0]
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    encodings = {
        (1, "u1"): "mono8",
        (1, "u2"): "mono16",
        (2, "u1"): "yuyv" if pixel_format == "yuyv" else None,
        (3, "u1"): {"rgb": "rgb8", "bgr": "bgr8"}.get(pixel_format),
        (4, "u1"): {"rgb": "rgba8", "bgr": "bgra8"}.get(pixel_format),
    }
    encoding = encodings.get((channels, pixels.dtype.str[1:])) if pixels.ndim in (2, 3) else None
    if encoding is None:
        raise InputError(
            f"the {side} image is an array of shape {pixels.shape} and type {pixels.dtype} (pixel_format {pixel_format!r}): "
            "give uint8 or uint16 of shape (height, width), or uint8 of shape (height, width, 3 or 4), or with pixel_format "
            "'yuyv' (height, width, 2)"
        )
    if pixels.dtype.itemsize == 2 and (
        pixels.dtype.byteorder == ">" or (pixels.dtype.byteorder == "=" and sys.byteorder == "big")
    ):
        pixels = pixels.astype("<u2")
    height, width = pixels.shape[:2]
    return ImageMessage(width=width, height=height, encoding=IMAGE_ENCODING.number[encoding], data=pixels.tobytes())


def rgb(image: Any) -> np.ndarray[Any, np.dtype[np.uint8]] | None:
    """Return an image of the wire as (height, width, 3) RGB, or None if that needs a package that is not installed."""
    encoding = IMAGE_ENCODING.name[image.encoding]
    if encoding in ("png", "jpeg"):
        try:
            pillow = importlib.import_module("PIL.Image")
        except ImportError:
            return None
        with pillow.open(BytesIO(image.data)) as picture:
            if picture.mode.startswith("I"):
                return _gray((np.asarray(picture).astype(np.uint32) >> 8).astype(np.uint8))
            return np.asarray(picture.convert("RGB"))
    shape = (image.height, image.width)
    if encoding == "mono16":
        deep = np.frombuffer(image.data, "<u2").reshape(shape)
        # As cameras send them: with fewer bits at the lower end.
        return _gray((deep >> max(int(deep.max()).bit_length() - 8, 0)).astype(np.uint8))
    pixels = np.frombuffer(image.data, np.uint8).reshape(*shape, -1)
    if encoding in ("mono8", "yuyv"):
        return _gray(pixels[:, :, 0])
    return np.ascontiguousarray(pixels[:, :, 2::-1] if encoding.startswith("bgr") else pixels[:, :, :3])


def _gray(pixels: np.ndarray[Any, np.dtype[np.uint8]]) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.repeat(pixels[:, :, None], 3, axis=2)
