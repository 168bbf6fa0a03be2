"""The client for asyncio."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias

from ._access import Access
from ._fleet import ServerInfo
from ._over_http import OverHttp
from ._over_zenoh import OverZenoh
from .batch import Outcome, Pairs, Underway, pair_message
from .camera import AsyncCamera, CameraInfo
from .errors import InputError, NotServedError
from .images import ImageLike
from .result import Result
from .settings import Pairing, Settings, settings_message

if TYPE_CHECKING:
    from types import TracebackType

    from typing_extensions import Self, Unpack

    from ._access import Certificate, File
    from .options import Calibration, MatchOptions, ServiceOptions


Part: TypeAlias = Literal["disparity", "mesh", "report"]


class Transport(Protocol):
    """What HTTP and Zenoh have in common; messages in, messages out."""

    url: str

    async def match(self, request: Any) -> Any:
        """Return the result of one request."""

    def anytime(self, request: Any) -> AsyncGenerator[Any, None]:
        """Yield better and better results of one request."""

    def batch(self, requests: AsyncIterator[Any]) -> AsyncGenerator[Any, None]:
        """Yield a reply for each request as they are done."""

    def results(self, camera: str, part: str | None, timeout_s: float) -> AsyncGenerator[Any, None]:
        """Yield the results of a camera."""

    async def cameras(self) -> list[tuple[str, str | None]]:
        """Return the cameras that are there, and who serves each."""

    async def close(self) -> None:
        """Close the connections."""


class AsyncClient:
    """Talks to a server over HTTP, or to all servers of a Zenoh network; for asyncio.

    It belongs to the event loop that it is first used in.

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
        self._transport = _transport(url, timeout_s, Access(token, ca, cert), zenoh_config)

    @property
    def url(self) -> str:
        """The address that was given."""
        return self._transport.url

    async def match(self, left: ImageLike, right: ImageLike, **options: Unpack[MatchOptions]) -> Result:
        """Match one pair.

        Parameters
        ----------
        left, right : array, Pillow image, path or bytes
            The rectified pair; see `ImageLike`.
        **options
            What is wanted; see `MatchOptions`, `budget_ms` first of all.

        Raises
        ------
        RefusedError
            The server's refusal, as the class of its reason.
        StereoError
            Everything else: the address, the network, the images.
        """
        request = await asyncio.to_thread(pair_message, left, right, options)
        return await self.send(request)

    async def match_anytime(
        self, left: ImageLike, right: ImageLike, **options: Unpack[MatchOptions]
    ) -> AsyncGenerator[Result, None]:
        """Match one pair and yield results as they get better: the first rung soon, the last within the budget. HTTP has the last alone."""
        request = await asyncio.to_thread(pair_message, left, right, options)
        async with aclosing(self._transport.anytime(request)) as results:
            async for message in results:
                yield Result(message, request.left)

    async def match_many(self, pairs: Pairs, **options: Unpack[MatchOptions]) -> AsyncGenerator[Outcome, None]:
        """Match any number of pairs in constant memory, as background work: yields what became of each as they are done.

        Parameters
        ----------
        pairs : iterable or async iterable of (left, right) or Pair
            Taken as fast as the server works; it may be endless. An ordinary iterable is read in a thread of its own.
        **options
            What is wanted of all pairs; see `MatchOptions`.

        Yields
        ------
        Outcome
            `outcome.index` says of which pair; `outcome.result` raises if that pair was refused. To cancel what is left, stop
            iterating and close the iterator.
        """
        underway = Underway(pairs, options)
        async with aclosing(underway.requests()) as requests, aclosing(self._transport.batch(requests)) as replies:
            async for reply in replies:
                yield underway.outcome(reply)
        underway.check_all_answered()

    async def send(self, request: Any) -> Result:
        """Match a `stereo.v1.StereoRequest` that was made elsewhere."""
        return Result(await self._transport.match(request), request.left)

    async def stream(
        self, camera: str, *, part: Part | None = None, timeout_s: float = 10.0
    ) -> AsyncGenerator[Result, None]:
        """Yield the results of a camera as they come; who reads slowly gets the newest, and sees the gap in `sequence`.

        Parameters
        ----------
        camera : str
            Its name.
        part : str, optional
            `disparity`, `mesh` or `report`: only that part is sent (over Zenoh).
        timeout_s : float
            How long the next result is waited for before `NoFramesError` says why nothing comes. Default 10.
        """
        async with aclosing(self._transport.results(camera, part, timeout_s)) as results:
            async for message in results:
                yield Result(message)

    def camera(self, name: str) -> AsyncCamera:
        """Return a camera that sends frames: `async with client.camera("front") as camera`. Over Zenoh."""
        return AsyncCamera(self._over_zenoh("frames of a camera"), name)

    async def cameras(self) -> list[CameraInfo]:
        """Return the cameras that are there, and who serves each."""
        return [CameraInfo(name, server) for name, server in await self._transport.cameras()]

    async def servers(self) -> list[ServerInfo]:
        """Return the servers that are there, and how busy they are. Over Zenoh."""
        fleet = self._over_zenoh("the load of the servers").fleet
        await fleet.watch()
        return fleet.servers()

    async def settings(self, camera: str) -> Settings:
        """Return what is done with the frames of a camera. Over Zenoh."""
        return Settings.from_message(await self._over_zenoh("settings of cameras").settings(camera, None))

    async def set_settings(
        self,
        camera: str,
        *,
        calibration: Calibration | None = None,
        pairing: Pairing | None = None,
        **options: Unpack[ServiceOptions],
    ) -> Settings:
        """Change what is done with the frames of a camera, all at once: what is not given goes back to its default. Over Zenoh.

        Returns what is in force.
        """
        message = settings_message(options, calibration, pairing)
        return Settings.from_message(await self._over_zenoh("settings of cameras").settings(camera, message))

    async def info(self) -> dict[str, Any]:
        """Return what the server says about itself: version, limits, presets and their rungs. Over HTTP."""
        return await self._over_http("what a server says about itself").info()

    async def wait_ready(self, timeout_s: float = 30.0) -> None:
        """Wait until the server takes frames; over Zenoh, until there is one."""
        if isinstance(self._transport, OverZenoh):
            await self._transport.wait_ready(timeout_s)
        else:
            await self._over_http("readiness").wait_ready(timeout_s)

    async def close(self) -> None:
        """Close the connections."""
        await self._transport.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    def _over_http(self, what: str) -> OverHttp:
        if not isinstance(self._transport, OverHttp):
            raise NotServedError(f"{what} can be had over HTTP alone: use Client('http://..')")
        return self._transport

    def _over_zenoh(self, what: str) -> OverZenoh:
        if not isinstance(self._transport, OverZenoh):
            raise NotServedError(f"{what} can be had over Zenoh alone: use Client('zenoh://..')")
        return self._transport


def _transport(url: str, timeout_s: float, access: Access, zenoh_config: File | None) -> Transport:
    if not isinstance(url, str):
        raise InputError(f"{url!r} is no address of a server: give one such as 'http://127.0.0.1:8080'")
    if url.startswith("zenoh://"):
        if access != Access():
            raise InputError(
                "token, ca and cert are for http:// and https://: for Zenoh, TLS and passwords stand in the file zenoh_config"
            )
        return OverZenoh(url, timeout_s, zenoh_config)
    return OverHttp(url, timeout_s, access)
