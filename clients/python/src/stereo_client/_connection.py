"""A connection that speaks HTTP/1.1, for asyncio: one exchange at a time, bodies that stream both ways."""

from __future__ import annotations

import asyncio
import re
import socket
import ssl
from collections.abc import AsyncGenerator, AsyncIterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias
from urllib.parse import urlsplit

from ._access import Access
from ._wire import TlsWire, Wire
from .errors import (
    InputError,
    InsecureConnectionError,
    InterruptedExchangeError,
    MalformedReplyError,
    UnreachableError,
)

CONNECT_TIMEOUT_S = 5.0
MOST_BYTES = 1 << 30
"""Longest body, or message of a batch, that is taken: several times the largest result."""
_HEAD_BYTES = 64 << 10
# OpenSSL's numbers for what is wrong with a certificate.
_EXPIRED = 10
_OTHER_NAME = (62, 64)
_UNKNOWN_ISSUER = (18, 19, 20, 21)

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
    is_secure: bool

    @classmethod
    def parse(cls, url: str) -> Address:
        """Return the address that `url` names."""
        try:
            parts = urlsplit(url)
            port = parts.port or (443 if parts.scheme == "https" else 80)
        except ValueError as why:
            raise InputError(f"{url!r} is no address ({why}): give one such as http://127.0.0.1:8080") from why
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise InputError(
                f"{url!r} is no address of a server: give one such as http://127.0.0.1:8080 or zenoh://router:7447"
            )
        return cls(url.rstrip("/"), parts.hostname, port, parts.path.rstrip("/"), parts.scheme == "https")


class Connection:
    """One connection. It is closed after anything that leaves it in the middle of an exchange."""

    def __init__(self, address: Address, access: Access, wire: Wire) -> None:
        self.address = address
        self.is_used = False
        self._access = access
        self._wire = wire
        self._arrived = bytearray()
        self._length: int | None = None
        self._may_be_kept = False

    @classmethod
    async def open(cls, address: Address, access: Access, context: ssl.SSLContext | None) -> Connection:
        """Connect; by TLS if there is a context for it."""
        url = address.url
        try:
            return cls(address, access, await asyncio.wait_for(_connect(address, context), CONNECT_TIMEOUT_S))
        except ssl.SSLError as why:
            raise _insecure(url, why) from why
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
        # What has come is the end, or something that nobody asked for.
        return not self._arrived and self._wire.is_silent()

    def abort(self) -> None:
        """End what is under way on it."""
        self._wire.abort()

    def close(self) -> None:
        """Drop it, when nothing is under way any more."""
        self._wire.close()

    async def send_head(self, method: str, path: str, headers: Mapping[str, str]) -> None:
        """Write the head of a request."""
        host = f"[{self.address.host}]" if ":" in self.address.host else self.address.host
        lines = [f"{method} {self.address.prefix}{path} HTTP/1.1", f"Host: {host}:{self.address.port}"]
        lines += [f"{name}: {value}" for name, value in {**self._access.headers(), **headers}.items()]
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
            answer = self._parse(await self._until(b"\r\n\r\n", b"HTTP/1."))
            if answer.code >= 200:
                return answer

    async def whole_body(self) -> bytes:
        """Read the answer's body."""
        data = bytearray()
        async for piece in self.pieces():
            data += piece
            if len(data) > MOST_BYTES:
                raise self._not_http()
        return bytes(data)

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
            await self._wire.send(data)
        except ssl.SSLError as why:
            raise _insecure(self.address.url, why) from why
        except OSError as why:
            raise self._broken(why.strerror or str(why)) from why

    async def _receive(self, buffer: memoryview) -> int:
        try:
            count = await self._wire.receive(buffer)
        except ssl.SSLError as why:
            raise _insecure(self.address.url, why) from why
        except OSError as why:
            raise self._broken(why.strerror or str(why)) from why
        if count == 0:
            raise self._broken("it closed the connection before the answer was whole")
        return count

    async def _until(self, mark: bytes, start: bytes = b"") -> bytes:
        """Read up to and with `mark`, which is never far; what comes begins with `start`."""
        piece = bytearray(_HEAD_BYTES)
        seen = 0
        while (end := self._arrived.find(mark, max(seen - len(mark), 0))) < 0:
            seen = len(self._arrived)
            if seen > _HEAD_BYTES or self._arrived[: len(start)] != start[:seen]:
                raise self._not_http()
            count = await self._receive(memoryview(piece))
            self._arrived += memoryview(piece)[:count]
        found = bytes(self._arrived[: end + len(mark)])
        del self._arrived[: end + len(mark)]
        return found

    async def _exactly(self, length: int) -> bytes:
        if length > MOST_BYTES:
            raise self._not_http()
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
            f"what answers at {self.address.url} does not speak HTTP as stereod does: check host and port, or use https:// if it has TLS"
        )

    def _broken(self, why: str) -> InterruptedExchangeError:
        if self.address.is_secure and not self.is_used and self._access.cert is None:
            # By TLS 1.3, a server that misses a certificate says so after the handshake, and by closing may take its words back.
            return InterruptedExchangeError(
                f"{self.address.url} ended the connection without an answer ({why}): check that it still runs, or, if it asks for a "
                "certificate of its clients, give one as cert"
            )
        return InterruptedExchangeError(
            f"the connection to {self.address.url} broke ({why}): check that the server still runs, and send the request again"
        )


def _insecure(url: str, error: ssl.SSLError) -> InsecureConnectionError:
    """Return what TLS has against a connection, and what to do about it."""
    reason = (error.reason or str(error)).upper()
    if isinstance(error, ssl.SSLCertVerificationError):
        if error.verify_code == _EXPIRED:
            why = "its certificate has expired: renew it, or set this machine's clock"
        elif error.verify_code in _OTHER_NAME:
            why = "its certificate is for another name: use the name that it is for"
        elif error.verify_code in _UNKNOWN_ISSUER:
            why = "its certificate is signed by nobody who is trusted here: give the certificate of its authority as ca"
        else:
            why = f"its certificate is not accepted ({error.verify_message}): give the server another one"
    elif "CERTIFICATE_REQUIRED" in reason or "HANDSHAKE_FAILURE" in reason:
        why = "it asks for a certificate of its clients: give one that its authority has signed as cert"
    elif "ALERT" in reason:
        why = f"it has ended the handshake ({error.reason}): give a cert that it accepts, or look into its log"
    elif reason in ("WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE", "HTTP_REQUEST", "UNEXPECTED_EOF_WHILE_READING"):
        why = "what answers there speaks no TLS: use http://, or correct the port"
    else:
        why = f"TLS failed ({error.reason or error}): look into the server's log"
    return InsecureConnectionError(f"no secure connection to {url}: {why}")


async def _connect(address: Address, context: ssl.SSLContext | None) -> Wire:
    """Connect to the first of the host's addresses that takes it."""
    connected = await _socket(address.host, address.port)
    if context is None:
        return Wire(connected)
    try:
        wire = TlsWire(connected, context, address.host)
        await wire.shake_hands()
    except BaseException:
        connected.close()
        raise
    return wire


async def _socket(host: str, port: int) -> socket.socket:
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
