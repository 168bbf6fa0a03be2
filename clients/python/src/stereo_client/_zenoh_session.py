"""A Zenoh session for asyncio. Zenoh is loaded when the first one is opened, so that HTTP works without."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import weakref
from collections.abc import AsyncGenerator, Callable
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from .errors import InputError, InterruptedExchangeError, NoAnswerError, UnreachableError

if TYPE_CHECKING:
    import zenoh

DEFAULT_PORT = 7447
_OPEN_WITHIN_S = 10.0
_CLOSE_WITHIN_S = 3.0


def endpoints(url: str) -> list[str]:
    """Return the Zenoh endpoints that an address names: none means that the network is searched.

    `zenoh://host` and `zenoh://host:7447` are TCP, `zenoh://tls/host:7447` is whatever Zenoh calls so; commas separate several.
    """
    bad = f"{url!r} is no address of Zenoh: give one such as zenoh://router:7447, zenoh://tls/router:7447 or zenoh://"
    found = []
    for name in filter(None, url.removeprefix("zenoh://").split(",")):
        if "/" in name.rstrip("/"):
            found.append(name)
            continue
        try:
            parts = urlsplit(f"//{name.rstrip('/')}")
            host, port = parts.hostname, parts.port or DEFAULT_PORT
        except ValueError as why:
            raise InputError(f"{bad} ({why})") from why
        if not host:
            raise InputError(bad)
        found.append(f"tcp/[{host}]:{port}" if ":" in host else f"tcp/{host}:{port}")
    return found


def encoding(message: str) -> str:
    """Return the encoding of a message of the wire."""
    return f"application/protobuf;stereo.v1.{message}"


class ZenohSession:
    """One session, opened when it is first needed."""

    def __init__(self, url: str, config: str | os.PathLike[str] | None) -> None:
        self.url = url
        self._endpoints = endpoints(url)
        self._config = config
        self._opening = asyncio.Lock()
        self._session: zenoh.Session | None = None

    async def open(self) -> zenoh.Session:
        """Return the session."""
        async with self._opening:
            if self._session is None:
                try:
                    session = await asyncio.wait_for(asyncio.to_thread(self._open), _OPEN_WITHIN_S)
                except (TimeoutError, asyncio.TimeoutError) as why:
                    raise self._unreachable(f"no answer within {_OPEN_WITHIN_S:g} s") from why
                # At the latest when the interpreter ends: Zenoh's threads must not call into it after that.
                weakref.finalize(self, session.close)
                self._session = session
            return self._session

    def _open(self) -> zenoh.Session:
        import zenoh

        try:
            config = zenoh.Config() if self._config is None else zenoh.Config.from_file(os.fspath(self._config))
            if self._endpoints:
                config.insert_json5("connect/endpoints", json.dumps(self._endpoints))
            if self._config is None:
                # A client fails to open where nobody is, and is connected once it is open.
                config.insert_json5("mode", '"client"' if self._endpoints else '"peer"')
                config.insert_json5("scouting/multicast/enabled", "false" if self._endpoints else "true")
                # As the server: queries over implicit shared memory can be lost under load.
                config.insert_json5("transport/shared_memory/transport_optimization/messages", '["put"]')
        except (zenoh.ZError, OSError) as why:
            raise InputError(
                f"Zenoh's configuration can't be used ({_first_line(why)}): see Zenoh's own documentation"
            ) from why
        try:
            return zenoh.open(config)
        except zenoh.ZError as why:
            raise self._unreachable(_first_line(why)) from why

    def _unreachable(self, why: str) -> UnreachableError:
        return UnreachableError(
            f"no Zenoh router or server answers at {self.url} ({why}): check host and port, and that a router or "
            f"`stereod serve --zenoh-listen tcp/0.0.0.0:{DEFAULT_PORT}` runs there"
        )

    async def replies(
        self,
        selector: str,
        payload: bytes | None,
        message: str,
        timeout_s: float,
        *,
        is_alive: Callable[[], bool] = lambda: True,
        query_all: bool = False,
    ) -> AsyncGenerator[Any, None]:
        """Yield the replies to a query as they come; it ends early if `is_alive` no longer says so."""
        session = await self.open()
        import zenoh

        items: asyncio.Queue[Any] = asyncio.Queue()
        token = zenoh.CancellationToken()
        handler = _forward(items.put_nowait)

        def ask() -> None:
            session.get(
                selector,
                handler,
                target=zenoh.QueryTarget.ALL if query_all else None,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=timeout_s,
                payload=payload,
                encoding=encoding(message) if payload is not None else None,
                cancellation_token=token,
            )

        is_over = False
        try:
            try:
                await asyncio.to_thread(ask)
            except zenoh.ZError as why:
                raise InterruptedExchangeError(
                    f"the request can't be sent over {self.url} ({_first_line(why)}): send it again"
                ) from why
            while (item := await _next(items, is_alive)) is not _END:
                if item.err is not None and str(item.err.encoding) != encoding("Status"):
                    # Zenoh's own word that nobody answered in time.
                    raise NoAnswerError(
                        f"{selector} was not answered within {timeout_s:g} s: look whether the server hangs or the link is too slow"
                    )
                yield item
            is_over = True
        finally:
            if not is_over:
                await asyncio.to_thread(token.cancel)

    async def alive(self, pattern: str) -> list[str]:
        """Return the keys of the liveliness tokens that are there."""
        session = await self.open()
        items: asyncio.Queue[Any] = asyncio.Queue()
        await asyncio.to_thread(session.liveliness().get, pattern, _forward(items.put_nowait), timeout=_CLOSE_WITHIN_S)
        keys = []
        while (item := await items.get()) is not _END:
            if item.ok is not None:
                keys.append(str(item.ok.key_expr))
        return sorted(keys)

    async def subscribe(
        self, key: str, take: Callable[[Any], None], *, is_liveliness: bool = False
    ) -> zenoh.Subscriber[None]:
        """Hand every sample of a key to `take`, on the event loop, until it is undeclared; the end is handed over as None."""
        session = await self.open()

        def handle(item: Any) -> None:
            take(None if item is _END else item)

        if is_liveliness:
            return await asyncio.to_thread(session.liveliness().declare_subscriber, key, _forward(handle), history=True)
        return await asyncio.to_thread(session.declare_subscriber, key, _forward(handle))

    async def close(self) -> None:
        """Close the session, in bounded time: it waits for peers that may be out of reach."""
        session, self._session = self._session, None
        if session is not None:
            with contextlib.suppress(TimeoutError, asyncio.TimeoutError):
                await asyncio.wait_for(asyncio.to_thread(session.close), _CLOSE_WITHIN_S)


def is_put(sample: Any) -> bool:
    """Whether a sample says that something is there, not that it has gone."""
    import zenoh

    return bool(sample.kind == zenoh.SampleKind.PUT)


_END = object()
_LOOK_EVERY_S = 0.5


async def _next(items: asyncio.Queue[Any], is_alive: Callable[[], bool]) -> Any:
    while True:
        try:
            return await asyncio.wait_for(items.get(), _LOOK_EVERY_S)
        except (TimeoutError, asyncio.TimeoutError):
            if not is_alive():
                raise InterruptedExchangeError(
                    "the server has fallen silent: send the request to another one"
                ) from None


def _forward(take: Callable[[Any], None]) -> Any:
    """Return a handler that hands everything, and at last `_END`, to `take` on the running event loop."""
    import zenoh

    loop = asyncio.get_running_loop()

    def hand_over(item: Any) -> None:
        # The loop may have ended before the session.
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(take, item)

    # Runs on Zenoh's own threads: it only hands over.
    return zenoh.handlers.Callback(hand_over, lambda: hand_over(_END), indirect=False)


def _first_line(why: BaseException) -> str:
    return str(why).splitlines()[0].partition(" at /")[0].rstrip("!. ") if str(why) else type(why).__name__
