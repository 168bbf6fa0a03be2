"""The client for everybody else: the same methods without `await`."""

from __future__ import annotations

from collections.abc import Generator
from typing import TYPE_CHECKING, Any

from ._background import Background
from .aio import AsyncClient
from .batch import Outcome, Pairs, pair_message
from .camera import Camera, CameraInfo
from .errors import StereoError
from .images import ImageLike
from .result import Result

if TYPE_CHECKING:
    from collections.abc import Coroutine
    from types import TracebackType
    from typing import TypeVar

    from typing_extensions import Self, Unpack

    from ._access import Certificate, File
    from ._fleet import ServerInfo
    from .aio import Part
    from .options import Calibration, MatchOptions, ServiceOptions
    from .settings import Pairing, Settings

    T = TypeVar("T")


class Client:
    """Talks to a server over HTTP, or to all servers of a Zenoh network. Usable from several threads; connections are kept.

    Parameters
    ----------
    url : str
        `http://host:port` or `https://host:port` for one server; `zenoh://router:7447` for all servers behind a Zenoh router or beside
        a server, and `zenoh://` for those that are found in the local network.
    timeout_s : float
        How long a whole exchange may take before `NoAnswerError` is raised. Default 120.
    token : str, optional
        For HTTP, as `stereod token` prints it.
    ca : path, optional
        PEM file of the authority that has signed the certificate of an `https://` server. Default: those that this system trusts.
    cert : path or (path, path), optional
        PEM file of this client's certificate with its key, or one of each, for servers that ask for one.
    zenoh_config : path, optional
        A file with Zenoh's own configuration (JSON5): TLS, passwords, ..; endpoints of `url` win over its own.

    Examples
    --------
    >>> with Client("http://127.0.0.1:8080") as client:  # doctest: +SKIP
    ...     result = client.match("left.png", "right.png", budget_ms=80)
    >>> result.disparity  # doctest: +SKIP
    """

    def __init__(
        self,
        url: str,
        *,
        timeout_s: float = 120.0,
        token: str | None = None,
        ca: File | None = None,
        cert: Certificate | None = None,
        zenoh_config: File | None = None,
    ) -> None:
        self._async = AsyncClient(url, timeout_s=timeout_s, token=token, ca=ca, cert=cert, zenoh_config=zenoh_config)
        self._background = Background()

    @property
    def url(self) -> str:
        """The address that was given."""
        return self._async.url

    def match(self, left: ImageLike, right: ImageLike, **options: Unpack[MatchOptions]) -> Result:
        """Match one pair; see `AsyncClient.match`."""
        return self._run(self._async.send(pair_message(left, right, options)))

    def match_anytime(
        self, left: ImageLike, right: ImageLike, **options: Unpack[MatchOptions]
    ) -> Generator[Result, None, None]:
        """Match one pair and yield results as they get better; see `AsyncClient.match_anytime`."""
        self._check_open()
        return self._background.iterate(self._async.match_anytime(left, right, **options))

    def match_many(self, pairs: Pairs, **options: Unpack[MatchOptions]) -> Generator[Outcome, None, None]:
        """Match any number of pairs in constant memory, as background work; see `AsyncClient.match_many`.

        Nothing is sent before the first outcome is asked for; breaking out of the loop cancels what is left.
        """
        self._check_open()
        return self._background.iterate(self._async.match_many(pairs, **options))

    def send(self, request: Any) -> Result:
        """Match a `stereo.v1.StereoRequest` that was made elsewhere."""
        return self._run(self._async.send(request))

    def stream(
        self, camera: str, *, part: Part | None = None, timeout_s: float = 10.0
    ) -> Generator[Result, None, None]:
        """Yield the results of a camera as they come; see `AsyncClient.stream`. It is subscribed when the first one is asked for."""
        self._check_open()
        return self._background.iterate(self._async.stream(camera, part=part, timeout_s=timeout_s))

    def camera(self, name: str) -> Camera:
        """Return a camera that sends frames: `with client.camera("front") as camera`. Over Zenoh."""
        self._check_open()
        return Camera(self._background, self._async.camera(name))

    def cameras(self) -> list[CameraInfo]:
        """Return the cameras that are there, and who serves each."""
        return self._run(self._async.cameras())

    def servers(self) -> list[ServerInfo]:
        """Return the servers that are there, and how busy they are. Over Zenoh."""
        return self._run(self._async.servers())

    def settings(self, camera: str) -> Settings:
        """Return what is done with the frames of a camera. Over Zenoh."""
        return self._run(self._async.settings(camera))

    def set_settings(
        self,
        camera: str,
        *,
        calibration: Calibration | None = None,
        pairing: Pairing | None = None,
        **options: Unpack[ServiceOptions],
    ) -> Settings:
        """Change what is done with the frames of a camera; see `AsyncClient.set_settings`."""
        return self._run(self._async.set_settings(camera, calibration=calibration, pairing=pairing, **options))

    def info(self) -> dict[str, Any]:
        """Return what the server says about itself: version, limits, presets and their rungs. Over HTTP."""
        return self._run(self._async.info())

    def wait_ready(self, timeout_s: float = 30.0) -> None:
        """Wait until the server takes frames; over Zenoh, until there is one."""
        self._run(self._async.wait_ready(timeout_s))

    def close(self) -> None:
        """Close the connections; what is under way ends with an error."""
        if not self._background.is_stopped:
            self._background.run(self._async.close())
            self._background.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self, work: Coroutine[Any, Any, T]) -> T:
        if self._background.is_stopped:
            work.close()
        self._check_open()
        return self._background.run(work)

    def _check_open(self) -> None:
        if self._background.is_stopped:
            raise StereoError("this client has been closed: make another one")
