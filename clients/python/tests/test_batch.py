"""Many pairs at once."""

from __future__ import annotations

import asyncio
import threading
import tracemalloc

import numpy as np
import pytest
from impostor import impostor, saying
from scene import Scene
from server import Server

from stereo_client import (
    AsyncClient,
    Client,
    DrainingError,
    InputError,
    InterruptedExchangeError,
    InvalidError,
    MalformedReplyError,
    Pair,
    UnreachableError,
)


def test_every_pair_is_answered_once_and_as_alone(client: Client, scene: Scene):
    pairs = [(scene.left[:, : 320 - 16 * i], scene.right[:, : 320 - 16 * i]) for i in range(8)]
    outcomes = {outcome.index: outcome for outcome in client.match_many(pairs, density="dense")}
    assert sorted(outcomes) == list(range(8))
    for i, (left, right) in enumerate(pairs):
        alone = client.match(left, right, density="dense", budget_ms=5000)
        np.testing.assert_array_equal(outcomes[i].result.disparity, alone.disparity)
        assert outcomes[i].result.report.budget_ms is None


def test_pairs_have_options_of_their_own_and_one_refusal_is_not_the_others(client: Client, scene: Scene):
    pairs = [
        Pair(scene.left, scene.right, {"request_id": "same", "max_iterations": 1}),
        Pair(scene.left, scene.right[:100], {"request_id": "same"}),
        Pair(scene.left, scene.right, {"request_id": "same"}),
    ]
    first, second, third = sorted(client.match_many(pairs, max_iterations=2), key=lambda outcome: outcome.index)
    assert (first.request_id, first.result.request_id, first.result.report.iterations_run) == ("same", "same", 1)
    assert third.result.report.iterations_run == 2
    assert isinstance(second.error, InvalidError)
    assert second.error.request_id == "same"
    with pytest.raises(InvalidError):
        _ = second.result


def test_an_empty_batch_has_no_outcomes(client: Client):
    assert list(client.match_many([])) == []


def test_an_endless_batch_is_taken_as_it_is_answered_and_cancelled(client: Client, scene: Scene):
    small = (scene.left[:64, :64], scene.right[:64, :64])
    taken = 0

    def endless():
        nonlocal taken
        while True:
            taken += 1
            yield small

    outcomes = client.match_many(endless())
    for _ in range(3):
        _ = next(outcomes).result
    outcomes.close()
    for thread in threading.enumerate():
        if thread.name.startswith("stereo-client-pairs"):
            # Reads on for ever if it was not told to end.
            thread.join(timeout=60)
            assert not thread.is_alive()
    assert taken < 10_000
    client.match(*small, budget_ms=5000)


def test_a_long_batch_needs_no_more_memory_than_a_short_one(client: Client, scene: Scene):
    pair = (scene.left[:64, :64], scene.right[:64, :64])

    def peak(count: int) -> int:
        tracemalloc.start()
        for outcome in client.match_many((pair for _ in range(count)), outputs=["confidence"]):
            _ = outcome.result
        tracemalloc_peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return tracemalloc_peak

    peak(20)
    assert peak(600) < 2 * peak(100) + 1_000_000


def test_what_fails_while_pairs_are_made_comes_out(client: Client, scene: Scene):
    def failing():
        yield scene.left, scene.right
        raise OSError("the disk is gone")

    with pytest.raises(OSError, match="the disk is gone"):
        list(client.match_many(failing()))
    with pytest.raises(InputError, match="pair 1 of the batch"):
        list(client.match_many([(scene.left, scene.right), scene.left]))
    with pytest.raises(InputError, match="there is no option"):
        list(client.match_many([(scene.left, scene.right)], budget=3))


def test_asynchronous_pairs_are_taken(server: Server, scene: Scene):
    async def pairs():
        for _ in range(3):
            await asyncio.sleep(0)
            yield scene.left, scene.right

    async def indices() -> list[int]:
        async with AsyncClient(server.url) as client:
            return sorted([outcome.index async for outcome in client.match_many(pairs())])

    assert asyncio.run(indices()) == [0, 1, 2]


def test_a_batch_that_is_not_taken_says_why(scene: Scene):
    page = b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n"
    with impostor(saying(page)) as url, Client(url) as client, pytest.raises(MalformedReplyError, match="no stereod"):
        list(client.match_many([(scene.left, scene.right)]))
    with Client(url) as client, pytest.raises(UnreachableError, match="nothing listens"):
        list(client.match_many([(scene.left, scene.right)]))


def test_a_server_that_dies_in_a_batch_is_reported(program: str, scene: Scene):
    with Server.start(program) as server, Client(server.url) as client:
        outcomes = client.match_many((scene.left, scene.right) for _ in range(10_000))
        next(outcomes)
        server.kill()
        with pytest.raises(InterruptedExchangeError):
            list(outcomes)


def test_a_server_that_stops_in_a_batch_says_so(program: str, scene: Scene):
    is_over = threading.Event()

    def pairs():
        yield scene.left, scene.right
        is_over.wait()

    with Server.start(program) as server, Client(server.url) as client:
        outcomes = client.match_many(pairs())
        assert next(outcomes).error is None
        server.process.terminate()
        try:
            with pytest.raises(DrainingError, match="another server"):
                next(outcomes)
        finally:
            is_over.set()


@pytest.mark.parametrize(
    ("replies", "kind"),
    [
        (b"\xff" * 10, MalformedReplyError),
        (b"\xff\xff\xff\xff\x7f", MalformedReplyError),
        (b"\x02\xff\xff", MalformedReplyError),
        (b"\x05\x0a\x03odd", InterruptedExchangeError),
        (b"\x02", InterruptedExchangeError),
    ],
)
def test_replies_that_can_not_be_read_are_reported(scene: Scene, replies: bytes, kind):
    head = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"
    body = b"%x\r\n%b\r\n0\r\n\r\n" % (len(replies), replies)
    with impostor(saying(head + body)) as url, Client(url) as client, pytest.raises(kind):
        list(client.match_many([(scene.left, scene.right)]))
