//! What is printed when the pair is matched.

use std::io::{self, Write, stdout};
use std::path::PathBuf;
use std::time::Duration;

use crate::job::{Degradation, Report};

/// Prints the stages' times, what was done, and the files.
pub(super) fn print(report: &Report, written: &[PathBuf]) -> io::Result<()> {
    let mut out = stdout().lock();
    writeln!(out, "{}", table(report))?;
    for path in written {
        writeln!(out, "wrote {}", path.display())?;
    }
    Ok(())
}

fn table(report: &Report) -> String {
    let stages = [
        ("wait", report.queued),
        ("decode", report.decoded),
        ("match", report.matched),
        ("mesh", report.meshed),
        ("encode", report.encoded),
        ("total", report.total),
    ];
    let mut table = String::from("stage        ms\n");
    for (name, took) in stages {
        table += &format!("{name:<8} {:>8.2}\n", ms(took));
    }
    let Report {
        iterations_run,
        iterations_asked,
        rung,
        ..
    } = report;
    table += &format!(
        "rungs    {iterations_run} of {iterations_asked}, the last is {rung}\ndensity  {:.1} %, estimated right within 3 px: {:.1} %",
        100.0 * report.density,
        100.0 * report.quality_estimate
    );
    if report.degradation != Degradation::default() {
        table += &format!("\nless than asked for: {}", report.degradation);
    }
    if !report.deadline_met {
        table += &format!(
            "\nlate: the latency budget was {} ms (--latency-budget-ms)",
            ms(report.budget)
        );
    }
    table
}

fn ms(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_names_every_stage_and_says_what_was_cut() {
        let report = Report {
            matched: Duration::from_micros(12_345),
            iterations_run: 2,
            iterations_asked: 4,
            rung: "mesh-8",
            degradation: Degradation {
                rungs: Some(crate::job::RungsCut::Budget),
                ..Degradation::default()
            },
            deadline_met: true,
            ..Report::default()
        };
        let table = table(&report);
        assert!(
            table.contains("match       12.35\n") || table.contains("match       12.34\n"),
            "{table}"
        );
        assert!(table.contains("2 of 4, the last is mesh-8") && table.contains("no time"));
        assert!(!table.contains("\nlate"));
    }
}
