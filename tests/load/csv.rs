//! All figures of a table as comma-separated values, one line a load and policy.

use std::fmt::Write as _;
use std::time::Duration;

use crate::figures::quantile;
use crate::record::{Outcome, Record, STAGES};
use crate::table::{Further, Row, Table};

const HEAD: &str = "time,machine,capacity_hz,load,policy,offered,offered_hz,in_budget,in_budget_from_sending,in_budget_by_server,admitted,admitted_missed,\
answered,expired,refused,not_sent,broken,goodput_hz,rungs_share,prediction_error_p95,latency_p50_ms,latency_p90_ms,latency_p99_ms,\
latency_p999_ms,refusal_p99_ms,sent_late_p99_ms,memory_peak_bytes,recovery_s,jain,others_lost";

/// The table, measured at `time`.
pub(crate) fn of(table: &Table, time: &str) -> String {
    let mut text = format!("{HEAD}\n");
    for row in &table.rows {
        let cells: Vec<String> = cells(table, row, time).into_iter().map(quoted).collect();
        writeln!(text, "{}", cells.join(",")).expect("a String takes everything");
    }
    text
}

/// Every frame, in the order of the answers; times in milliseconds.
pub(crate) fn of_records(records: &[Record]) -> String {
    let ms = |time: Duration| format!("{:.3}", time.as_secs_f64() * 1e3);
    let mut text =
        "due,camera,budget,sent_late,latency,decided,outcome,rungs_run,predicted,actual,deadline_met,total,"
            .to_owned();
    text += &STAGES.join(",");
    text.push('\n');
    for record in records {
        let shot = &record.shot;
        let mut cells = vec![ms(shot.at), shot.camera.to_string(), ms(shot.budget)];
        cells.extend([record.lag, record.latency, record.decided].map(ms));
        match &record.outcome {
            Outcome::Answered(digest) => {
                cells.extend(["OK".to_owned(), digest.rungs_run.to_string()]);
                cells.extend([digest.predicted, digest.actual].map(ms));
                cells.push(digest.deadline_met.to_string());
                cells.push(ms(digest.total));
                cells.extend(digest.stages.map(ms));
            }
            Outcome::Refused { reason, .. } => cells.push(reason.as_str_name().to_owned()),
            Outcome::Broken(why) => cells.push(quoted(why.clone())),
            Outcome::NotSent => cells.push("NOT_SENT".to_owned()),
        }
        text += &cells.join(",");
        text.push('\n');
    }
    text
}

fn cells(table: &Table, row: &Row, time: &str) -> Vec<String> {
    let figures = &row.figures;
    let ms = |time: Duration| format!("{:.3}", time.as_secs_f64() * 1e3);
    let or_empty = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.4}"));
    let (mut recovery, mut jain, mut lost) = (None, None, None);
    match &row.further {
        Further::Burst { recovery: time, .. } => recovery = time.map(|time| time.as_secs_f64()),
        Further::Clients {
            lost: share,
            fairness,
        } => (jain, lost) = (Some(*fairness), *share),
        Further::Load { .. } | Further::Nothing => {}
    }
    let mut cells = vec![
        time.to_owned(),
        table.machine.clone(),
        format!("{:.2}", table.capacity_hz),
        row.name.clone(),
        row.policy.clone(),
    ];
    cells.extend([figures.offered.to_string(), format!("{:.2}", figures.offered_hz)]);
    cells.extend(
        [
            figures.in_budget,
            figures.in_budget_from_sending,
            figures.in_budget_by_the_server,
            figures.admitted,
            figures.missed_by_the_server,
            figures.answered,
            figures.expired,
            figures.refused.values().sum(),
            figures.not_sent,
            figures.broken.values().sum(),
        ]
        .map(|count| count.to_string()),
    );
    cells.extend([
        format!("{:.2}", figures.goodput_hz),
        format!("{:.4}", figures.rungs),
        or_empty(figures.prediction_error),
    ]);
    cells.extend([0.5, 0.9, 0.99, 0.999].map(|share| ms(quantile(&figures.latency, share))));
    cells.extend([
        ms(quantile(&figures.refusing, 0.99)),
        ms(quantile(&figures.lag, 0.99)),
    ]);
    cells.push(
        row.memory_peak_bytes
            .map_or_else(String::new, |bytes| bytes.to_string()),
    );
    cells.extend([recovery, jain, lost].map(or_empty));
    cells
}

/// As RFC 4180 has it.
fn quoted(cell: String) -> String {
    if cell.contains([',', '"', '\n']) {
        format!("\"{}\"", cell.replace('"', "\"\""))
    } else {
        cell
    }
}

#[cfg(test)]
mod tests {
    use super::{HEAD, cells, of, quoted};
    use crate::table::tests::sample;

    #[test]
    fn every_line_has_as_many_cells_as_the_head() {
        let table = sample();
        for row in &table.rows {
            assert_eq!(cells(&table, row, "now").len(), HEAD.split(',').count());
        }
        assert_eq!(of(&table, "now").lines().count(), 1 + table.rows.len());
    }

    #[test]
    fn commas_and_quotes_are_quoted() {
        assert_eq!(quoted("a,\"b\"".to_owned()), "\"a,\"\"b\"\"\"");
        assert_eq!(quoted("plain".to_owned()), "plain");
    }
}
