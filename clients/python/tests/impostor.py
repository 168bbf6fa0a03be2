"""A server that answers as a test wants."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def impostor(answer: Callable[[socket.socket], None]) -> Iterator[str]:
    """Accept connections one by one and hand each to `answer`; yields the address."""
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            with connection:
                answer(connection)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        # Ends `accept`, which closing alone does not.
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()
        thread.join()


def saying(text: bytes) -> Callable[[socket.socket], None]:
    """Read a head, say `text`, close."""

    def answer(connection: socket.socket) -> None:
        read_head(connection)
        connection.sendall(text)

    return answer


def read_head(connection: socket.socket) -> bytes:
    head = b""
    while b"\r\n\r\n" not in head:
        piece = connection.recv(65536)
        if not piece:
            break
        head += piece
    return head
