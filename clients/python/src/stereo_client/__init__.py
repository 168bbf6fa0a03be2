"""Client of stereod: a stereo pair and a latency budget in, depth as numpy arrays out.

>>> from stereo_client import Client
>>> with Client("http://127.0.0.1:8080") as client:  # doctest: +SKIP
...     client.match("left.png", "right.png", budget_ms=80).save("disparity.png", "color")

`disparity = x_left - x_right >= 0` in pixels, `depth_m = focal_px * baseline_m / (disparity_px + doffs_px)`; axes are x right, y down,
z forward, in metres; invalid = NaN.
"""

from ._fleet import ServerInfo
from .aio import AsyncClient
from .batch import Outcome, Pair
from .camera import AsyncCamera, Camera, CameraInfo
from .client import Client
from .errors import (
    DeadlineInfeasibleError,
    DrainingError,
    ExpiredError,
    ForbiddenError,
    InputError,
    InsecureConnectionError,
    InternalError,
    InterruptedExchangeError,
    InvalidError,
    MalformedReplyError,
    MissingPackageError,
    MissingPartError,
    NoAnswerError,
    NoFramesError,
    NoServerError,
    NotServedError,
    QueueFullError,
    QuotaError,
    RefusedError,
    SlowReaderError,
    StereoError,
    SupersededError,
    TooLargeError,
    UnauthenticatedError,
    UnreachableError,
)
from .images import ImageLike
from .options import Calibration, MatchOptions, MeshOptions, Region, ServiceOptions
from .report import Report
from .result import Mesh, Points, Result
from .settings import Pairing, Settings

__all__ = [
    "AsyncCamera",
    "AsyncClient",
    "Calibration",
    "Camera",
    "CameraInfo",
    "Client",
    "DeadlineInfeasibleError",
    "DrainingError",
    "ExpiredError",
    "ForbiddenError",
    "ImageLike",
    "InputError",
    "InsecureConnectionError",
    "InternalError",
    "InterruptedExchangeError",
    "InvalidError",
    "MalformedReplyError",
    "MatchOptions",
    "Mesh",
    "MeshOptions",
    "MissingPackageError",
    "MissingPartError",
    "NoAnswerError",
    "NoFramesError",
    "NoServerError",
    "NotServedError",
    "Outcome",
    "Pair",
    "Pairing",
    "Points",
    "QueueFullError",
    "QuotaError",
    "RefusedError",
    "Region",
    "Report",
    "Result",
    "ServerInfo",
    "ServiceOptions",
    "Settings",
    "SlowReaderError",
    "StereoError",
    "SupersededError",
    "TooLargeError",
    "UnauthenticatedError",
    "UnreachableError",
]
