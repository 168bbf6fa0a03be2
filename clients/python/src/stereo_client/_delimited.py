"""Messages one after another, each with its length before it."""

from __future__ import annotations

from ._connection import MOST_BYTES
from .errors import MalformedReplyError

_LONGEST_VARINT = 10


def delimited(message: bytes) -> bytes:
    """Return a message with its length before it."""
    length, head = len(message), bytearray()
    while length > 0x7F:
        head.append(length & 0x7F | 0x80)
        length >>= 7
    head.append(length)
    return bytes(head) + message


class Delimited:
    """Takes pieces of bytes and gives whole messages."""

    def __init__(self) -> None:
        self._arrived = bytearray()
        self._start = 0

    def push(self, piece: bytes) -> None:
        """Add what has arrived."""
        if self._start:
            del self._arrived[: self._start]
            self._start = 0
        self._arrived += piece

    def next(self) -> bytes | None:
        """Return the next message if it is whole."""
        length = shift = 0
        for place in range(self._start, min(self._start + _LONGEST_VARINT, len(self._arrived))):
            byte = self._arrived[place]
            length |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                if length > MOST_BYTES:
                    break
                end = place + 1 + length
                if end > len(self._arrived):
                    return None
                self._start = end
                return bytes(memoryview(self._arrived)[place + 1 : end])
        else:
            if len(self._arrived) - self._start < _LONGEST_VARINT:
                return None
        raise MalformedReplyError("the server's replies can't be read: the client and the server don't fit")
