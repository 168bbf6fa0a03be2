//! The table: one row a method, means over the scenes.

use std::fmt::Write;

use anyhow::Result;
use serde_json::{Map, Value, json};
use stereo_tests::machine;
use stereo_tests::score::{Accuracy, BOUNDS_PX, Score, mean};

/// All figures of one method.
pub(crate) struct Row {
    /// The method's name.
    pub(crate) name: String,
    /// One score a scene.
    pub(crate) scores: Vec<Score>,
    /// Matching and wall time of each scene in ms.
    pub(crate) times_ms: Vec<(f64, f64)>,
}

impl Row {
    pub(crate) fn new(name: String) -> Self {
        Self {
            name,
            scores: Vec::new(),
            times_ms: Vec::new(),
        }
    }

    pub(crate) fn match_ms(&self) -> f64 {
        median(self.times_ms.iter().map(|t| t.0).collect())
    }

    fn wall_ms(&self) -> f64 {
        median(self.times_ms.iter().map(|t| t.1).collect())
    }
}

/// All rows, and what they were measured on.
pub(crate) struct Table {
    /// Number of scenes.
    pub(crate) scenes: usize,
    /// The methods in order.
    pub(crate) rows: Vec<Row>,
}

impl Table {
    /// The time of OpenCV's SGBM, if it took part.
    pub(crate) fn sgbm_ms(&self) -> Option<f64> {
        let sgbm = self.rows.iter().find(|row| row.name.ends_with(" sgbm"));
        sgbm.map(Row::match_ms)
    }

    /// The table as Markdown, with a last column of speed relative to OpenCV's SGBM if that took part.
    pub(crate) fn markdown(&self) -> String {
        let sgbm_ms = self.sgbm_ms();
        let mut text = format!("{} scenes\n\n", self.scenes);
        text.push_str(
            "| method | match ms | wall ms | density | returned <2/<3/<4/<5 px | all <3 px | dense: density | \
             returned <3 | all <3 | D1-all |",
        );
        text.push_str(if sgbm_ms.is_some() { " x SGBM |\n" } else { "\n" });
        text.push_str("|---|---|---|---|---|---|---|---|---|---|");
        text.push_str(if sgbm_ms.is_some() { "---|\n" } else { "\n" });
        for row in &self.rows {
            let Score { edges, dense } = mean(&row.scores);
            let returned = edges.returned.map(|share| format!("{share:.1}")).join(" / ");
            let mut line = format!(
                "| {} | {:.2} | {:.2} | {:.1} | {returned} | {:.1} | {:.1} | {:.1} | {:.1} | {:.1} |",
                row.name,
                row.match_ms(),
                row.wall_ms(),
                edges.density,
                edges.all[1],
                dense.density,
                dense.returned[1],
                dense.all[1],
                dense.d1
            );
            if let Some(sgbm_ms) = sgbm_ms {
                write!(line, " {:.1} |", sgbm_ms / row.match_ms()).expect("a String takes everything");
            }
            text.push_str(&line);
            text.push('\n');
        }
        text
    }

    /// All figures as JSON, by method.
    pub(crate) fn json(&self) -> Result<String> {
        let mut methods = Map::new();
        for row in &self.rows {
            let score = mean(&row.scores);
            let mut figures = Map::new();
            for (label, part) in [("hg", score.edges), ("dense", score.dense)] {
                add_figures(&mut figures, label, &part);
            }
            figures.insert("match_ms".to_owned(), json!(row.match_ms()));
            figures.insert("wall_ms".to_owned(), json!(row.wall_ms()));
            methods.insert(row.name.clone(), Value::Object(figures));
        }
        let all = json!({ "scenes": self.scenes, "machine": machine::describe(), "methods": methods });
        Ok(serde_json::to_string_pretty(&all)?)
    }
}

fn add_figures(figures: &mut Map<String, Value>, label: &str, part: &Accuracy) {
    figures.insert(format!("{label}_density"), json!(part.density));
    for ((bound, returned), all) in BOUNDS_PX.iter().zip(part.returned).zip(part.all) {
        figures.insert(format!("{label}_ret{bound}"), json!(returned));
        figures.insert(format!("{label}_all{bound}"), json!(all));
    }
    figures.insert(format!("{label}_d1"), json!(part.d1));
}

pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let half = values.len() / 2;
    match values.len() {
        0 => 0.0,
        n if n % 2 == 1 => values[half],
        _ => f64::midpoint(values[half - 1], values[half]),
    }
}

#[cfg(test)]
mod tests {
    use super::{Row, Table, median};
    use stereo_tests::score::Score;

    #[test]
    fn the_median_of_an_even_number_is_the_middle_ones_mean() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(vec![4.0, 1.0, 2.0, 9.0]), 3.0);
        assert_eq!(median(vec![]), 0.0);
    }

    #[test]
    fn speed_is_given_relative_to_sgbm_when_it_took_part() {
        let row = |name: &str, ms| Row {
            name: name.to_owned(),
            scores: vec![Score::default()],
            times_ms: vec![(ms, ms)],
        };
        let mut table = Table {
            scenes: 1,
            rows: vec![
                row("stereod default 1 it semi_dense", 5.0),
                row("OpenCV 5.0.0 sgbm", 150.0),
            ],
        };
        assert!(table.markdown().contains("| x SGBM |"));
        assert!(table.markdown().contains(" 30.0 |"));
        table.rows.pop();
        assert!(!table.markdown().contains("SGBM"));
    }
}
