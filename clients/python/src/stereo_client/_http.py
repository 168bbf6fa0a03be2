"""HTTP/1.1 over asyncio: connections that are kept, one exchange at a time on each, bodies that stream both ways."""

from __future__ import annotations

import asyncio
import contextlib
import re
import socket
from collections.abc import AsyncGenerator, AsyncIterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias
from urllib.parse import urlsplit

from .errors import (
    InputError,
    InterruptedExchangeError,
    MalformedReplyError,
    NoAnswerError,
    StereoError,
    UnreachableError,
)

CONNECT_TIMEOUT_S = 5.0
_HEAD_BYTES = 64 << 10

Body: TypeAlias = "bytes | AsyncIterator[bytes]"


@dataclass(frozen=True)
class Answer:
    """The head of an answer."""

    code: int
    headers: Mapping[str, str]

    @property
    def media_type(self) -> str:
        """Its media type without parameters."""
        return self.headers.get("content-type", "").partition(";")[0].strip().lower()


@dataclass(frozen=True)
class Address:
    """Where a server is."""

    url: str
    host: str
    port: int
    prefix: str

    @classmethod
    def parse(cls, url: str) -> Address:
        """Return the address that `url` names."""
        try:
            parts = urlsplit(url)
            port = parts.port or 80
        except ValueError as why:
            raise InputError(f"{url!r} is no address ({why}): give one such as http://127.0.0.1:8080") from why
        if parts.scheme != "http" or not parts.hostname:
            raise InputError(
                f"{url!r} is no address of a server: give one such as http://127.0.0.1:8080 or zenoh://router:7447"
            )
        return cls(url.rstrip("/"), parts.hostname, port, parts.path.rstrip("/"))


class Connection:
    """One connection. It is closed after anything that leaves it in the middle of an exchange.

    It is a plain socket: when a server has said why and closed, an asyncio transport that still writes fails before that is read.
    """

    def __init__(self, address: Address, connected: socket.socket) -> None:
        self.address = address
        self.is_used = False
        self._socket = connected
        self._loop = asyncio.get_running_loop()
        self._arrived = bytearray()
        self._length: int | None = None
        self._may_be_kept = False

    @classmethod
    async def open(cls, address: Address) -> Connection:
        """Connect."""
        url = address.url
        try:
            return cls(address, await asyncio.wait_for(_connect(address.host, address.port), CONNECT_TIMEOUT_S))
        except socket.gaierror as why:
            raise UnreachableError(f"the host {address.host!r} of {url} can't be found: check the address") from why
        except ConnectionRefusedError as why:
            raise UnreachableError(
                f"nothing listens at {url}: start the server there with `stereod serve`, or check host and port"
            ) from why
        except (TimeoutError, asyncio.TimeoutError) as why:
            raise UnreachableError(
                f"{url} does not answer within {CONNECT_TIMEOUT_S:.0f} s: check the host, and that no firewall is in between"
            ) from why
        except OSError as why:
            raise UnreachableError(
                f"{url} can't be reached ({why}): check the address, and that `stereod serve` runs there"
            ) from why

    def is_fresh(self) -> bool:
        """Whether it can take another exchange, as far as this side knows."""
        try:
            self._socket.recv(1, socket.MSG_PEEK)
        except BlockingIOError:
            return not self._arrived
        except OSError:
            pass
        # The end, or something that nobody asked for.
        return False

    def abort(self) -> None:
        """End what is under way on it."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Drop it, when nothing is under way any more."""
        self._socket.close()

    async def send_head(self, method: str, path: str, headers: Mapping[str, str]) -> None:
        """Write the head of a request."""
        host = f"[{self.address.host}]" if ":" in self.address.host else self.address.host
        lines = [f"{method} {self.address.prefix}{path} HTTP/1.1", f"Host: {host}:{self.address.port}"]
        lines += [f"{name}: {value}" for name, value in headers.items()]
        await self._send("\r\n".join([*lines, "\r\n"]).encode("latin-1"))

    async def send_body(self, body: Body) -> None:
        """Write the body of a request: at once, or in chunks as they come."""
        if isinstance(body, bytes):
            await self._send(body)
            return
        async for piece in body:
            await self._send(b"%x\r\n%b\r\n" % (len(piece), piece))
        await self._send(b"0\r\n\r\n")

    async def receive_head(self) -> Answer:
        """Read the head of the answer."""
        while True:
            answer = self._parse(await self._until(b"\r\n\r\n"))
            if answer.code >= 200:
                return answer

    async def pieces(self) -> AsyncGenerator[bytes, None]:
        """Read the answer's body as it comes."""
        if self._length is not None:
            yield await self._exactly(self._length)
            return
        while size := self._chunk_size(await self._until(b"\r\n")):
            yield await self._exactly(size)
            await self._exactly(2)
        while (await self._until(b"\r\n")) != b"\r\n":
            pass

    def may_be_kept(self) -> bool:
        """Whether the server keeps the connection after this exchange."""
        return self._may_be_kept

    def _parse(self, head: bytes) -> Answer:
        if len(head) > _HEAD_BYTES:
            raise self._not_http()
        status, *lines = head.decode("latin-1").split("\r\n")
        version, _, rest = status.partition(" ")
        if not version.startswith("HTTP/1.") or not rest[:3].isdigit():
            raise self._not_http()
        named = (line.partition(":") for line in lines if line)
        answer = Answer(int(rest[:3]), {name.strip().lower(): value.strip() for name, _, value in named})
        is_chunked = answer.headers.get("transfer-encoding", "").lower() == "chunked"
        length = answer.headers.get("content-length", "0" if answer.code < 200 or answer.code in (204, 304) else "")
        if not is_chunked and not length.isdigit():
            raise self._not_http()
        self._length = None if is_chunked else int(length)
        self._may_be_kept = version == "HTTP/1.1" and answer.headers.get("connection", "").lower() != "close"
        return answer

    def _chunk_size(self, line: bytes) -> int:
        digits = line.partition(b";")[0].strip()
        if not re.fullmatch(rb"[0-9a-fA-F]{1,8}", digits):
            raise self._not_http()
        return int(digits, 16)

    async def _send(self, data: bytes) -> None:
        try:
            await self._loop.sock_sendall(self._socket, data)
        except OSError as why:
            raise self._broken(why.strerror or str(why)) from why

    async def _receive(self, buffer: memoryview) -> int:
        try:
            count = await self._loop.sock_recv_into(self._socket, buffer)
        except OSError as why:
            raise self._broken(why.strerror or str(why)) from why
        if count == 0:
            raise self._broken("it closed the connection before the answer was whole")
        return count

    async def _until(self, mark: bytes) -> bytes:
        """Read up to and with `mark`, which is never far."""
        piece = bytearray(_HEAD_BYTES)
        seen = 0
        while (end := self._arrived.find(mark, max(seen - len(mark), 0))) < 0:
            seen = len(self._arrived)
            if seen > _HEAD_BYTES or (not self._arrived.startswith(b"HTTP/1."[:seen]) and mark == b"\r\n\r\n"):
                raise self._not_http()
            try:
                count = await self._receive(memoryview(piece))
            except InterruptedExchangeError:
                if seen and not self._arrived.startswith(b"HTTP/1.") and mark == b"\r\n\r\n":
                    raise self._not_http() from None
                raise
            self._arrived += memoryview(piece)[:count]
        found = bytes(self._arrived[: end + len(mark)])
        del self._arrived[: end + len(mark)]
        return found

    async def _exactly(self, length: int) -> bytes:
        data = bytearray(length)
        place = min(length, len(self._arrived))
        data[:place] = self._arrived[:place]
        del self._arrived[:place]
        view = memoryview(data)
        while place < length:
            place += await self._receive(view[place:])
        return bytes(data)

    def _not_http(self) -> MalformedReplyError:
        return MalformedReplyError(
            f"what answers at {self.address.url} does not speak HTTP: check host and port of stereod"
        )

    def _broken(self, why: str) -> InterruptedExchangeError:
        return InterruptedExchangeError(
            f"the connection to {self.address.url} broke ({why}): check that the server still runs, and send the request again"
        )


class Http:
    """Exchanges with one server."""

    def __init__(self, url: str, timeout_s: float) -> None:
        self.address = Address.parse(url)
        self._timeout_s = timeout_s
        self._idle: list[Connection] = []

    async def exchange(
        self, method: str, path: str, headers: Mapping[str, str], body: bytes = b"", timeout_s: float | None = None
    ) -> tuple[Answer, bytes]:
        """Send a request and take its whole answer."""
        limit_s = self._timeout_s if timeout_s is None else timeout_s
        try:
            return await asyncio.wait_for(self._exchange(method, path, headers, body), limit_s)
        except StereoError:
            raise
        except (TimeoutError, asyncio.TimeoutError) as why:
            raise NoAnswerError(
                f"{self.address.url} did not answer within {limit_s:g} s: look whether the server hangs or the link is too slow"
            ) from why

    async def _exchange(self, method: str, path: str, headers: Mapping[str, str], body: bytes) -> tuple[Answer, bytes]:
        headers = {**headers, "Content-Length": str(len(body))}
        while True:
            connection = await self._connection()
            try:
                return await self._exchange_on(connection, method, path, headers, body)
            except InterruptedExchangeError:
                # The server may have closed a resting connection just before: once more, on one that is new.
                if not connection.is_used:
                    raise

    async def _exchange_on(
        self, connection: Connection, method: str, path: str, headers: Mapping[str, str], body: bytes
    ) -> tuple[Answer, bytes]:
        is_done = False
        await connection.send_head(method, path, headers)
        sending = asyncio.create_task(connection.send_body(body))
        try:
            answer = await connection.receive_head()
            data = b"".join([piece async for piece in connection.pieces()])
            # An answer that came before all was sent is a refusal, after which the server closes.
            is_done = sending.done() and not sending.cancelled() and sending.exception() is None
            return answer, data
        finally:
            sending.cancel()
            with contextlib.suppress(asyncio.CancelledError, StereoError):
                await sending
            if is_done and connection.may_be_kept():
                connection.is_used = True
                self._idle.append(connection)
            else:
                connection.close()

    async def open(self) -> Connection:
        """Return a new connection, which is the caller's to close."""
        return await Connection.open(self.address)

    async def _connection(self) -> Connection:
        while self._idle:
            connection = self._idle.pop()
            if connection.is_fresh():
                return connection
            connection.close()
        return await Connection.open(self.address)

    async def close(self) -> None:
        """Close what is not in use."""
        while self._idle:
            self._idle.pop().close()


async def _connect(host: str, port: int) -> socket.socket:
    """Connect to the first of the host's addresses that takes it."""
    loop = asyncio.get_running_loop()
    refused: OSError = OSError("it has no address")
    for family, kind, protocol, _, address in await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        connecting = socket.socket(family, kind, protocol)
        try:
            connecting.setblocking(False)
            connecting.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            await loop.sock_connect(connecting, address)
        except OSError as why:
            connecting.close()
            refused = why
        except BaseException:
            connecting.close()
            raise
        else:
            return connecting
    raise refused
