//! The metrics as a table for people, read from the OpenMetrics text itself.
#![cfg(test)]

use std::collections::BTreeSet;
use std::fmt::Write as _;

use super::Metrics;

/// Everything above the rows.
const HEAD: &str = "# Metrics

`GET /metrics` answers in the OpenMetrics text format. Counters end in `_total`, histograms in `_bucket`, `_sum` and `_count`.
Every label has a fixed set of values. This file is generated from the registry: after a change, run
`cargo test --release -p stereod metrics`, which rewrites it and fails once.

| name | type | unit | labels | meaning |
| --- | --- | --- | --- | --- |
";

/// The whole file.
pub(super) fn markdown() -> String {
    let text = Metrics::new().text();
    let mut file = HEAD.to_owned();
    let mut lines = text.lines().peekable();
    while let Some(line) = lines.next() {
        let Some((name, help)) = line.strip_prefix("# HELP ").and_then(|rest| rest.split_once(' ')) else {
            continue;
        };
        let (mut kind, mut unit, mut labels) = ("", "", BTreeSet::new());
        while let Some(line) = lines.next_if(|line| !line.starts_with("# HELP ")) {
            if let Some(rest) = line.strip_prefix("# TYPE ") {
                kind = rest.split(' ').nth(1).unwrap_or_default();
            } else if let Some(rest) = line.strip_prefix("# UNIT ") {
                unit = rest.split(' ').nth(1).unwrap_or_default();
            } else if let Some((_, rest)) = line.split_once('{') {
                let pairs = rest.split('}').next().unwrap_or_default().split(',');
                labels.extend(
                    pairs
                        .filter_map(|pair| pair.split('=').next())
                        .filter(|&key| key != "le"),
                );
            }
        }
        let labels = labels
            .into_iter()
            .map(|label| format!("`{label}`"))
            .collect::<Vec<_>>()
            .join(", ");
        // Writing to a string can't fail.
        let _ = writeln!(
            file,
            "| `{name}` | {kind} | {unit} | {labels} | {} |",
            help.trim_end_matches('.')
        );
    }
    file
}
