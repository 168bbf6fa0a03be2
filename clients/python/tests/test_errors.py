"""Everything that can go wrong: one sentence each that says what is wrong and what to do."""

from __future__ import annotations

import pickle
import re
import signal
import socket
import sys
import threading

import numpy as np
import pytest
from impostor import impostor, read_head, saying
from scene import Scene
from server import Server

import stereo_client
from stereo_client import (
    Client,
    DeadlineInfeasibleError,
    ExpiredError,
    InputError,
    InterruptedExchangeError,
    InvalidError,
    MalformedReplyError,
    MissingPackageError,
    NoAnswerError,
    RefusedError,
    StereoError,
    TooLargeError,
    UnreachableError,
)
from stereo_client._schema import REASON, Status
from stereo_client.errors import refusal


def one_sentence(error: BaseException) -> str:
    text = str(error)
    assert "\n" not in text
    assert not re.search(r"\. [A-Z]", text)
    return text


def failure(url: str, kind: type[StereoError], scene: Scene, **client_options) -> str:
    with Client(url, **client_options) as client, pytest.raises(kind) as caught:
        client.match(scene.left, scene.right)
    return one_sentence(caught.value)


def test_a_server_that_is_down_is_to_be_started(scene: Scene):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    text = failure(f"http://127.0.0.1:{port}", UnreachableError, scene)
    assert f"nothing listens at http://127.0.0.1:{port}" in text
    assert "`stereod serve`" in text


def test_a_wrong_host_is_named(scene: Scene):
    text = failure("http://no-such-host.invalid:8080", UnreachableError, scene)
    assert "'no-such-host.invalid'" in text
    assert "check the address" in text
    with pytest.raises(ConnectionError), Client("http://no-such-host.invalid") as client:
        client.info()


@pytest.mark.parametrize(
    "url", ["", "127.0.0.1:8080", "ftp://host", "http://", "http://host:port", "http://[::1", 8080]
)
def test_what_is_no_address_is_refused_with_an_example(url):
    with pytest.raises(InputError, match=r"no address.*http://127\.0\.0\.1:8080") as caught:
        Client(url)
    one_sentence(caught.value)


@pytest.mark.parametrize(
    "answer",
    [
        b"SSH-2.0-OpenSSH_9.2\r\n\r\n",
        b"220 mail ready",
        b"HTTP/1.1 200 OK\r\n\r\nno length",
        b"HTTP/1.1 200 OK\r\nContent-Length: 9999999999999\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nFFFFFFFF\r\n",
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nodd\r\n",
        b"HTTP/1.1 200 OK\r\nX: " + b"x" * 100_000,
    ],
)
def test_something_else_at_the_port_is_not_taken_for_a_server(scene: Scene, answer: bytes):
    with impostor(saying(answer)) as url:
        assert "check host and port" in failure(url, MalformedReplyError, scene)


def test_another_web_server_is_not_taken_for_one(scene: Scene):
    page = b"HTTP/1.1 404 Not Found\r\nContent-Type: text/html\r\nContent-Length: 6\r\n\r\n<html>"
    with impostor(saying(page)) as url:
        assert "is no stereod (HTTP 404)" in failure(url, MalformedReplyError, scene)


@pytest.mark.parametrize(
    "answer",
    [
        b"",
        b"HTTP/1.1 200 OK\r\nContent-Length: 100\r\n\r\nhalf",
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n64\r\nhalf",
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n2\r\nok\r\n",
    ],
)
def test_a_connection_that_breaks_is_reported(scene: Scene, answer: bytes):
    with impostor(saying(answer)) as url:
        assert "send the request again" in failure(url, InterruptedExchangeError, scene)


def test_an_answer_that_is_no_message_is_reported(scene: Scene):
    with impostor(saying(b"HTTP/1.1 200 OK\r\nContent-Length: 3\r\n\r\nabc")) as url:
        assert "no message that can be read" in failure(url, MalformedReplyError, scene)


def test_a_server_that_hangs_is_given_up(scene: Scene):
    stop = threading.Event()

    def hang(connection: socket.socket) -> None:
        read_head(connection)
        stop.wait()

    with impostor(hang) as url:
        text = failure(url, NoAnswerError, scene, timeout_s=0.1)
        stop.set()
    assert "did not answer within 0.1 s" in text


def test_who_is_interrupted_is_not_kept_waiting_and_can_go_on(server: Server, scene: Scene):
    is_over = threading.Event()

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    def hang(connection: socket.socket) -> None:
        read_head(connection)
        is_over.wait()

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        with impostor(hang) as url, Client(url) as client:
            for wait in (
                lambda: client.match(scene.left, scene.right),
                lambda: next(client.match_many([(scene.left, scene.right)])),
                lambda: next(client.stream("front")),
            ):
                signal.setitimer(signal.ITIMER_REAL, 0.1)
                with pytest.raises(KeyboardInterrupt):
                    wait()
            is_over.set()
    finally:
        is_over.set()
        signal.signal(signal.SIGALRM, before)


def test_interim_answers_and_odd_chunks_are_read(scene: Scene):
    body = Status(code=409, reason=7, message="newer").SerializeToString()
    chunks = b"".join(b"%X;x=y\r\n%c\r\n" % (1, byte) for byte in body) + b"0\r\nTrailer: 1\r\n\r\n"
    head = b"HTTP/1.1 409 Conflict\r\ncontent-TYPE: application/x-protobuf\r\nTransfer-Encoding: chunked\r\n\r\n"
    with impostor(saying(b"HTTP/1.1 100 Continue\r\n\r\n" + head + chunks)) as url:
        assert failure(url, stereo_client.SupersededError, scene) == "newer"


def test_images_of_different_sizes_are_refused_with_both_sizes(client: Client, scene: Scene):
    with pytest.raises(InvalidError) as caught:
        client.match(scene.left, scene.right[:200])
    text = one_sentence(caught.value)
    assert "320" in text
    assert "240" in text
    assert "200" in text
    assert caught.value.code == 422


def test_a_budget_that_is_too_small_says_what_it_would_take(client: Client, scene: Scene):
    client.match(scene.left, scene.right, budget_ms=5000)
    with pytest.raises((DeadlineInfeasibleError, ExpiredError)) as caught:
        client.match(scene.left, scene.right, budget_ms=0.01)
    text = one_sentence(caught.value)
    assert "0.01 ms" in text
    assert "at least" in text
    assert caught.value.earliest_feasible_ms > 0
    assert caught.value.code == 504


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"budget_ms": -1}, "latency_budget"),
        ({"budget_ms": 61_000}, "60"),
        ({"num_disparities": 17}, "16"),
        ({"min_confidence": 1.5}, "min_confidence"),
        ({"roi": (300, 0, 100, 100)}, "roi"),
        ({"camera": "a/b"}, "camera"),
        ({"outputs": ["depth"]}, "calibration"),
        ({"mesh": {"max_triangles": 1}}, "max_triangles"),
    ],
)
def test_what_the_server_refuses_names_the_option(client: Client, scene: Scene, options, words):
    with pytest.raises(InvalidError, match=words) as caught:
        client.match(scene.left, scene.right, **options)
    one_sentence(caught.value)
    assert caught.value.reason == "INVALID"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"budget": 5}, "there is no option budget: the options are .*budget_ms"),
        ({"budget_ms": "soon"}, "budget_ms is 'soon': give a number of milliseconds"),
        ({"budget_ms": float("nan")}, "give a number of milliseconds"),
        ({"preset": "best"}, "preset can't be 'best': it is one of default, fast, paper"),
        ({"preset": "unspecified"}, "it is one of"),
        ({"outputs": "mesh"}, "give a list"),
        ({"outputs": ["color"]}, "one of disparity, confidence, depth, mesh, points"),
        ({"roi": (1, 2, 3)}, "roi can't be"),
        ({"max_iterations": "all"}, "max_iterations can't be 'all'"),
        ({"num_disparities": -16}, "num_disparities can't be -16"),
        ({"mesh": {"triangles": 3}}, "there is no mesh option triangles"),
        ({"sequence": "one"}, "the request can't be written"),
        ({"calibration": {"focal_px": 500}}, "the request can't be written"),
    ],
)
def test_what_can_not_be_sent_is_refused_here(client: Client, scene: Scene, options, words):
    with pytest.raises(InputError, match=words) as caught:
        client.match(scene.left, scene.right, **options)
    one_sentence(caught.value)


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.zeros((40, 40), np.float32), r"shape \(40, 40\) and type float32.*give uint8"),
        (np.zeros((40, 40, 5), np.uint8), "shape"),
        (np.zeros(40, np.uint8), "shape"),
        (np.zeros((40, 40, 3), np.uint16), "shape"),
        ("no/such.png", "the left image no/such.png can't be read"),
        (b"", "is empty"),
        (b"no image at all", "no image file"),
        (None, "type object"),
    ],
)
def test_what_is_no_image_is_refused_here(client: Client, scene: Scene, image, words):
    with pytest.raises(InputError, match=words) as caught:
        client.match(image, scene.right)
    one_sentence(caught.value)


def test_a_body_over_the_limit_is_refused_while_it_is_sent(program: str):
    large = np.zeros((4000, 4000), np.uint16)
    with Server.start(program, "--max-body-bytes", "1000000") as server, Client(server.url) as client:
        with pytest.raises(TooLargeError) as caught:
            client.match(large, large)
        one_sentence(caught.value)
        assert client.info()["limits"]["body_bytes"] == 1_000_000


def test_missing_packages_say_how_to_install_them(client: Client, scene: Scene, monkeypatch):
    result = client.match(scene.left, scene.right, budget_ms=5000)
    for module in ("open3d", "rerun", "PIL", "PIL.Image", "lz4.frame", "compression.zstd", "backports.zstd"):
        monkeypatch.setitem(sys.modules, module, None)
    attempts = [
        (result.to_open3d, r"stereo-client\[open3d\]"),
        (result.to_rerun, r"stereo-client\[rerun\]"),
        (lambda: client.match(b"BM bitmap", scene.right), r"stereo-client\[pillow\]"),
        (
            lambda: client.match(scene.left, scene.right, disparity_encoding="png16").disparity,
            r"stereo-client\[pillow\]",
        ),
        (lambda: client.match(scene.left, scene.right, compression="zstd"), r"stereo-client\[compression\]"),
        (lambda: client.match(scene.left, scene.right, compression="lz4"), r"stereo-client\[compression\]"),
    ]
    for attempt, words in attempts:
        with pytest.raises(MissingPackageError, match=words) as caught:
            attempt()
        one_sentence(caught.value)


def test_every_reason_has_a_class_of_its_own_that_survives_pickling():
    classes = set()
    for number, name in REASON.name.items():
        if name == "unspecified":
            continue
        status = Status(code=503, reason=number, message="why", request_id="mine")
        status.earliest_feasible.nanos = 1_500_000
        error = refusal(status)
        assert (error.reason, str(error), error.earliest_feasible_ms) == (name.upper(), "why", 1.5)
        again = pickle.loads(pickle.dumps(error))
        assert (type(again), vars(again)) == (type(error), vars(error))
        classes.add(type(error))
    assert len(classes) == len(REASON.name) - 1
    assert RefusedError not in classes
    assert all(getattr(stereo_client, kind.__name__) is kind for kind in classes)
