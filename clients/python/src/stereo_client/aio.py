"""The client for asyncio."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing
from typing import TYPE_CHECKING, Any, Protocol

from ._over_http import OverHttp
from .batch import Outcome, Pairs, Underway, pair_message
from .errors import InputError
from .images import ImageLike
from .result import Result

if TYPE_CHECKING:
    from types import TracebackType

    from typing_extensions import Self, Unpack

    from .options import MatchOptions


class Transport(Protocol):
    """What HTTP and Zenoh have in common; messages in, messages out."""

    url: str

    async def match(self, request: Any) -> Any:
        """Return the result of one request."""

    def anytime(self, request: Any) -> AsyncGenerator[Any, None]:
        """Yield better and better results of one request."""

    def batch(self, requests: AsyncIterator[Any]) -> AsyncGenerator[Any, None]:
        """Yield a reply for each request as they are done."""

    async def close(self) -> None:
        """Close the connections."""


class AsyncClient:
    """Talks to a server over HTTP, or to all servers of a Zenoh network; for asyncio.

    It belongs to the event loop that it is first used in.

    Parameters
    ----------
    url : str
        `http://host:port` for one server.
    timeout_s : float
        How long a whole exchange may take before `NoAnswerError` is raised. Default 120.
    """

    def __init__(self, url: str, *, timeout_s: float = 120.0) -> None:
        self._transport = _transport(url, timeout_s)

    @property
    def url(self) -> str:
        """The address that was given."""
        return self._transport.url

    async def match(self, left: ImageLike, right: ImageLike, **options: Unpack[MatchOptions]) -> Result:
        """Match one pair.

        Parameters
        ----------
        left, right : array, Pillow image, path or bytes
            The rectified pair; see `ImageLike`.
        **options
            What is wanted; see `MatchOptions`, `budget_ms` first of all.

        Raises
        ------
        RefusedError
            The server's refusal, as the class of its reason.
        StereoError
            Everything else: the address, the network, the images.
        """
        request = await asyncio.to_thread(pair_message, left, right, options)
        return await self.send(request)

    async def match_anytime(
        self, left: ImageLike, right: ImageLike, **options: Unpack[MatchOptions]
    ) -> AsyncGenerator[Result, None]:
        """Match one pair and yield results as they get better: the first rung soon, the last within the budget. HTTP has the last alone."""
        request = await asyncio.to_thread(pair_message, left, right, options)
        async with aclosing(self._transport.anytime(request)) as results:
            async for message in results:
                yield Result(message, request.left)

    async def match_many(self, pairs: Pairs, **options: Unpack[MatchOptions]) -> AsyncGenerator[Outcome, None]:
        """Match any number of pairs in constant memory, as background work: yields what became of each as they are done.

        Parameters
        ----------
        pairs : iterable or async iterable of (left, right) or Pair
            Taken as fast as the server works; it may be endless. An ordinary iterable is read in a thread of its own.
        **options
            What is wanted of all pairs; see `MatchOptions`.

        Yields
        ------
        Outcome
            `outcome.index` says of which pair; `outcome.result` raises if that pair was refused. To cancel what is left, stop
            iterating and close the iterator.
        """
        underway = Underway(pairs, options)
        async with aclosing(underway.requests()) as requests, aclosing(self._transport.batch(requests)) as replies:
            async for reply in replies:
                yield underway.outcome(reply)
        underway.check_all_answered()

    async def send(self, request: Any) -> Result:
        """Match a `stereo.v1.StereoRequest` that was made elsewhere."""
        return Result(await self._transport.match(request), request.left)

    async def info(self) -> dict[str, Any]:
        """Return what the server says about itself: version, limits, presets and their rungs. Over HTTP."""
        return await self._over_http("info").info()

    async def wait_ready(self, timeout_s: float = 30.0) -> None:
        """Wait until the server takes frames. Over HTTP."""
        await self._over_http("wait_ready").wait_ready(timeout_s)

    async def close(self) -> None:
        """Close the connections."""
        await self._transport.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    def _over_http(self, _what: str) -> OverHttp:
        assert isinstance(self._transport, OverHttp)
        return self._transport


def _transport(url: str, timeout_s: float) -> Transport:
    if not isinstance(url, str):
        raise InputError(f"{url!r} is no address of a server: give one such as 'http://127.0.0.1:8080'")
    return OverHttp(url, timeout_s)
