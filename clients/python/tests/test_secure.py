"""Tokens, and TLS in both directions."""

from __future__ import annotations

import datetime
import re
import ssl
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import trustme
from impostor import impostor, saying
from scene import Scene
from server import Server
from terminator import terminator

from stereo_client import (
    Client,
    ForbiddenError,
    InputError,
    InsecureConnectionError,
    MalformedReplyError,
    StereoError,
    UnauthenticatedError,
)


@dataclass(frozen=True)
class Authority:
    """An authority, and the files of those it has signed."""

    signer: trustme.CA
    folder: Path

    @property
    def ca(self) -> Path:
        path = self.folder / "ca.pem"
        self.signer.cert_pem.write_to_path(path)
        return path

    def context(self, *names: str, **issued) -> ssl.SSLContext:
        """What a server called so speaks TLS with."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        self.signer.issue_cert(*names, **issued).configure_cert(context)
        return context

    def client(self) -> tuple[Path, Path]:
        """Certificate and key of a client."""
        issued = self.signer.issue_cert("robot@example.org")
        chain, key = self.folder / "client.pem", self.folder / "client.key"
        issued.private_key_pem.write_to_path(key)
        chain.write_bytes(b"".join(blob.bytes() for blob in issued.cert_chain_pems))
        return chain, key


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority(trustme.CA(), tmp_path)


@pytest.fixture
def secure(server: Server, authority: Authority) -> Iterator[str]:
    with terminator(server.url, authority.context("127.0.0.1", "localhost")) as url:
        yield url


def failure(kind: type[StereoError], url: str, **access) -> str:
    with Client(url, **access) as client, pytest.raises(kind) as caught:
        client.info()
    text = str(caught.value)
    assert "\n" not in text
    assert not re.search(r"\. [A-Z]", text)
    return text


def test_pairs_and_batches_go_by_tls(client: Client, secure: str, authority: Authority, scene: Scene):
    expected = client.match(scene.left, scene.right, budget_ms=10_000).disparity
    with Client(secure, ca=authority.ca) as tls:
        tls.wait_ready()
        for _ in range(3):
            result = tls.match(scene.left, scene.right, budget_ms=10_000)
            np.testing.assert_array_equal(result.disparity, expected)
        outcomes = list(tls.match_many([(scene.left, scene.right)] * 10))
        assert sorted(outcome.index for outcome in outcomes) == list(range(10))
        for outcome in outcomes:
            np.testing.assert_array_equal(outcome.result.disparity, expected)


def test_a_large_pair_goes_by_tls_while_it_is_refused(secure: str, authority: Authority):
    large = np.zeros((5000, 4000), np.uint16)
    with Client(secure, ca=authority.ca) as client, pytest.raises(StereoError) as caught:
        client.match(large, large)
    assert "5000" in str(caught.value) or "bytes" in str(caught.value)


def test_a_server_that_nobody_vouches_for_is_not_talked_to(secure: str, tmp_path: Path):
    assert "give the certificate of its authority as ca" in failure(InsecureConnectionError, secure)
    other = tmp_path / "other.pem"
    trustme.CA().cert_pem.write_to_path(other)
    assert "signed by nobody who is trusted here" in failure(InsecureConnectionError, secure, ca=other)


def test_a_certificate_for_another_name_or_time_is_told_apart(server: Server, authority: Authority):
    with terminator(server.url, authority.context("robot.example.org")) as url:
        assert "for another name" in failure(InsecureConnectionError, url, ca=authority.ca)
    past = datetime.datetime(2020, 1, 1, tzinfo=datetime.timezone.utc)
    with terminator(server.url, authority.context("127.0.0.1", not_after=past)) as url:
        assert "has expired" in failure(InsecureConnectionError, url, ca=authority.ca)


def test_a_server_that_asks_for_a_certificate_gets_it(server: Server, authority: Authority):
    context = authority.context("127.0.0.1")
    context.verify_mode = ssl.CERT_REQUIRED
    authority.signer.configure_trust(context)
    chain, key = authority.client()
    both = authority.folder / "both.pem"
    both.write_bytes(chain.read_bytes() + key.read_bytes())
    with terminator(server.url, context) as url:
        for cert in ((chain, key), both):
            with Client(url, ca=authority.ca, cert=cert) as client:
                assert client.info()["version"]
        # Its alert is lost if it closes on what has been sent meanwhile; what to do is said in either case.
        text = failure(StereoError, url, ca=authority.ca)
        assert re.search("asks for a certificate of its clients.* as cert", text), text


def test_plain_and_secure_ports_are_told_apart(server: Server, authority: Authority):
    plain = server.url.replace("http://", "https://")
    assert "use http://" in failure(InsecureConnectionError, plain, ca=authority.ca)
    # A server on rustls answers what is no TLS with an alert.
    with impostor(saying(b"\x15\x03\x03\x00\x02\x02\x32")) as url:
        assert "or use https:// if it has TLS" in failure(MalformedReplyError, url)


@pytest.mark.parametrize(
    ("access", "words"),
    [
        ({"ca": "no/such.pem"}, r"ca 'no/such\.pem' can't be used \(No such file"),
        ({"ca": 7}, "ca 7 can't be used"),
        ({"cert": "no/such.pem"}, r"cert 'no/such\.pem' can't be used"),
        ({"token": ""}, "`stereod token`"),
        ({"token": "two words"}, "`stereod token`"),
        ({"token": "line\nbreak"}, "`stereod token`"),
    ],
)
def test_what_can_not_be_shown_is_refused_at_once(access, words):
    with pytest.raises(InputError, match=words):
        Client("https://127.0.0.1:8443", **access)


def test_zenoh_has_its_own_configuration_for_that():
    with pytest.raises(InputError, match="zenoh_config"):
        Client("zenoh://127.0.0.1:7447", token="abc")


def test_a_server_with_tokens_lets_in_who_has_one(program: str, tmp_path: Path, scene: Scene):
    tokens, hashes = {}, {}
    for name in ("lab", "guest"):
        said = subprocess.run([program, "token", name], capture_output=True, text=True, check=True).stdout
        tokens[name] = re.search(r"^stereod_[0-9a-f]{64}$", said, re.MULTILINE)[0]
        hashes[name] = re.search(r'^token_sha256 = ".*"$', said, re.MULTILINE)[0]
    config = tmp_path / "stereod.toml"
    config.write_text(f'[clients.lab]\n{hashes["lab"]}\n\n[clients.guest]\n{hashes["guest"]}\ncameras = ["other"]\n')
    lab, guest = tokens["lab"], tokens["guest"]
    with Server.start(program, "--config", str(config)) as server:
        with Client(server.url, token=lab) as client:
            assert client.match(scene.left, scene.right, budget_ms=10_000).disparity.shape == scene.left.shape
            assert len(list(client.match_many([(scene.left, scene.right)] * 2))) == 2
            assert lab not in repr(vars(client)) + repr(client)
        with Client(server.url) as client, pytest.raises(UnauthenticatedError):
            client.match(scene.left, scene.right)
        with Client(server.url, token="wrong") as client, pytest.raises(UnauthenticatedError) as caught:
            next(client.match_many([(scene.left, scene.right)]))
        assert caught.value.code == 401
        with Client(server.url, token=guest) as client, pytest.raises(ForbiddenError):
            client.match(scene.left, scene.right, camera="front")
