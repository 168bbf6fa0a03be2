"""A server over HTTP."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncGenerator, AsyncIterator
from typing import Any
from urllib.parse import quote

from google.protobuf.message import DecodeError

from ._access import Access
from ._connection import Answer, Connection
from ._delimited import Delimited, delimited
from ._http import Http
from ._schema import BatchReply, Status, StereoResult
from .errors import (
    InterruptedExchangeError,
    MalformedReplyError,
    NoFramesError,
    NotServedError,
    RefusedError,
    StereoError,
    UnreachableError,
    refusal,
)

_PROTOBUF = "application/x-protobuf"
_DELIMITED = "application/x-protobuf; delimited=true"
_READY_INTERVAL_S = 0.02


class OverHttp:
    """The transport that `http://` and `https://` addresses have."""

    def __init__(self, url: str, timeout_s: float, access: Access) -> None:
        self._http = Http(url, timeout_s, access)
        self.url = self._http.address.url

    async def match(self, request: Any) -> Any:
        """Return the `stereo.v1.StereoResult` of a `stereo.v1.StereoRequest`."""
        headers = {"Content-Type": _PROTOBUF, "Accept": _PROTOBUF}
        answer, data = await self._http.exchange("POST", "/v1/stereo", headers, request.SerializeToString())
        return _decoded(StereoResult, self._accepted(answer, data))

    async def anytime(self, request: Any) -> AsyncGenerator[Any, None]:
        """Yield the one result that HTTP has."""
        yield await self.match(request)

    async def batch(self, requests: AsyncIterator[Any]) -> AsyncGenerator[Any, None]:
        """Yield a `stereo.v1.BatchReply` for each request as they are done, while requests are sent."""
        connection = await self._http.open()
        failed: list[Exception] = []
        sending: asyncio.Task[None] | None = None
        try:
            headers = {"Content-Type": _DELIMITED, "Accept": _PROTOBUF, "Transfer-Encoding": "chunked"}
            await connection.send_head("POST", "/v1/stereo/batch", headers)
            sending = asyncio.create_task(connection.send_body(_delimited(requests, failed, connection)))
            answer = await connection.receive_head()
            if answer.code != 200:
                self._accepted(answer, await connection.whole_body())
            arrived = Delimited()
            async for piece in connection.pieces():
                arrived.push(piece)
                while (message := arrived.next()) is not None:
                    yield _decoded(BatchReply, message)
        except InterruptedExchangeError:
            if failed:
                raise failed[0] from None
            raise
        finally:
            if sending is not None:
                sending.cancel()
                with contextlib.suppress(asyncio.CancelledError, Exception):
                    await sending
            connection.close()

    async def results(self, camera: str, part: str | None, timeout_s: float) -> AsyncGenerator[Any, None]:
        """Yield the results of a camera: the next one each time it is asked for."""
        if part is not None:
            raise NotServedError(f"over HTTP there is no stream of the {part} alone: leave part out, or use zenoh://")
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        while True:
            try:
                answer, data = await self._http.exchange(
                    "GET",
                    f"/v1/streams/{quote(camera, safe='')}/latest",
                    {"Accept": _PROTOBUF},
                    timeout_s=timeout_s + 5,
                )
                result = _decoded(StereoResult, self._accepted(answer, data))
            except RefusedError as why:
                if loop.time() >= deadline or why.code not in (404, 504):
                    if why.code in (404, 504):
                        raise NoFramesError(str(why)) from why
                    raise
                await asyncio.sleep(0.1 if why.code == 404 else 0)
                continue
            yield result
            deadline = loop.time() + timeout_s

    async def cameras(self) -> list[tuple[str, str | None]]:
        """Return the cameras that the server knows, and who serves each."""
        answer, data = await self._http.exchange("GET", "/v1/streams", {"Accept": "application/json"})
        streams = _json(self._accepted(answer, data)).get("streams", [])
        instance = (await self.info())["instance"]
        return sorted((stream["camera"], instance if stream.get("served") else None) for stream in streams)

    async def info(self) -> dict[str, Any]:
        """Return what the server says about itself."""
        answer, data = await self._http.exchange("GET", "/v1/info", {"Accept": "application/json"})
        return _json(self._accepted(answer, data))

    async def wait_ready(self, timeout_s: float) -> None:
        """Wait until the server takes frames."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        while True:
            why: str
            try:
                answer, data = await self._http.exchange("GET", "/readyz", {}, timeout_s=timeout_s)
                if answer.code == 200:
                    return
                why = f"it says {data[:200].decode(errors='replace')}"
            except StereoError as error:
                why = str(error)
            if loop.time() >= deadline:
                raise UnreachableError(
                    f"{self.url} is not ready after {timeout_s:g} s ({why}): look at the server's log"
                )
            await asyncio.sleep(_READY_INTERVAL_S)

    async def close(self) -> None:
        """Close the connections."""
        await self._http.close()

    def _accepted(self, answer: Answer, data: bytes) -> bytes:
        """Return the body of a success; a refusal raises."""
        if answer.code == 200:
            return data
        status = Status()
        if answer.media_type == _PROTOBUF:
            status = _decoded(Status, data)
        elif answer.media_type == "application/problem+json":
            problem = _json(data)
            status.code, status.message = answer.code, str(problem.get("detail", ""))
            names = Status.DESCRIPTOR.fields_by_name["reason"].enum_type.values_by_name
            reason = names.get(f"REASON_{problem.get('reason')}")
            status.reason = reason.number if reason else 0
        if not status.message:
            raise MalformedReplyError(
                f"what answers at {self.url} is no stereod (HTTP {answer.code}): check host and port"
            )
        raise refusal(status)


async def _delimited(
    requests: AsyncIterator[Any], failed: list[Exception], connection: Connection
) -> AsyncIterator[bytes]:
    try:
        async for request in requests:
            yield delimited(request.SerializeToString())
    except Exception as error:
        # Ends the batch: whoever reads the replies finds the connection closed, and here why.
        failed.append(error)
        connection.abort()
        raise


def _decoded(message: Any, data: bytes) -> Any:
    try:
        return message.FromString(data)
    except DecodeError as why:
        raise MalformedReplyError(
            "the server's answer is no message that can be read: the client and the server don't fit"
        ) from why


def _json(data: bytes) -> dict[str, Any]:
    try:
        value = json.loads(data)
    except ValueError as why:
        raise MalformedReplyError("the server's answer is no JSON: the client and the server don't fit") from why
    return value if isinstance(value, dict) else {}
