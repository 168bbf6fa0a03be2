//! The report as the wire's.

use std::time::Duration;

use prost::Message;
use stereo_proto::v1;

use crate::job::{FrameOptions, Report};

/// The bytes of an `ExecutionReport`.
#[must_use]
pub fn report_body(report: &Report) -> Vec<u8> {
    to_proto(report).encode_to_vec()
}

/// Field by field.
pub(super) fn to_proto(report: &Report) -> v1::ExecutionReport {
    // Durations of a request are far below the wire's largest.
    let wire = |duration: Duration| duration.try_into().ok();
    v1::ExecutionReport {
        budget: (report.budget < FrameOptions::UNBOUNDED)
            .then(|| wire(report.budget))
            .flatten(),
        received: wire(report.received),
        queued: wire(report.queued),
        decoded: wire(report.decoded),
        matched: wire(report.matched),
        meshed: wire(report.meshed),
        encoded: wire(report.encoded),
        total: wire(report.total),
        iterations_run: report.iterations_run,
        iterations_asked: report.iterations_asked,
        rung: report.rung.to_owned(),
        predicted_cost: wire(report.predicted_cost),
        actual_cost: wire(report.actual_cost),
        deadline_met: report.deadline_met,
        quality_estimate: report.quality_estimate,
        density: report.density,
        degradation: report.degradation.to_string(),
        worker: report.worker,
        instance: report.instance.clone(),
        queue_depth: report.queue_depth,
        software_version: report.software_version.to_owned(),
        has_converged: report.has_converged,
    }
}
