"""All servers of a Zenoh network."""

from __future__ import annotations

import asyncio
import os
import time
from collections import deque
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing
from typing import Any

from google.protobuf.message import DecodeError

from ._fleet import Fleet
from ._schema import PRIORITY_CLASS, BatchReply, CameraSettings, Status, StereoResult
from ._zenoh_session import ZenohSession
from .errors import (
    DeadlineInfeasibleError,
    DrainingError,
    InputError,
    InterruptedExchangeError,
    MalformedReplyError,
    NoFramesError,
    NoServerError,
    QueueFullError,
    RefusedError,
    StereoError,
    refusal,
)

_PARTS = {None: "StereoResult", "disparity": "Disparity", "mesh": "Mesh", "report": "ExecutionReport"}
_PARTIAL = "?partial=true"
_FULL_FOR_MS = 50.0


class OverZenoh:
    """The transport that `zenoh://` addresses have."""

    def __init__(self, url: str, timeout_s: float, config: str | os.PathLike[str] | None) -> None:
        self.url = url
        self.session = ZenohSession(url, config)
        self.fleet = Fleet(self.session)
        self._timeout_s = timeout_s

    async def match(self, request: Any) -> Any:
        """Return the result of the least busy server; if that one is gone, stops or is full, of the next one."""
        await self.fleet.watch()
        start = time.monotonic()
        budget_ns = (
            request.options.latency_budget.ToNanoseconds() if request.options.HasField("latency_budget") else None
        )
        tried: set[str] = set()
        refused: StereoError | None = None
        while (instance := self.fleet.choose(tried)) is not None:
            tried.add(instance)
            if refused is not None and budget_ns is not None:
                left_ns = budget_ns - int((time.monotonic() - start) * 1e9)
                if left_ns <= 0:
                    raise refused
                request.options.latency_budget.FromNanoseconds(left_ns)
            try:
                return await self._ask_one(instance, request)
            except (
                NoServerError,
                InterruptedExchangeError,
                DrainingError,
                QueueFullError,
                DeadlineInfeasibleError,
            ) as why:
                refused = why
        if refused is not None:
            raise refused
        raise self._nobody()

    async def _ask_one(self, instance: str, request: Any) -> Any:
        result = None
        self.fleet.count(instance, 1)
        try:
            async with aclosing(self._ask(instance, "", request)) as replies:
                async for reply in replies:
                    result = reply
        finally:
            self.fleet.count(instance, -1)
        if result is None:
            raise NoServerError(f"the server {instance} has gone: look at its log, and send the request again")
        return result

    async def anytime(self, request: Any) -> AsyncGenerator[Any, None]:
        """Yield better and better results of the least busy server."""
        await self.fleet.watch()
        instance = self.fleet.choose(set())
        if instance is None:
            raise self._nobody()
        async with aclosing(self._ask(instance, _PARTIAL, request)) as replies:
            async for reply in replies:
                yield reply

    async def _ask(self, instance: str, parameters: str, request: Any) -> AsyncGenerator[Any, None]:
        replies = self.session.replies(
            f"stereo/v1/compute/{instance}{parameters}",
            request.SerializeToString(),
            "StereoRequest",
            self._timeout_s,
            is_alive=lambda: self.fleet.is_alive(instance),
        )
        async with aclosing(replies):
            async for reply in replies:
                yield _decoded(StereoResult, _accepted(reply))

    async def batch(self, requests: AsyncIterator[Any]) -> AsyncGenerator[Any, None]:
        """Yield a `stereo.v1.BatchReply` for each request as they are done; no more are sent than the servers work on."""
        await self.fleet.watch()
        reading: asyncio.Task[Any] | None = None
        work: set[asyncio.Task[Any]] = set()
        is_reading = True
        try:
            while is_reading or work:
                # One more than can be worked on, so that no worker waits for the network.
                most = 1 + sum(server.workers for server in self.fleet.servers())
                if is_reading and reading is None and len(work) < most:
                    reading = asyncio.ensure_future(anext(requests, None))
                await asyncio.wait({reading, *work} if reading else work, return_when=asyncio.FIRST_COMPLETED)
                if reading is not None and reading.done():
                    request, reading = reading.result(), None
                    if request is None:
                        is_reading = False
                    else:
                        work.add(asyncio.create_task(self._reply(request)))
                for task in [task for task in work if task.done()]:
                    work.remove(task)
                    yield task.result()
        finally:
            rest = [*work, reading] if reading else [*work]
            for task in rest:
                task.cancel()
            await asyncio.gather(*rest, return_exceptions=True)

    async def _reply(self, request: Any) -> Any:
        request.options.priority_class = PRIORITY_CLASS.number["background"]
        while True:
            try:
                return BatchReply(request_id=request.request_id, result=await self.match(request))
            except QueueFullError as why:
                # A batch waits, as it does over HTTP.
                await asyncio.sleep((why.earliest_feasible_ms or _FULL_FOR_MS) / 1e3)
            except RefusedError as why:
                return BatchReply(request_id=request.request_id, status=why.to_status())

    async def results(self, camera: str, part: str | None, timeout_s: float) -> AsyncGenerator[Any, None]:
        """Yield the results of a camera as they come; a slow reader gets the newest."""
        if part not in _PARTS:
            raise InputError(f"there is no stream of {part!r} alone: there are disparity, mesh and report")
        name = camera_name(camera)
        await self.fleet.watch()
        newest: deque[Any] = deque(maxlen=1)
        arrived = asyncio.Event()

        def take(sample: Any) -> None:
            newest.append(sample)
            arrived.set()

        subscriber = await self.session.subscribe(f"stereo/v1/results/{name}" + (f"/{part}" if part else ""), take)
        try:
            while True:
                try:
                    await asyncio.wait_for(arrived.wait(), timeout_s)
                except (TimeoutError, asyncio.TimeoutError):
                    raise self._no_frames(name, timeout_s) from None
                arrived.clear()
                sample = newest.pop()
                if sample is None:
                    raise InterruptedExchangeError(f"the session over {self.url} has been closed: make another client")
                yield _result(part, sample.payload.to_bytes())
        finally:
            await asyncio.to_thread(subscriber.undeclare)

    def _no_frames(self, camera: str, waited_s: float) -> StereoError:
        """Say why nothing comes out."""
        if self.fleet.choose(set()) is None:
            return self._nobody()
        cameras = dict(self.fleet.cameras())
        if owner := cameras.get(camera):
            return NoFramesError(
                f"the camera {camera!r} is served by {owner}, but no result came for {waited_s:g} s: check that it sends frames to "
                f"stereo/v1/frames/{camera}, and GET /v1/streams/{camera} for why they are dropped"
            )
        if camera in cameras:
            return NoFramesError(
                f"the camera {camera!r} is there, but no server serves it: look at the log of the servers"
            )
        others = f"there are {', '.join(cameras)}" if cameras else "no camera has announced itself"
        return NoFramesError(
            f"there is no camera {camera!r} ({others}): start it, and let it declare the liveliness token stereo/v1/camera/{camera}"
        )

    async def cameras(self) -> list[tuple[str, str | None]]:
        """Return the cameras that are there, and who serves each."""
        await self.fleet.watch()
        return self.fleet.cameras()

    async def settings(self, camera: str, message: Any) -> Any:
        """Return the settings of a camera, after they were changed if `message` is not None."""
        payload = None if message is None else message.SerializeToString()
        key = f"stereo/v1/settings/{camera_name(camera)}"
        async with aclosing(
            self.session.replies(key, payload, "CameraSettings", self._timeout_s, query_all=True)
        ) as replies:
            async for reply in replies:
                return _decoded(CameraSettings, _accepted(reply))
        raise self._nobody()

    async def wait_ready(self, timeout_s: float) -> None:
        """Wait until there is a server."""
        await self.fleet.watch()
        try:
            await asyncio.wait_for(self.fleet.until(lambda: self.fleet.choose(set()) is not None), timeout_s)
        except (TimeoutError, asyncio.TimeoutError) as why:
            raise self._nobody() from why

    async def close(self) -> None:
        """Close the session."""
        await self.session.close()

    def _nobody(self) -> NoServerError:
        return NoServerError(
            f"there is no server on the Zenoh network of {self.url}: start `stereod serve` with --zenoh-connect to the same router, "
            "or look at its /readyz"
        )


def camera_name(camera: str) -> str:
    """Return a name that can stand in a key."""
    if (
        not isinstance(camera, str)
        or not 0 < len(camera) <= 64
        or not all(c.isascii() and (c.isalnum() or c in "_.-") for c in camera)
    ):
        raise InputError(f"{camera!r} is no name of a camera: give 1 to 64 of the characters A-Z a-z 0-9 _ . -")
    return camera


def _accepted(reply: Any) -> bytes:
    if reply.ok is not None:
        data: bytes = reply.ok.payload.to_bytes()
        return data
    raise refusal(_decoded(Status, reply.err.payload.to_bytes()))


def _result(part: str | None, data: bytes) -> Any:
    if part is None:
        return _decoded(StereoResult, data)
    result = StereoResult()
    try:
        getattr(result, part).MergeFromString(data)
    except DecodeError as why:
        raise MalformedReplyError(f"the stream's {part} can't be read: the client and the server don't fit") from why
    return result


def _decoded(message: Any, data: bytes) -> Any:
    try:
        return message.FromString(data)
    except DecodeError as why:
        raise MalformedReplyError(
            "the server's answer is no message that can be read: the client and the server don't fit"
        ) from why
