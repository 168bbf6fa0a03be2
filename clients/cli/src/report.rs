//! What was done for a pair, in numbers.

use std::time::Duration;

use serde_json::{Value, json};
use stereo_client::v1::{ExecutionReport, StereoResult};

use crate::output::ms;

/// A report as JSON; durations are milliseconds.
pub(crate) fn report_json(report: &ExecutionReport) -> Value {
    let time = |duration: Option<_>| duration.map(|duration| ms(known(Some(duration))));
    json!({
        "budget_ms": time(report.budget),
        "received_ms": time(report.received),
        "queued_ms": time(report.queued),
        "decoded_ms": time(report.decoded),
        "matched_ms": time(report.matched),
        "meshed_ms": time(report.meshed),
        "encoded_ms": time(report.encoded),
        "total_ms": time(report.total),
        "iterations_run": report.iterations_run,
        "iterations_asked": report.iterations_asked,
        "rung": report.rung,
        "deadline_met": report.deadline_met,
        "quality_estimate": report.quality_estimate,
        "density": report.density,
        "degradation": report.degradation,
        "has_converged": report.has_converged,
        "instance": report.instance,
        "software_version": report.software_version,
    })
}

/// A result in one line: rungs, times, density.
pub(crate) fn summary(result: &StereoResult) -> String {
    let Some(report) = &result.report else {
        return "no report".to_owned();
    };
    let time = |duration| ms(known(duration));
    let budget = match report.budget {
        Some(_) => format!(" of {:.0} ms", time(report.budget)),
        None => String::new(),
    };
    let converged = if report.has_converged { ", converged" } else { "" };
    let degradation = match report.degradation.as_str() {
        "" => String::new(),
        why => format!(" ({why})"),
    };
    format!(
        "{} of {} iterations{converged}, computed {:.1} ms, answered after {:.1} ms{budget}, density {:.1} %{degradation}",
        report.iterations_run,
        report.iterations_asked,
        time(report.actual_cost),
        time(report.total),
        100.0 * report.density,
    )
}

/// A duration of the wire; zero if it is absent.
pub(crate) fn known<D: TryInto<Duration>>(duration: Option<D>) -> Duration {
    duration
        .and_then(|duration| duration.try_into().ok())
        .unwrap_or_default()
}
