"""What can go wrong. Every message is one sentence that says what is wrong and what to do."""

from __future__ import annotations

from typing import Any

from ._schema import REASON, Status


class StereoError(Exception):
    """Base of all errors of this package."""


class InputError(StereoError, ValueError):
    """Something was given that can't be sent: an image, an option, an address."""


class MissingPartError(StereoError):
    """The result does not have the part that was asked of it."""


class MissingPackageError(StereoError, ImportError):
    """An optional package is needed and not installed."""


class NotServedError(StereoError):
    """The transport of this client does not have what was asked of it."""


class UnreachableError(StereoError, ConnectionError):
    """No connection to the server: a wrong address, or a server that is down."""


class InsecureConnectionError(UnreachableError):
    """TLS does not trust who answers, or they don't trust this client."""


class NoServerError(UnreachableError):
    """The network is there, but no server on it."""


class NoFramesError(StereoError):
    """A camera sends nothing, or is not there."""


class InterruptedExchangeError(StereoError, ConnectionError):
    """The connection broke before the answer was whole."""


class NoAnswerError(StereoError, TimeoutError):
    """The server did not answer in time."""


class MalformedReplyError(StereoError):
    """The server's answer can't be read."""


class RefusedError(StereoError):
    """The server refused the request.

    Attributes
    ----------
    reason : str
        Why, for programs: `DEADLINE_INFEASIBLE`, `QUEUE_FULL`, ..
    message : str
        Why and what to do about it: the server's sentence.
    code : int
        The HTTP status code, whatever the transport.
    earliest_feasible_ms : float or None
        The smallest budget that could be met now (`DEADLINE_INFEASIBLE`), else how long to wait before trying again.
    request_id : str
        The request's id, empty if it could not be read.
    """

    def __init__(
        self,
        message: str,
        *,
        reason: str = "INTERNAL",
        code: int = 500,
        earliest_feasible_ms: float | None = None,
        request_id: str = "",
    ) -> None:
        super().__init__(message)
        self.message = message
        self.reason = reason
        self.code = code
        self.earliest_feasible_ms = earliest_feasible_ms
        self.request_id = request_id

    def to_status(self) -> Any:
        """Return the `stereo.v1.Status` that it was."""
        status = Status(code=self.code, message=self.message, request_id=self.request_id)
        status.reason = REASON.number.get(self.reason.lower(), 0)
        if self.earliest_feasible_ms is not None:
            status.earliest_feasible.FromNanoseconds(round(self.earliest_feasible_ms * 1e6))
        return status

    def __reduce__(self) -> tuple[Any, ...]:
        """Survive pickling, as results of process pools have to."""
        return (type(self), (self.message,), self.__dict__)


class DeadlineInfeasibleError(RefusedError):
    """The budget can't be met even with the least work; nothing was done."""


class ExpiredError(RefusedError):
    """The budget was over before a result was ready."""


class QueueFullError(RefusedError):
    """Too many requests wait already."""


class QuotaError(RefusedError):
    """The client used up its share."""


class InvalidError(RefusedError):
    """Malformed, out of range, contradictory, or a pair that can't be matched."""


class TooLargeError(RefusedError):
    """Over the server's limits."""


class SupersededError(RefusedError):
    """A newer frame of the same stream took its place."""


class DrainingError(RefusedError):
    """The server is stopping."""


class InternalError(RefusedError):
    """A fault of the server."""


class UnauthenticatedError(RefusedError):
    """No credential, or an unknown one."""


class ForbiddenError(RefusedError):
    """The credential does not allow this."""


class SlowReaderError(RefusedError):
    """The replies were not read; what was left of the batch was dropped."""


_BY_REASON: dict[str, type[RefusedError]] = {
    "DEADLINE_INFEASIBLE": DeadlineInfeasibleError,
    "EXPIRED": ExpiredError,
    "QUEUE_FULL": QueueFullError,
    "QUOTA": QuotaError,
    "INVALID": InvalidError,
    "TOO_LARGE": TooLargeError,
    "SUPERSEDED": SupersededError,
    "DRAINING": DrainingError,
    "INTERNAL": InternalError,
    "UNAUTHENTICATED": UnauthenticatedError,
    "FORBIDDEN": ForbiddenError,
    "SLOW_READER": SlowReaderError,
}


def refusal(status: Any) -> RefusedError:
    """Return the exception that a `stereo.v1.Status` is."""
    reason = REASON.name.get(status.reason, "unspecified").upper()
    earliest_ms = None
    if status.HasField("earliest_feasible"):
        earliest_ms = status.earliest_feasible.seconds * 1e3 + status.earliest_feasible.nanos / 1e6
    return _BY_REASON.get(reason, RefusedError)(
        status.message or f"the server refused the request ({reason})",
        reason=reason,
        code=status.code,
        earliest_feasible_ms=earliest_ms,
        request_id=status.request_id,
    )
