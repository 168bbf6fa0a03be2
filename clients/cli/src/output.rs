//! What goes to standard output: text for people or, with `--json`, one JSON object a line.

use std::io::{ErrorKind, Write};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::Value;

use crate::failure::{Failure, Kind};

/// Where results are printed.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Output {
    pub(crate) is_json: bool,
}

impl Output {
    /// A line for people; nothing with `--json`.
    pub(crate) fn text(self, line: &str) -> Result<(), Failure> {
        if self.is_json { Ok(()) } else { print(line) }
    }

    /// A JSON object on one line; nothing without `--json`.
    pub(crate) fn json(self, object: &Value) -> Result<(), Failure> {
        if self.is_json {
            print(&object.to_string())
        } else {
            Ok(())
        }
    }

    /// What there is to say about a failure: to people on standard error, to programs where they read.
    pub(crate) fn failure(self, failure: &Failure) {
        if failure.kind == Kind::OutputClosed {
            return;
        }
        if self.is_json {
            // Nobody is left to tell if this fails.
            drop(print(&failure.to_json().to_string()));
        } else {
            complain(failure);
        }
    }

    /// A bar for `count` things, on standard error and only on a terminal; `None` = it isn't known how many.
    pub(crate) fn progress(self, count: Option<u64>) -> ProgressBar {
        if self.is_json {
            return ProgressBar::hidden();
        }
        let template = match count {
            Some(_) => "{bar:30} {pos}/{len} {msg} {eta} left",
            None => "{spinner} {pos} {msg}",
        };
        let bar = match count {
            Some(count) => ProgressBar::new(count),
            None => ProgressBar::new_spinner(),
        };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar
    }
}

/// One line.
pub(crate) fn print(line: &str) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{line}")
        .and_then(|()| out.flush())
        .map_err(|why| match why.kind() {
            ErrorKind::BrokenPipe => Failure::new(Kind::OutputClosed, "nobody reads the output"),
            _ => Failure::failed(format!(
                "standard output can't be written ({why}): redirect it elsewhere"
            )),
        })
}

/// A failure on standard error.
pub(crate) fn complain(failure: &Failure) {
    let word = console::style("error:").red().bold().for_stderr();
    // Nobody is left to tell if this fails.
    drop(writeln!(std::io::stderr().lock(), "{word} {failure}"));
}

pub(crate) fn ms(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

/// Columns side by side: the first to the left, the others to the right.
pub(crate) fn table(rows: &[Vec<String>]) -> Vec<String> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column));
        cells
            .map(|cell| console::measure_text_width(cell))
            .max()
            .unwrap_or(0)
    };
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let cell = |(i, text): (usize, &String)| {
        let side = match i {
            0 => console::Alignment::Left,
            _ => console::Alignment::Right,
        };
        console::pad_str(text, widths[i], side, None).into_owned()
    };
    rows.iter()
        .map(|row| {
            row.iter()
                .enumerate()
                .map(cell)
                .collect::<Vec<_>>()
                .join("  ")
                .trim_end()
                .to_owned()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::table;

    #[test]
    fn columns_are_as_wide_as_their_widest_cell() {
        let row = |cells: [&str; 3]| cells.map(str::to_owned).to_vec();
        let lines = table(&[row(["camera", "Hz", "ms"]), row(["a", "29.97", "7"])]);
        assert_eq!(lines, ["camera     Hz  ms", "a       29.97   7"]);
    }
}
