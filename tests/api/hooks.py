"""What the fuzzer has to know of our bytes: how they are sent, and what a picture looks like."""

import struct
import zlib
from typing import Any

import schemathesis
from hypothesis import strategies as st


def png(shift_px: int) -> bytes:
    """A small gray picture with texture, moved to the left."""
    width, height = 96, 64
    noise = [
        [(column * 7919 + row * 104729) * 2654435761 >> 7 & 255 for column in range(width + 8)] for row in range(height)
    ]
    rows = b"".join(b"\0" + bytes(row[shift_px : shift_px + width]) for row in noise)

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


PICTURES = [png(0), png(5)]

schemathesis.openapi.format("binary", st.sampled_from(PICTURES) | st.binary())


@schemathesis.serializer("application/x-protobuf")
def protobuf(_context: Any, value: Any) -> bytes:
    data = getattr(value, "data", value)
    return data if isinstance(data, bytes) else str(data).encode()
