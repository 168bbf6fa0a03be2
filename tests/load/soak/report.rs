//! A run as CSV, as a picture and as a table.

use std::fmt::Write as _;

use anyhow::{Context, Result};
use plotters::prelude::{
    BLACK, ChartBuilder, Color, IntoDrawingArea, LineSeries, RGBColor, Rectangle, SVGBackend, WHITE,
};

use super::sample::Sample;
use super::verdict::Verdict;

const HEAD: &str = "time,machine,seconds,resident_bytes,descriptors,threads,tasks,in_flight_bytes,offered,in_budget,batched,filmed,\
refused_as_bad,broken,camera_frames,camera_answers";
const PANEL_PX: (u32, u32) = (400, 240);
const LINE: RGBColor = RGBColor(0, 114, 178);

/// A run that began at `time`.
pub(super) struct Report<'a> {
    pub(super) time: &'a str,
    pub(super) machine: &'a str,
    pub(super) samples: &'a [Sample],
    pub(super) verdict: &'a Verdict,
}

impl Report<'_> {
    /// Every look at the server, one a line.
    pub(super) fn csv(&self) -> String {
        let mut text = format!("{HEAD}\n");
        for sample in self.samples {
            let counts = sample.counts;
            write!(text, "{},\"{}\",{:.3}", self.time, self.machine, sample.seconds)
                .expect("a String takes everything");
            for number in [
                sample.resident_bytes,
                sample.descriptors,
                sample.threads,
                sample.tasks,
                sample.in_flight_bytes,
                counts.offered,
                counts.in_budget,
                counts.batched,
                counts.filmed,
                counts.refused_as_bad,
                counts.broken,
                sample.camera_frames,
                sample.camera_answers,
            ] {
                write!(text, ",{number}").expect("a String takes everything");
            }
            text.push('\n');
        }
        text
    }

    /// What grew, in a table, and what the load was.
    pub(super) fn markdown(&self) -> String {
        let Verdict {
            warm_up,
            length,
            lines,
            attainment,
            failures,
        } = self.verdict;
        let minutes = |seconds: f64| format!("{:.1}", seconds / 60.0);
        let mut text = format!(
            "| {} minutes after a warm-up of {} | first third | last third | growth by the slope | allowed |\n|---|---|---|---|---|",
            minutes(*length),
            minutes(*warm_up)
        );
        for line in lines {
            let cell = |value: f64| format!("{:.1}{}", value / line.divisor, line.unit);
            let cells = [line.first, line.last, line.growth, line.limit]
                .map(cell)
                .join(" | ");
            write!(text, "\n| {}, median | {cells} |", line.name).expect("a String takes everything");
        }
        let [first, last, _] = attainment.map(|share| format!("{:.2} %", 100.0 * share));
        write!(
            text,
            "\n| frames in budget, of those offered | {first} | {last} | - | - |"
        )
        .expect("a String takes everything");
        let counts = self
            .samples
            .last()
            .map(|sample| sample.counts)
            .unwrap_or_default();
        let verdict = match failures.is_empty() {
            true => "Nothing grew".to_owned(),
            false => format!("**Failed: {}**", failures.join("; ")),
        };
        write!(
            text,
            "\n\n{verdict}. Sent: {} single pairs over HTTP and Zenoh, {} pairs in batches, {} frames of cameras, {} bodies that are none; {} \
             answers missing or wrong. {}, {}.",
            counts.offered, counts.batched, counts.filmed, counts.refused_as_bad, counts.broken, self.time, self.machine
        )
        .expect("a String takes everything");
        text
    }

    /// The run as SVG: what must not grow, and what must not fall.
    pub(super) fn picture(&self) -> Result<String> {
        let line = |value: &dyn Fn(&Sample) -> f64| -> Vec<(f64, f64)> {
            let points = self.samples.iter();
            points
                .map(|sample| (sample.seconds / 60.0, value(sample)))
                .collect()
        };
        let in_budget = self.samples.windows(2).map(|pair| {
            let ((offered_before, kept_before), (offered, kept)) = (pair[0].deadlines(), pair[1].deadlines());
            let share = (kept - kept_before) as f64 / (offered - offered_before).max(1) as f64;
            (pair[1].seconds / 60.0, 100.0 * share)
        });
        let panels = [
            (
                "resident memory, MB",
                line(&|sample| sample.resident_bytes as f64 / 1e6),
            ),
            ("descriptors", line(&|sample| sample.descriptors as f64)),
            (
                "threads and tasks",
                line(&|sample| (sample.threads + sample.tasks) as f64),
            ),
            ("frames in budget, %", in_budget.collect()),
        ];
        let mut text = String::new();
        {
            let root =
                SVGBackend::with_string(&mut text, (2 * PANEL_PX.0, 2 * PANEL_PX.1)).into_drawing_area();
            root.fill(&WHITE)?;
            for (area, (caption, points)) in root.split_evenly((2, 2)).iter().zip(&panels) {
                let most = |axis: fn(&(f64, f64)) -> f64| points.iter().map(axis).fold(1e-9, f64::max);
                let (right, top) = (most(|point| point.0), 1.05 * most(|point| point.1));
                let mut chart = ChartBuilder::on(area)
                    .caption(caption, ("sans-serif", 15))
                    .margin(8)
                    .x_label_area_size(32)
                    .y_label_area_size(44)
                    .build_cartesian_2d(0.0..right, 0.0..top)
                    .context("can't lay out the chart")?;
                chart
                    .configure_mesh()
                    .x_desc("minutes")
                    .x_labels(6)
                    .light_line_style(WHITE)
                    .draw()?;
                // The warm-up, which doesn't count.
                let warm_up = [(0.0, 0.0), (self.verdict.warm_up / 60.0, top)];
                chart.draw_series([Rectangle::new(warm_up, BLACK.mix(0.06).filled())])?;
                chart.draw_series(LineSeries::new(points.iter().copied(), LINE.stroke_width(2)))?;
            }
            root.present()?;
        }
        Ok(text)
    }
}

#[cfg(test)]
mod tests {
    use super::super::verdict::judge;
    use super::*;

    #[test]
    fn a_run_is_told_in_csv_in_a_table_and_in_a_picture() {
        let samples: Vec<Sample> = (0..60_u32)
            .map(|look| Sample {
                seconds: 5.0 * f64::from(look),
                resident_bytes: 100_000_000,
                camera_frames: 100 * u64::from(look),
                camera_answers: 100 * u64::from(look),
                ..Sample::default()
            })
            .collect();
        let report = Report {
            time: "now",
            machine: "here",
            samples: &samples,
            verdict: &judge(&samples).expect("long enough"),
        };
        let csv = report.csv();
        assert_eq!(csv.lines().count(), 61);
        assert!(
            csv.lines()
                .all(|line| line.split(',').count() == HEAD.split(',').count())
        );
        let table = report.markdown();
        assert!(
            table.contains("| resident memory, median | 100.0 MB | 100.0 MB | 0.0 MB |"),
            "{table}"
        );
        assert!(
            table.contains("| 100.00 % | 100.00 % |") && table.contains("Nothing grew"),
            "{table}"
        );
        let picture = report.picture().expect("it can be drawn");
        assert!(picture.starts_with("<svg") && picture.contains("resident memory, MB"));
    }
}
