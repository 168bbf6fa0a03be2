"""Who is there on a Zenoh network: servers and how busy they are, cameras and who serves them; and who gets the next request."""

from __future__ import annotations

import asyncio
import contextlib
import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ._schema import ServerLoad
from ._zenoh_session import ZenohSession, is_put
from .report import ms

SILENCE_S = 2.0
"""A server that has not told its load for so long is frozen or cut off."""
_FIRST_LOAD_WITHIN_S = 1.0


@dataclass(frozen=True)
class ServerInfo:
    """What a server tells about itself, five times a second.

    Attributes
    ----------
    instance : str
        Its name.
    workers, busy_workers : int
        Threads that compute, and those that are at a frame.
    waiting : int
        Frames that wait for a worker.
    backlog_ms : float
        Time until the workers are through with everything promised, on the average.
    mandatory_load, full_load : float
        Work offered lately as a share of what the workers can do: what is promised, and every rung that was asked for.
    overload_rung : int
        Level of the overload ladder: 0 nothing is cut, 5 refusing.
    draining : bool
        Whether it is stopping.
    cameras : int
        Cameras it serves.
    """

    instance: str
    workers: int
    busy_workers: int
    waiting: int
    backlog_ms: float
    mandatory_load: float
    full_load: float
    overload_rung: int
    draining: bool
    cameras: int

    @classmethod
    def from_message(cls, message: Any) -> ServerInfo:
        """Return what a `stereo.v1.ServerLoad` says."""
        names = (name for name in cls.__dataclass_fields__ if name != "backlog_ms")
        return cls(backlog_ms=ms(message.backlog), **{name: getattr(message, name) for name in names})


class _Server:
    def __init__(self) -> None:
        self.load: ServerInfo | None = None
        self.heard = time.monotonic()
        self.under_way = 0

    def occupancy(self) -> tuple[float, float]:
        """Return how many requests a worker has, as told lately or as sent from here since, and the backlog."""
        if self.load is None:
            return float(self.under_way), 0.0
        told = self.load.busy_workers + self.load.waiting
        return max(told, self.under_way) / max(self.load.workers, 1), self.load.backlog_ms


class Fleet:
    """Follows servers and cameras from the first time it is asked."""

    def __init__(self, session: ZenohSession) -> None:
        self._session = session
        self._servers: dict[str, _Server] = {}
        self._cameras: set[str] = set()
        self._owners: dict[str, set[str]] = {}
        self._waiting: list[asyncio.Future[None]] = []
        self._watching: asyncio.Task[None] | None = None

    async def watch(self) -> None:
        """Begin to follow who is there, and wait until that is known and the servers have told their load."""
        if self._watching is None:
            self._watching = asyncio.create_task(self._watch())
        # One caller that is cancelled must not stop the others.
        await asyncio.shield(self._watching)

    async def _watch(self) -> None:
        try:
            await self._session.subscribe("stereo/v1/load/*", self._told)
            for pattern, note in (
                ("stereo/v1/alive/*", self._server),
                ("stereo/v1/camera/*", self._camera),
                ("stereo/v1/owner/*/*", self._owner),
            ):
                await self._session.subscribe(pattern, self._presence(note), is_liveliness=True)
                # What was there before comes in its own time; once this is answered, all of it is known.
                for key in await self._session.alive(pattern):
                    note(key.split("/")[3:], True)
        except BaseException:
            self._watching = None
            raise
        with contextlib.suppress(TimeoutError, asyncio.TimeoutError):
            told = self.until(lambda: all(server.load is not None for server in self._servers.values()))
            await asyncio.wait_for(told, _FIRST_LOAD_WITHIN_S)

    async def until(self, is_so: Callable[[], bool]) -> None:
        """Wait until something is so, as far as it depends on who is there."""
        while not is_so():
            change: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            self._waiting.append(change)
            await change

    def _presence(self, note: Callable[[list[str], bool], None]) -> Callable[[Any], None]:
        def take(sample: Any) -> None:
            if sample is not None:
                note(str(sample.key_expr).split("/")[3:], is_put(sample))
                self._changed()

        return take

    def _changed(self) -> None:
        waiting, self._waiting = self._waiting, []
        for change in waiting:
            if not change.done():
                change.set_result(None)

    def _server(self, names: list[str], is_there: bool) -> None:
        if is_there:
            self._servers.setdefault(names[0], _Server())
        else:
            self._servers.pop(names[0], None)

    def _camera(self, names: list[str], is_there: bool) -> None:
        (self._cameras.add if is_there else self._cameras.discard)(names[0])

    def _owner(self, names: list[str], is_there: bool) -> None:
        owners = self._owners.setdefault(names[0], set())
        (owners.add if is_there else owners.discard)(names[1])
        if not owners:
            del self._owners[names[0]]

    def _told(self, sample: Any) -> None:
        if sample is None:
            return
        server = self._servers.get(str(sample.key_expr).rpartition("/")[2])
        if server is not None:
            server.load = ServerInfo.from_message(ServerLoad.FromString(sample.payload.to_bytes()))
            server.heard = time.monotonic()
            self._changed()

    def is_alive(self, instance: str) -> bool:
        """Whether a server is there and has told its load lately."""
        server = self._servers.get(instance)
        return server is not None and time.monotonic() - server.heard < SILENCE_S

    def servers(self) -> list[ServerInfo]:
        """Return what the servers that are there have told, by their names."""
        loads = [server.load for name, server in self._servers.items() if self.is_alive(name)]
        return sorted((load for load in loads if load is not None), key=lambda load: load.instance)

    def cameras(self) -> list[tuple[str, str | None]]:
        """Return the cameras that are there, and who serves each."""
        return [(name, self.owner(name)) for name in sorted(self._cameras | self._owners.keys())]

    def owner(self, camera: str) -> str | None:
        """Return who serves a camera."""
        return min(self._owners.get(camera, ()), default=None)

    def choose(self, tried: set[str]) -> str | None:
        """Return the least busy server that takes work and was not tried; None if there is none."""
        candidates = [
            (server.occupancy(), random.random(), name)
            for name, server in self._servers.items()
            if name not in tried and self.is_alive(name) and not (server.load is not None and server.load.draining)
        ]
        return min(candidates)[2] if candidates else None

    def count(self, instance: str, change: int) -> None:
        """Note that a request has been sent to a server, or has ended."""
        server = self._servers.get(instance)
        if server is not None:
            server.under_way += change
