"""An event loop in a thread of its own, for callers that have none."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncGenerator, Coroutine, Generator
from typing import Any, TypeVar, cast

T = TypeVar("T")


class Background:
    """Runs coroutines one caller at a time or many at once, and hands back what they return."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="stereo-client", daemon=True)
        self._thread.start()

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        """Run to the end; if the caller is interrupted, so is the work."""
        future = asyncio.run_coroutine_threadsafe(work, self._loop)
        try:
            return future.result()
        finally:
            future.cancel()

    def iterate(self, items: AsyncGenerator[T, None]) -> Generator[T, None, None]:
        """Yield what an asynchronous generator yields, and close it when the caller has enough."""
        end = object()
        running: list[asyncio.Task[Any]] = []

        async def step() -> T | object:
            running[:] = filter(None, [asyncio.current_task()])
            return await anext(items, end)

        async def close() -> None:
            # The caller may have been interrupted while it waited for the next one.
            if running:
                running[0].cancel()
                await asyncio.wait(running)
            await items.aclose()

        try:
            while (item := self.run(step())) is not end:
                yield cast("T", item)
        finally:
            self.run(close())

    def stop(self) -> None:
        """End the thread."""
        if self._loop.is_closed():
            return
        self.run(self._loop.shutdown_asyncgens())
        self.run(self._loop.shutdown_default_executor())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    @property
    def is_stopped(self) -> bool:
        """Whether `stop` was called."""
        return self._loop.is_closed()
