"""Many pairs at once: what goes in, and what comes out."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from .errors import InputError, InterruptedExchangeError, RefusedError, refusal
from .images import ImageLike, image_message
from .options import MatchOptions, request_message
from .result import Result


@dataclass(frozen=True)
class Pair:
    """A pair of a batch, with options of its own, which win over those of the batch."""

    left: ImageLike
    right: ImageLike
    options: MatchOptions = field(default_factory=MatchOptions)


PairLike: TypeAlias = "Pair | tuple[ImageLike, ImageLike]"
Pairs: TypeAlias = "Iterable[PairLike] | AsyncIterable[PairLike]"


@dataclass(frozen=True)
class Outcome:
    """What became of one pair of a batch.

    Attributes
    ----------
    index : int
        Its place in the batch, from 0; outcomes come as they are done.
    request_id : str
        The id that its options gave it, or empty.
    error : RefusedError or None
        Why there is no result.
    """

    index: int
    request_id: str
    error: RefusedError | None
    _result: Result | None

    @property
    def result(self) -> Result:
        """The result; raises `error` if there is none."""
        if self._result is None:
            raise self.error or InterruptedExchangeError("the server's reply has no result: ask again")
        return self._result


def pair_message(left: ImageLike, right: ImageLike, options: Mapping[str, Any]) -> Any:
    """Return the `stereo.v1.StereoRequest` of a pair as users give it."""
    pixel_format = options.get("pixel_format", "rgb")
    return request_message(
        image_message(left, "left", pixel_format), image_message(right, "right", pixel_format), options
    )


class Underway:
    """The pairs that are sent and not answered: no more is kept of a batch than that."""

    def __init__(self, pairs: Pairs, options: Mapping[str, Any]) -> None:
        self._pairs = pairs
        self._options = options
        self._open: dict[str, tuple[int, str, Any]] = {}
        self._are_all_taken = False

    async def requests(self) -> AsyncGenerator[Any, None]:
        """Yield a request for each pair, numbered; pairs are read and encoded off the event loop."""
        index = 0
        thread = ThreadPoolExecutor(1, "stereo-client-pairs")
        try:
            async for pair in _each(self._pairs, thread):
                request = await asyncio.get_running_loop().run_in_executor(thread, self._request, pair, index)
                self._open[str(index)] = (index, request.request_id, request.left)
                request.request_id = str(index)
                yield request
                index += 1
            self._are_all_taken = True
        finally:
            # Without waiting for an iterator that may wait itself.
            thread.shutdown(wait=False)

    def outcome(self, reply: Any) -> Outcome:
        """Return what a `stereo.v1.BatchReply` says; a status about the batch as a whole raises."""
        place = self._open.pop(reply.request_id, None)
        if place is None:
            if reply.WhichOneof("outcome") == "status":
                raise refusal(reply.status)
            raise InterruptedExchangeError("the server answered a pair that it was not sent: send what is left again")
        index, request_id, left = place
        if reply.WhichOneof("outcome") == "result":
            reply.result.request_id = request_id
            return Outcome(index, request_id, None, Result(reply.result, left))
        reply.status.request_id = request_id
        return Outcome(index, request_id, refusal(reply.status), None)

    def check_all_answered(self) -> None:
        """Raise if the batch is over and a pair has no answer."""
        if self._open or not self._are_all_taken:
            raise InterruptedExchangeError(
                "the batch ended before all of its pairs were answered: check that the server still runs, and send the rest again"
            )

    def _request(self, pair: PairLike, index: int) -> Any:
        if not isinstance(pair, Pair):
            try:
                left, right = pair
            except (TypeError, ValueError) as why:
                raise InputError(
                    f"pair {index} of the batch is no (left, right): give tuples of two images, or Pair(..)"
                ) from why
            pair = Pair(left, right)
        return pair_message(pair.left, pair.right, {**self._options, **pair.options})


_END = object()


async def _each(pairs: Pairs, thread: ThreadPoolExecutor) -> AsyncGenerator[PairLike, None]:
    if isinstance(pairs, AsyncIterable):
        async for pair in pairs:
            yield pair
        return
    iterator = iter(pairs)
    loop = asyncio.get_running_loop()
    while True:
        item: Any = await loop.run_in_executor(thread, next, iterator, _END)
        if item is _END:
            return
        yield item
