"""A camera: it says that it is there, and sends frames."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ._over_zenoh import OverZenoh, camera_name
from ._schema import ImageStamp
from ._zenoh_session import encoding
from .batch import pair_message
from .errors import InterruptedExchangeError, NoFramesError
from .images import ImageLike, PixelFormat, image_message

if TYPE_CHECKING:
    from types import TracebackType

    import zenoh
    from typing_extensions import Self, Unpack

    from ._background import Background
    from .options import MatchOptions


@dataclass(frozen=True)
class CameraInfo:
    """A camera that is there, and the server that serves it, if one does."""

    name: str
    server: str | None


class AsyncCamera:
    """A camera of a Zenoh network, for asyncio: `async with client.camera("front") as camera`. Servers serve it while it is open.

    Frames get sequence numbers from 0 and the present time unless they are given; what a slow link can't take is dropped, and the server
    counts the gap.
    """

    def __init__(self, transport: OverZenoh, name: str) -> None:
        self.name = camera_name(name)
        self._transport = transport
        self._next = 0
        self._token: zenoh.LivelinessToken | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}

    async def open(self) -> None:
        """Announce the camera."""
        session = await self._transport.session.open()
        await asyncio.to_thread(self._declare, session)

    def _declare(self, session: zenoh.Session) -> None:
        import zenoh

        for part in ("", "/left", "/right"):
            self._publishers[part] = session.declare_publisher(
                f"stereo/v1/frames/{self.name}{part}",
                congestion_control=zenoh.CongestionControl.DROP,
                express=True,
            )
        self._token = session.liveliness().declare_token(f"stereo/v1/camera/{self.name}")

    async def wait_served(self, timeout_s: float = 10.0) -> str:
        """Wait until a server serves the camera, so that the first frames are not lost; returns the server's name."""
        fleet = self._transport.fleet
        await fleet.watch()
        try:
            await asyncio.wait_for(fleet.until(lambda: fleet.owner(self.name) is not None), timeout_s)
        except (TimeoutError, asyncio.TimeoutError) as why:
            raise NoFramesError(
                f"no server serves the camera {self.name!r} after {timeout_s:g} s: start `stereod serve` on the same Zenoh network"
            ) from why
        return fleet.owner(self.name) or ""

    async def publish(self, left: ImageLike, right: ImageLike, **options: Unpack[MatchOptions]) -> int:
        """Send a frame, both images in one message; options win over the camera's settings. Returns its sequence number."""
        return await asyncio.to_thread(self._publish, left, right, options)

    async def publish_left(
        self, image: ImageLike, sequence: int, capture_time_ns: int | None = None, pixel_format: PixelFormat = "rgb"
    ) -> None:
        """Send a left image by itself; the server brings it together with the right one of the same sequence number."""
        await asyncio.to_thread(self._publish_half, "left", image, sequence, capture_time_ns, pixel_format)

    async def publish_right(
        self, image: ImageLike, sequence: int, capture_time_ns: int | None = None, pixel_format: PixelFormat = "rgb"
    ) -> None:
        """Send a right image by itself."""
        await asyncio.to_thread(self._publish_half, "right", image, sequence, capture_time_ns, pixel_format)

    async def close(self) -> None:
        """Withdraw the camera."""
        await asyncio.to_thread(self._undeclare)

    def _undeclare(self) -> None:
        token, self._token = self._token, None
        if token is not None:
            token.undeclare()
        while self._publishers:
            self._publishers.popitem()[1].undeclare()

    def _publish(self, left: ImageLike, right: ImageLike, options: Mapping[str, Any]) -> int:
        options = {"sequence": self._next, "capture_time_ns": time.time_ns(), **options, "camera": self.name}
        request = pair_message(left, right, options)
        self._put("", request.SerializeToString(), encoding("StereoRequest"), None)
        self._next = request.sequence + 1
        return int(request.sequence)

    def _publish_half(
        self, side: str, image: ImageLike, sequence: int, time_ns: int | None, pixel_format: PixelFormat
    ) -> None:
        message = image_message(image, side, pixel_format)
        stamp = ImageStamp(sequence=sequence)
        seconds, nanos = divmod(time.time_ns() if time_ns is None else time_ns, 1_000_000_000)
        stamp.timestamp.seconds, stamp.timestamp.nanos = seconds, nanos
        message.timestamp.CopyFrom(stamp.timestamp)
        self._put(f"/{side}", message.SerializeToString(), encoding("Image"), stamp.SerializeToString())

    def _put(self, part: str, payload: bytes, kind: str, attachment: bytes | None) -> None:
        if self._token is None:
            raise InterruptedExchangeError(f"the camera {self.name!r} is not open: publish inside its `with`")
        import zenoh

        try:
            self._publishers[part].put(payload, encoding=kind, attachment=attachment)
        except zenoh.ZError as why:
            raise InterruptedExchangeError(f"the frame can't be sent ({why}): open the camera again") from why

    async def __aenter__(self) -> Self:
        await self.open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()


class Camera:
    """A camera of a Zenoh network: `with client.camera("front") as camera`. See `AsyncCamera`."""

    def __init__(self, background: Background, camera: AsyncCamera) -> None:
        self._background = background
        self._async = camera

    @property
    def name(self) -> str:
        """The camera's name."""
        return self._async.name

    def wait_served(self, timeout_s: float = 10.0) -> str:
        """Wait until a server serves the camera, so that the first frames are not lost; returns the server's name."""
        return self._background.run(self._async.wait_served(timeout_s))

    def publish(self, left: ImageLike, right: ImageLike, **options: Unpack[MatchOptions]) -> int:
        """Send a frame, both images in one message; options win over the camera's settings. Returns its sequence number."""
        return self._async._publish(left, right, options)

    def publish_left(
        self, image: ImageLike, sequence: int, capture_time_ns: int | None = None, pixel_format: PixelFormat = "rgb"
    ) -> None:
        """Send a left image by itself; the server brings it together with the right one of the same sequence number."""
        self._async._publish_half("left", image, sequence, capture_time_ns, pixel_format)

    def publish_right(
        self, image: ImageLike, sequence: int, capture_time_ns: int | None = None, pixel_format: PixelFormat = "rgb"
    ) -> None:
        """Send a right image by itself."""
        self._async._publish_half("right", image, sequence, capture_time_ns, pixel_format)

    def open(self) -> None:
        """Announce the camera."""
        self._background.run(self._async.open())

    def close(self) -> None:
        """Withdraw the camera."""
        if not self._background.is_stopped:
            self._background.run(self._async.close())

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
