"""Bytes out and in for asyncio, in the clear or by TLS.

It is a plain socket: when a server has said why and closed, an asyncio transport that still writes fails before that is read.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl

_PIECE = 64 << 10


class Wire:
    """A connected socket."""

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._loop = asyncio.get_running_loop()

    async def send(self, data: bytes) -> None:
        """Write all of it."""
        await self._loop.sock_sendall(self._socket, data)

    async def receive(self, buffer: memoryview) -> int:
        """Read what there is: 0 at the end."""
        return await self._loop.sock_recv_into(self._socket, buffer)

    def is_silent(self) -> bool:
        """Whether nothing has come, not even the end."""
        try:
            self._socket.recv(1, socket.MSG_PEEK)
        except BlockingIOError:
            return True
        except OSError:
            pass
        return False

    def abort(self) -> None:
        """End what is under way on it."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Drop it."""
        self._socket.close()


class TlsWire(Wire):
    """The same by TLS: what goes through the socket is enciphered in between."""

    def __init__(self, connected: socket.socket, context: ssl.SSLContext, host: str) -> None:
        super().__init__(connected)
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._incoming, self._outgoing, server_hostname=host)
        # Sending and receiving both have something to write, which must not get mixed.
        self._writing = asyncio.Lock()

    async def shake_hands(self) -> None:
        """Begin; raises `ssl.SSLError` if one of the two does not trust the other."""
        while True:
            try:
                self._tls.do_handshake()
            except ssl.SSLWantReadError:
                await self._flush()
                await self._fill()
            except ssl.SSLError:
                # The alert that says why.
                with contextlib.suppress(OSError):
                    await self._flush()
                raise
            else:
                await self._flush()
                return

    async def send(self, data: bytes) -> None:
        view = memoryview(data)
        for start in range(0, len(view), _PIECE):
            self._tls.write(view[start : start + _PIECE])
            await self._flush()

    async def receive(self, buffer: memoryview) -> int:
        while True:
            try:
                # With a buffer, it is a number.
                return int(self._tls.read(len(buffer), buffer))
            except ssl.SSLWantReadError:
                await self._flush()
                await self._fill()
            except (ssl.SSLZeroReturnError, ssl.SSLEOFError):
                return 0

    async def _flush(self) -> None:
        async with self._writing:
            while self._outgoing.pending:
                await self._loop.sock_sendall(self._socket, self._outgoing.read())

    async def _fill(self) -> None:
        data = await self._loop.sock_recv(self._socket, 4 * _PIECE)
        if data:
            self._incoming.write(data)
        else:
            self._incoming.write_eof()
