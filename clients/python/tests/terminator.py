"""TLS in front of a server, as a reverse proxy has it."""

from __future__ import annotations

import asyncio
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from urllib.parse import urlsplit


@contextmanager
def terminator(url: str, context: ssl.SSLContext, host: str = "127.0.0.1") -> Iterator[str]:
    """Pass on to the server at `url` what comes by TLS; yields the address, with `host` as its name."""
    backend = urlsplit(url)
    loop = asyncio.new_event_loop()
    stop = asyncio.Event()
    listening: list[int] = []
    is_listening = threading.Event()

    async def visit(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        inner_reader, inner_writer = await asyncio.open_connection(backend.hostname, backend.port)
        try:
            await asyncio.gather(_pass_on(reader, inner_writer), _pass_on(inner_reader, writer))
        finally:
            for one in (writer, inner_writer):
                one.transport.abort()

    async def serve() -> None:
        server = await asyncio.start_server(visit, "127.0.0.1", 0, ssl=context)
        listening.append(server.sockets[0].getsockname()[1])
        is_listening.set()
        await stop.wait()
        server.close()
        visits = asyncio.all_tasks() - {asyncio.current_task()}
        for task in visits:
            task.cancel()
        await asyncio.gather(*visits, return_exceptions=True)

    thread = threading.Thread(target=loop.run_until_complete, args=(serve(),))
    thread.start()
    try:
        assert is_listening.wait(30)
        yield f"https://{host}:{listening[0]}"
    finally:
        loop.call_soon_threadsafe(stop.set)
        thread.join()
        loop.close()


async def _pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while data := await reader.read(1 << 16):
            writer.write(data)
            await writer.drain()
    writer.close()
    with suppress(OSError):
        await writer.wait_closed()
