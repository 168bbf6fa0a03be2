"""What was done for a request."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any


@dataclass(frozen=True)
class Report:
    """What was done for one request; names and units are those of the service's JSON, durations are in ms.

    Attributes
    ----------
    budget_ms : float or None
        The latency budget; None if there was none (background).
    received_ms, queued_ms, decoded_ms, matched_ms, meshed_ms, encoded_ms : float
        How long each stage took by itself.
    total_ms : float
        From the first byte of the request to the writing of this report.
    iterations_run, iterations_asked : int
        Rungs finished and asked for, the first included.
    rung : str
        Name of the last rung finished.
    predicted_cost_ms, actual_cost_ms : float
        What decoding, matching, meshing and encoding were expected to take, and took.
    deadline_met : bool
        Whether the report was written before the deadline.
    quality_estimate : float
        Estimated share of the high-gradient pixels that are right within 3 px, 0 to 1.
    density : float
        Share of the pixels asked for that have a disparity, 0 to 1.
    degradation : str
        Why less was done than asked for; empty if nothing was cut.
    worker : int
        Number of the worker.
    instance : str
        Name of the server.
    queue_depth : int
        Requests waiting when this one was taken.
    software_version : str
        Version of the server.
    """

    budget_ms: float | None
    received_ms: float
    queued_ms: float
    decoded_ms: float
    matched_ms: float
    meshed_ms: float
    encoded_ms: float
    total_ms: float
    iterations_run: int
    iterations_asked: int
    rung: str
    predicted_cost_ms: float
    actual_cost_ms: float
    deadline_met: bool
    quality_estimate: float
    density: float
    degradation: str
    worker: int
    instance: str
    queue_depth: int
    software_version: str

    @classmethod
    def from_message(cls, message: Any) -> Report:
        """Return what a `stereo.v1.ExecutionReport` says."""
        values: dict[str, Any] = {}
        for field in fields(cls):
            name = field.name.removesuffix("_ms")
            values[field.name] = ms(getattr(message, name)) if field.name.endswith("_ms") else getattr(message, name)
        if not message.HasField("budget"):
            values["budget_ms"] = None
        return cls(**values)

    def __str__(self) -> str:
        budget = "no budget" if self.budget_ms is None else f"budget {self.budget_ms:.0f} ms"
        kept = "met" if self.deadline_met else "missed"
        cut = f", {self.degradation}" if self.degradation else ""
        return (
            f"{self.total_ms:.1f} ms of {budget} ({kept}), {self.iterations_run} of {self.iterations_asked} rungs ({self.rung}), "
            f"density {self.density:.0%}, quality {self.quality_estimate:.0%}{cut}, by {self.instance}"
        )


def ms(duration: Any) -> float:
    """Return a `google.protobuf.Duration` in ms."""
    return float(duration.seconds * 1e3 + duration.nanos / 1e6)
