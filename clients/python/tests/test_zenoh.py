"""Over Zenoh: requests, camera streams, settings, several servers."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import zenoh
from scene import CALIBRATION, Scene
from server import Server
from test_errors import one_sentence

from stereo_client import (
    AsyncClient,
    Camera,
    Client,
    DeadlineInfeasibleError,
    ExpiredError,
    InputError,
    InvalidError,
    NoFramesError,
    NoServerError,
    NotServedError,
    Pairing,
    Region,
    StereoError,
    UnreachableError,
)
from stereo_client._zenoh_session import endpoints


@pytest.fixture(scope="module")
def fleet(program: str) -> Iterator[tuple[Server, Server]]:
    """Two servers that know each other."""
    with Server.start(program, "--instance", "one") as one, second(program, one, "two") as two:
        yield one, two


def second(program: str, first: Server, name: str) -> Server:
    """Start a server that knows another one."""
    return Server.start(program, "--instance", name, "--zenoh-connect", first.zenoh().removeprefix("zenoh://"))


@pytest.fixture
def robot(server: Server) -> Iterator[Client]:
    with Client(server.zenoh()) as client:
        client.wait_ready()
        yield client


@contextmanager
def router() -> Iterator[str]:
    """A Zenoh router on a port of its own."""
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:0"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("adminspace/enabled", "true")
    with zenoh.open(config) as session:
        (about,) = session.get(f"@/{session.zid()}/router")
        yield "zenoh://" + json.loads(about.ok.payload.to_string())["locators"][0]


@contextmanager
def sending(camera: Camera, scene: Scene, **options) -> Iterator[None]:
    """Send frames for as long as somebody looks."""
    is_over = threading.Event()

    def send() -> None:
        while not is_over.wait(0.02):
            camera.publish(scene.left, scene.right, **options)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def test_a_pair_is_matched_as_over_http(robot: Client, client: Client, scene: Scene):
    options = {"budget_ms": 5000, "density": "dense", "calibration": CALIBRATION, "request_id": "mine"}
    over_zenoh, over_http = (each.match(scene.left, scene.right, **options) for each in (robot, client))
    np.testing.assert_array_equal(over_zenoh.disparity, over_http.disparity)
    np.testing.assert_array_equal(over_zenoh.mesh.positions, over_http.mesh.positions)
    assert over_zenoh.request_id == "mine"


def test_refusals_are_the_same_as_over_http(robot: Client, scene: Scene):
    with pytest.raises(InvalidError, match="200"):
        robot.match(scene.left, scene.right[:200])
    with pytest.raises(InvalidError, match="num_disparities"):
        robot.match(scene.left, scene.right, num_disparities=3)
    with pytest.raises((DeadlineInfeasibleError, ExpiredError)) as caught:
        robot.match(scene.left, scene.right, budget_ms=0.01)
    assert caught.value.code == 504


def test_an_anytime_request_has_the_first_rung_first_and_the_best_last(robot: Client, scene: Scene):
    results = list(robot.match_anytime(scene.left, scene.right, budget_ms=5000, density="dense"))
    rungs = [result.report.iterations_run for result in results]
    assert rungs == sorted(set(rungs))
    assert len(rungs) > 1
    whole = robot.match(scene.left, scene.right, budget_ms=5000, density="dense")
    np.testing.assert_array_equal(results[-1].disparity, whole.disparity)


def test_a_batch_is_answered_whole(robot: Client, scene: Scene):
    pairs = [(scene.left, scene.right if i != 3 else scene.right[:99]) for i in range(6)]
    outcomes = {outcome.index: outcome for outcome in robot.match_many(pairs)}
    assert sorted(outcomes) == list(range(6))
    assert isinstance(outcomes[3].error, InvalidError)
    assert all(outcome.result.report.budget_ms is None for index, outcome in outcomes.items() if index != 3)
    endless = robot.match_many((scene.left, scene.right) for _ in iter(int, 1))
    assert next(endless).error is None
    endless.close()


def test_batches_wait_where_a_server_is_full(program: str, scene: Scene):
    with Server.start(program, "--queue-capacity", "1", "--workers", "1") as server, Client(server.zenoh()) as client:
        client.wait_ready()
        errors: list[object] = []

        def run() -> None:
            errors.extend(outcome.error for outcome in client.match_many([(scene.left, scene.right)] * 10))

        threads = [threading.Thread(target=run) for _ in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert errors == [None] * 30


def test_a_camera_is_served_and_its_results_come_as_a_stream(robot: Client, scene: Scene):
    with robot.camera("front") as camera:
        assert camera.wait_served() == "stereod"
        assert [(found.name, found.server) for found in robot.cameras()] == [("front", "stereod")]
        with sending(camera, scene, budget_ms=5000):
            results = robot.stream("front", timeout_s=60)
            first, second = next(results), next(results)
            results.close()
    assert first.camera == "front"
    assert second.sequence > first.sequence
    assert first.capture_time_ns < second.capture_time_ns
    assert scene.wrong(second.disparity) < 0.03
    assert second.left_rgb is None


@pytest.mark.parametrize(("part", "other"), [("disparity", "mesh"), ("mesh", "disparity"), ("report", "mesh")])
def test_a_part_can_be_had_alone(robot: Client, scene: Scene, part, other):
    with robot.camera("parts") as camera, sending(camera, scene, budget_ms=5000):
        result = next(robot.stream("parts", part=part, timeout_s=60))
    assert result.has(part)
    assert not result.has(other)


def test_single_images_are_brought_together(robot: Client, scene: Scene):
    with robot.camera("halves") as camera:
        camera.wait_served()
        robot.set_settings("halves", budget_ms=5000)
        is_over = threading.Event()

        def send() -> None:
            sequence = 0
            while not is_over.wait(0.02):
                camera.publish_right(scene.right, sequence)
                camera.publish_left(scene.left, sequence)
                sequence += 1

        thread = threading.Thread(target=send)
        thread.start()
        try:
            result = next(robot.stream("halves", timeout_s=60))
        finally:
            is_over.set()
            thread.join()
    assert result.sequence is not None
    assert scene.wrong(result.disparity) < 0.03


def test_settings_are_changed_read_and_used(robot: Client, scene: Scene):
    with robot.camera("set") as camera:
        camera.wait_served()
        before = robot.settings("set")
        after = robot.set_settings(
            "set",
            calibration=CALIBRATION,
            pairing=Pairing("time", tolerance_ms=5, patience_ms=100),
            budget_ms=4000,
            preset="fast",
            max_iterations=1,
            outputs=["disparity", "depth"],
            roi=(0, 0, 128, 128),
            mesh={"max_triangles": 400},
        )
        assert after.revision == before.revision + 1
        assert after == robot.settings("set")
        assert after.calibration == CALIBRATION
        assert after.pairing == Pairing("time", 5.0, 100.0)
        assert after.options["budget_ms"] == 4000
        assert after.options["preset"] == "fast"
        assert after.options["outputs"] == ["disparity", "depth"]
        assert after.options["roi"] == Region(0, 0, 128, 128)
        assert after.options["mesh"]["max_triangles"] == 400
        with sending(camera, scene):
            result = next(robot.stream("set", timeout_s=60))
        assert result.report.iterations_asked == 1
        assert result.has("depth")
        with pytest.raises(InvalidError, match="num_disparities"):
            robot.set_settings("set", num_disparities=3)
        assert robot.set_settings("set").options == {}


def test_streams_can_be_followed_over_http_too(client: Client, robot: Client, scene: Scene):
    with pytest.raises(NoFramesError) as caught:
        next(client.stream("nobody", timeout_s=0.01))
    assert "nobody" in one_sentence(caught.value)
    with robot.camera("web") as camera:
        camera.wait_served()
        assert ("web", "stereod") in [(found.name, found.server) for found in client.cameras()]
        with sending(camera, scene, budget_ms=5000):
            results = client.stream("web", timeout_s=60)
            first, second = next(results), next(results)
            results.close()
    assert second.sequence > first.sequence
    with pytest.raises(NotServedError, match="part"):
        next(client.stream("web", part="mesh"))


def test_the_servers_of_a_fleet_are_found_and_share_the_work(fleet, scene: Scene):
    one, two = fleet
    with Client(one.zenoh()) as client:
        client.wait_ready()

        async def both() -> set[str]:
            async with AsyncClient(two.zenoh()) as client:
                while len(await client.servers()) < 2:  # noqa: ASYNC110
                    await asyncio.sleep(0)
                work = (client.match(scene.left, scene.right, budget_ms=20_000) for _ in range(8))
                return {result.report.instance for result in await asyncio.gather(*work)}

        assert asyncio.run(both()) == {"one", "two"}
        assert [server.instance for server in client.servers()] == ["one", "two"]
        assert all(server.workers >= 1 for server in client.servers())


def test_another_server_takes_over_when_one_goes(program: str, scene: Scene):
    with Server.start(program, "--instance", "stays") as stays, Client(stays.zenoh()) as client:
        with second(program, stays, "goes") as goes:
            while len(client.servers()) < 2:
                pass
            outcomes = client.match_many((scene.left, scene.right) for _ in range(40))
            served = {next(outcomes).result.report.instance for _ in range(10)}
            goes.kill()
            served |= {outcome.result.report.instance for outcome in outcomes}
        assert served == {"goes", "stays"}
        assert client.match(scene.left, scene.right, budget_ms=20_000).report.instance == "stays"


def test_cameras_servers_and_watchers_meet_at_a_router(program: str, scene: Scene):
    with (
        router() as url,
        Server.start(program, "--instance", "behind", "--zenoh-connect", url.removeprefix("zenoh://")),
        Client(url) as robot,
        Client(url) as watcher,
    ):
        watcher.wait_ready()
        assert watcher.match(scene.left, scene.right, budget_ms=5000).report.instance == "behind"
        with robot.camera("far") as camera:
            assert camera.wait_served() == "behind"
            with sending(camera, scene, budget_ms=5000):
                assert next(watcher.stream("far", timeout_s=60)).camera == "far"


def test_a_client_and_its_camera_outlive_the_server(program: str, scene: Scene):
    with Server.start(program) as first, Client(first.zenoh()) as client, client.camera("lasting") as camera:
        endpoint = first.zenoh().removeprefix("zenoh://")
        camera.wait_served()
        first.kill()
        with pytest.raises(NoServerError):
            client.match(scene.left, scene.right)
        with Server.start(program, "--instance", "next", "--zenoh-listen", endpoint):
            client.wait_ready()
            assert client.match(scene.left, scene.right, budget_ms=5000).report.instance == "next"
            assert camera.wait_served() == "next"


def test_a_network_without_a_server_says_so(scene: Scene):
    with router() as url, Client(url) as client:
        attempts = [
            lambda: client.match(scene.left, scene.right),
            lambda: list(client.match_many([(scene.left, scene.right)])),
            lambda: next(client.stream("front", timeout_s=0.01)),
            lambda: client.settings("front"),
            lambda: client.wait_ready(0.01),
        ]
        for attempt in attempts:
            with pytest.raises(NoServerError, match="no server on the Zenoh network") as caught:
                attempt()
            one_sentence(caught.value)
        assert client.servers() == []
        assert client.cameras() == []
        with client.camera("front") as camera, pytest.raises(NoFramesError, match="no server serves") as caught:
            camera.wait_served(0.01)
        one_sentence(caught.value)


def test_why_nothing_comes_out_of_a_stream(robot: Client):
    def reason() -> str:
        with pytest.raises(NoFramesError) as caught:
            next(robot.stream("quiet", timeout_s=0.01))
        return one_sentence(caught.value)

    assert "no camera has announced itself" in reason()
    with robot.camera("quiet") as camera:
        camera.wait_served()
        assert "is served by stereod, but no result came" in reason()
        with robot.camera("other") as other:
            other.wait_served()
    with robot.camera("other") as other:
        other.wait_served()
        while "quiet" in [found.name for found in robot.cameras()]:
            pass
        assert "there are other" in reason()


def test_a_router_that_is_not_there_is_reported(scene: Scene):
    with (
        Client("zenoh://127.0.0.1:1") as client,
        pytest.raises(UnreachableError, match="no Zenoh router or server") as caught,
    ):
        client.match(scene.left, scene.right)
    assert "zenoh://127.0.0.1:1" in one_sentence(caught.value)


def test_what_one_transport_does_not_have_names_the_other(client: Client, robot: Client):
    for attempt in (
        lambda: client.camera("a"),
        client.servers,
        lambda: client.settings("a"),
        lambda: client.set_settings("a"),
    ):
        with pytest.raises(NotServedError, match="over Zenoh alone"):
            attempt()
    with pytest.raises(NotServedError, match="over HTTP alone"):
        robot.info()


def test_bad_names_are_refused_here(robot: Client, scene: Scene):
    for attempt in (
        lambda: robot.camera("a/b"),
        lambda: next(robot.stream("*")),
        lambda: robot.settings(""),
        lambda: next(robot.stream("a", part="depth")),
        lambda: robot.set_settings("a", pairing=Pairing("color")),
        lambda: Client("zenoh://host:port"),
        lambda: robot.camera("closed").publish(scene.left, scene.right),
    ):
        with pytest.raises(StereoError) as caught:
            attempt()
        one_sentence(caught.value)


def test_a_configuration_that_can_not_be_read_is_named(tmp_path, scene: Scene):
    (tmp_path / "zenoh.json5").write_text("{ mode: 'nothing' }")
    for path in (tmp_path / "zenoh.json5", tmp_path / "none.json5"):
        with (
            Client("zenoh://", zenoh_config=path) as client,
            pytest.raises(InputError, match="configuration") as caught,
        ):
            client.match(scene.left, scene.right)
        one_sentence(caught.value)


def test_a_configuration_of_zenohs_own_is_used(server: Server, tmp_path, scene: Scene):
    file = tmp_path / "zenoh.json5"
    endpoint = server.zenoh().removeprefix("zenoh://")
    file.write_text(f"{{ mode: 'client', connect: {{ endpoints: ['{endpoint}'] }} }}")
    with Client("zenoh://", zenoh_config=file) as client:
        assert client.match(scene.left, scene.right, budget_ms=5000).report.deadline_met


@pytest.mark.parametrize(
    ("url", "found"),
    [
        ("zenoh://", []),
        ("zenoh://router", ["tcp/router:7447"]),
        ("zenoh://router:1234/", ["tcp/router:1234"]),
        ("zenoh://[::1]:7", ["tcp/[::1]:7"]),
        ("zenoh://tls/router:7447,other", ["tls/router:7447", "tcp/other:7447"]),
        ("zenoh://unixsock-stream//run/zenoh", ["unixsock-stream//run/zenoh"]),
    ],
)
def test_addresses_are_read(url, found):
    assert endpoints(url) == found


def test_the_same_for_asyncio(server: Server, scene: Scene):
    async def run() -> None:
        async with AsyncClient(server.zenoh()) as client, client.camera("asynchronous") as camera:
            assert await camera.wait_served() == "stereod"

            async def send() -> None:
                while True:
                    await camera.publish(scene.left, scene.right, budget_ms=5000)
                    await asyncio.sleep(0.02)

            task = asyncio.create_task(send())
            async for result in client.stream("asynchronous", timeout_s=60):
                assert scene.wrong(result.disparity) < 0.03
                break
            task.cancel()
            assert (await client.settings("asynchronous")).revision == 0
            await camera.publish_left(scene.left, 1)
            await camera.publish_right(scene.right, 1)

    asyncio.run(run())
