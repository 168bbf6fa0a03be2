"""Exchanges with a server over HTTP, on connections that are kept."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Mapping

from ._access import Access
from ._connection import Address, Answer, Connection
from .errors import InterruptedExchangeError, NoAnswerError, StereoError


class Http:
    """Exchanges with one server."""

    def __init__(self, url: str, timeout_s: float, access: Access) -> None:
        self.address = Address.parse(url)
        self._access = access
        self._context = access.context() if self.address.is_secure else None
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
            data = await connection.whole_body()
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
        return await Connection.open(self.address, self._access, self._context)

    async def _connection(self) -> Connection:
        while self._idle:
            connection = self._idle.pop()
            if connection.is_fresh():
                return connection
            connection.close()
        return await Connection.open(self.address, self._access, self._context)

    async def close(self) -> None:
        """Close what is not in use."""
        while self._idle:
            self._idle.pop().close()
