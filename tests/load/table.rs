//! The suite's table.

use std::fmt::Write as _;
use std::time::Duration;

use crate::args::Part;
use crate::figures::{Figures, quantile};
use crate::scenario::OWN_POLICY;

/// One load with one policy.
pub(crate) struct Row {
    /// The load.
    pub(crate) name: String,
    /// The server's policy.
    pub(crate) policy: String,
    /// What was measured.
    pub(crate) figures: Figures,
    /// The server's largest memory.
    pub(crate) memory_peak_bytes: Option<u64>,
    /// What only this kind of load shows.
    pub(crate) further: Further,
}

/// What only one kind of load shows.
pub(crate) enum Further {
    /// A steady load, and its multiple of the capacity.
    Load {
        /// The multiple.
        factor: f64,
    },
    /// A burst.
    Burst {
        /// From its end until a second begins that is good again; `None` = not seen.
        recovery: Option<Duration>,
        /// Share in budget by time.
        timeline: Vec<(f64, f64)>,
    },
    /// Several clients.
    Clients {
        /// What the others lost to the one that floods, as a share of their frames.
        lost: Option<f64>,
        /// Jain's index.
        fairness: f64,
    },
    /// Nothing more.
    Nothing,
}

/// All rows, and what they were measured on.
pub(crate) struct Table {
    /// The rows in order.
    pub(crate) rows: Vec<Row>,
    /// Capacity at full quality before the rows, in frames a second.
    pub(crate) capacity_hz: f64,
    /// The same after them.
    pub(crate) capacity_after_hz: f64,
    /// Commit, processor, SIMD level.
    pub(crate) machine: String,
    /// Who ran on which cores.
    pub(crate) cores: String,
    /// What else the machine was doing before.
    pub(crate) load_average: Option<f64>,
    /// When it was begun.
    pub(crate) started: jiff::Timestamp,
}

/// What the columns mean.
pub(crate) const LEGEND: &str = "In budget: the whole result was there within the budget, counted from the moment the frame was due, whether or not it \
could be sent then; in brackets what is certain with 99 % confidence (MLPerf's early-stopping rule). Once sent: the same from when it was sent, \
without the delays of the generator's own timer; what they leave of a budget is what is asked of the server. By the server's clock: from the \
request's head to the writing of the answer. Admitted misses: late by the server's clock or expired, of those answered or expired. \
Decided: from sending a frame to the beginning of its refusal. Rungs: mean share of the ladder. Memory: the server's peak. Further, \
of a steady load: in budget and rungs of each budget, %.\n";

const HEAD: &str = "| load | policy | offered /s | in budget, % of offered (certain) | once sent, % | by the server's clock, % | goodput /s | \
of its peak, % | admitted misses, % | refused, % | decided p99, ms | rungs, % | prediction error p95, % | sent late p99, ms | \
memory, MB | further |\n|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n";

impl Table {
    /// When it was begun, for the names of files: to the second, and without the colons that some file systems refuse.
    pub(crate) fn file_time(&self) -> String {
        self.started.strftime("%Y-%m-%dT%H%M%SZ").to_string()
    }

    /// The table as Markdown, with a line on how it was measured.
    pub(crate) fn markdown(&self, part: Part) -> String {
        let busy = self.load_average.map_or_else(String::new, |load| {
            format!(", load average {load:.1} before the start")
        });
        let title = match part {
            Part::Steady => "Steady load, raw VGA pairs, budgets 10, 20, 50 and 100 ms",
            Part::Burst => "A burst of the same",
            Part::Clients => "The same from five clients, one of which floods",
            Part::Png => "PNG pairs, budgets 20, 50, 100 and 200 ms",
            Part::Large => "4-megapixel pairs",
        };
        let mut text = format!(
            "**{title}.** C = {:.1} frames a second at full quality, closed-loop ({:.1} after the runs). {}, {}; {}{busy}.\n\n{HEAD}",
            self.capacity_hz,
            self.capacity_after_hz,
            self.started.strftime("%Y-%m-%d %H:%M UTC"),
            self.machine,
            self.cores
        );
        for row in &self.rows {
            self.row(&mut text, row);
        }
        text
    }

    fn row(&self, text: &mut String, row: &Row) {
        let figures = &row.figures;
        let percent = |share: f64| format!("{:.1}", 100.0 * share);
        let ms = |time: Duration| format!("{:.1}", time.as_secs_f64() * 1e3);
        let none = || "-".to_owned();
        let cells = [
            row.name.clone(),
            row.policy.clone(),
            format!("{:.1}", figures.offered_hz),
            format!(
                "{} ({})",
                percent(figures.attainment()),
                percent(figures.proven_attainment())
            ),
            percent(figures.attainment_from_sending()),
            percent(figures.attainment_by_the_server()),
            format!("{:.1}", figures.goodput_hz),
            self.of_peak(row).map_or_else(none, percent),
            percent(figures.admitted_misses()),
            percent(figures.refused_share()),
            if figures.refusing.is_empty() {
                none()
            } else {
                ms(quantile(&figures.refusing, 0.99))
            },
            percent(figures.rungs),
            figures.prediction_error.map_or_else(none, percent),
            ms(quantile(&figures.lag, 0.99)),
            row.memory_peak_bytes
                .map_or_else(none, |bytes| format!("{:.0}", bytes as f64 / 1e6)),
            further(row),
        ];
        writeln!(text, "| {} |", cells.join(" | ")).expect("a String takes everything");
    }

    /// Goodput of a steady load relative to the most that its policy has reached at any.
    fn of_peak(&self, row: &Row) -> Option<f64> {
        let is_steady = |row: &&Row| matches!(row.further, Further::Load { .. });
        let peak = self
            .rows
            .iter()
            .filter(|other| other.policy == row.policy)
            .filter(is_steady)
            .map(|other| other.figures.goodput_hz)
            .fold(0.0, f64::max);
        is_steady(&row).then(|| row.figures.goodput_hz / peak.max(1e-9))
    }
}

/// The last cell: what only this kind of load shows, and everything that is not as it should be.
fn further(row: &Row) -> String {
    let figures = &row.figures;
    let mut notes = Vec::new();
    match &row.further {
        Further::Burst { recovery, .. } => notes.push(match recovery {
            Some(time) => format!("recovered after {:.2} s", time.as_secs_f64()),
            None => "not recovered".to_owned(),
        }),
        Further::Clients { lost, fairness } => {
            notes.push(format!("Jain {fairness:.3}"));
            if let Some(lost) = lost {
                notes.push(format!("the others lost {:.1} points", 100.0 * lost));
            }
        }
        Further::Load { .. } if row.policy == OWN_POLICY => notes.push(by_budget(figures)),
        Further::Load { .. } | Further::Nothing => {}
    }
    if figures.mute > 0 {
        notes.push(format!(
            "{} infeasible without a time that is feasible",
            figures.mute
        ));
    }
    if figures.not_sent > 0 {
        notes.push(format!("{} not sent", figures.not_sent));
    }
    for (why, count) in &figures.broken {
        notes.push(format!("{count} without an answer ({})", why.replace('|', "/")));
    }
    notes.join("; ")
}

/// In budget and rungs of each budget, in per cent.
fn by_budget(figures: &Figures) -> String {
    let parts = figures.by_budget.iter().map(|(budget, part)| {
        format!(
            "{:.0} ms: {:.1} / {:.0}",
            budget.as_secs_f64() * 1e3,
            100.0 * part.share(),
            100.0 * part.mean_rungs()
        )
    });
    parts.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
pub(crate) mod tests {
    use std::time::Duration;

    use super::{Further, Row, Table};
    use crate::args::Part;
    use crate::figures::Figures;
    use crate::generator::Run;
    use crate::plan::Shot;
    use crate::record::{Outcome, Record};

    /// A table with one steady load of each of two policies and a burst.
    pub(crate) fn sample() -> Table {
        let run = || Run {
            records: vec![Record {
                shot: Shot {
                    at: Duration::ZERO,
                    camera: 0,
                    budget: Duration::from_millis(50),
                },
                lag: Duration::ZERO,
                latency: Duration::from_millis(3),
                decided: Duration::from_millis(3),
                outcome: Outcome::Broken("cut|off".to_owned()),
            }],
            length: Duration::from_secs(1),
        };
        let row = |policy: &str, further| Row {
            name: "1.0 C".to_owned(),
            policy: policy.to_owned(),
            figures: Figures::of(&run()),
            memory_peak_bytes: Some(50_000_000),
            further,
        };
        let burst = Further::Burst {
            recovery: Some(Duration::from_millis(250)),
            timeline: vec![(0.0, 1.0), (0.5, 0.5)],
        };
        Table {
            rows: vec![
                row("edf", Further::Load { factor: 1.0 }),
                row("fifo", Further::Load { factor: 1.0 }),
                row("edf", burst),
            ],
            capacity_hz: 100.0,
            capacity_after_hz: 99.0,
            machine: "a machine".to_owned(),
            cores: "apart".to_owned(),
            load_average: Some(0.5),
            started: jiff::Timestamp::UNIX_EPOCH,
        }
    }

    #[test]
    fn every_row_has_as_many_cells_as_the_head() {
        let text = sample().markdown(Part::Steady);
        let widths: Vec<usize> = text
            .lines()
            .filter(|line| line.starts_with('|'))
            .map(|line| line.matches('|').count())
            .collect();
        assert_eq!(widths.len(), 5);
        assert!(widths.windows(2).all(|pair| pair[0] == pair[1]), "{text}");
        assert!(text.contains("recovered after 0.25 s"), "{text}");
        assert!(text.contains("1 without an answer (cut/off)"), "{text}");
    }
}
