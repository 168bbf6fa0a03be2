"""The same for asyncio."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from scene import Scene
from server import Server

from stereo_client import AsyncClient, Client, UnreachableError


def test_pairs_are_matched_at_the_same_time(server: Server, scene: Scene):
    async def run():
        async with AsyncClient(server.url) as client:
            await client.wait_ready()
            assert (await client.info())["name"] == "stereod"
            work = (client.match(scene.left, scene.right, budget_ms=5000, density="dense") for _ in range(6))
            return await asyncio.gather(*work)

    results = asyncio.run(run())
    with Client(server.url) as client:
        alone = client.match(scene.left, scene.right, budget_ms=5000, density="dense")
    for result in results:
        np.testing.assert_array_equal(result.disparity, alone.disparity)


def test_a_request_that_is_cancelled_leaves_the_client_usable(server: Server, scene: Scene):
    async def run():
        async with AsyncClient(server.url) as client:
            task = asyncio.create_task(client.match(scene.left, scene.right, budget_ms=60_000, preset="paper"))
            while not client._transport._http.address or not task.done():
                await asyncio.sleep(0)
                task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            return await client.match(scene.left, scene.right, budget_ms=5000)

    assert asyncio.run(run()).report.deadline_met


def test_over_http_an_anytime_request_has_one_result(server: Server, client: Client, scene: Scene):
    async def run():
        async with AsyncClient(server.url) as client:
            return [result async for result in client.match_anytime(scene.left, scene.right, budget_ms=5000)]

    assert len(asyncio.run(run())) == 1
    assert len(list(client.match_anytime(scene.left, scene.right, budget_ms=5000))) == 1


def test_a_server_that_is_not_there_never_gets_ready():
    async def run():
        async with AsyncClient("http://127.0.0.1:1") as client:
            await client.wait_ready(timeout_s=0.05)

    with pytest.raises(UnreachableError, match="not ready after"):
        asyncio.run(run())
