//! The suite's picture: what every policy makes of rising load, and of a burst.

use anyhow::{Context, Result};
use plotters::coord::Shift;
use plotters::prelude::{
    BLACK, ChartBuilder, Circle, IntoDrawingArea, LineSeries, PathElement, RGBColor, SVGBackend,
    SeriesLabelPosition, WHITE,
};
use plotters::prelude::{Color, DrawingArea};

use crate::figures::Part;
use crate::record::Record;
use crate::table::{Further, Row, Table};

const PANEL_PX: (u32, u32) = (400, 380);
/// Length of the stretches of a burst's timeline.
const STRETCH_SECONDS: f64 = 0.5;
/// Colours that people with colour blindness tell apart (Okabe and Ito).
const COLORS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
];

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Line = (String, Vec<(f64, f64)>);

/// The picture as SVG; `None` if there is nothing to draw.
///
/// # Errors
/// If it can't be drawn.
pub(crate) fn of(table: &Table) -> Result<Option<String>> {
    let steady = |value: fn(&Row) -> f64| {
        lines(table, |row| match row.further {
            Further::Load { factor } => vec![(factor, value(row))],
            _ => Vec::new(),
        })
    };
    let burst = lines(table, |row| match &row.further {
        Further::Burst { timeline, .. } => timeline.clone(),
        _ => Vec::new(),
    });
    let load = "offered, multiples of C";
    let mut panels = vec![
        (
            "in budget, % of offered",
            load,
            steady(|row| 100.0 * row.figures.attainment()),
        ),
        (
            "in budget, frames a second",
            load,
            steady(|row| row.figures.goodput_hz),
        ),
        ("in budget through a burst, %", "seconds", burst),
    ];
    panels.retain(|(_, _, lines)| lines.iter().any(|(_, line)| !line.is_empty()));
    if panels.is_empty() {
        return Ok(None);
    }
    let mut text = String::new();
    {
        let size_px = (PANEL_PX.0 * u32::try_from(panels.len())?, PANEL_PX.1);
        let root = SVGBackend::with_string(&mut text, size_px).into_drawing_area();
        root.fill(&WHITE)?;
        let areas = root.split_evenly((1, panels.len()));
        for (area, (caption, x_label, lines)) in areas.iter().zip(&panels) {
            panel(area, caption, x_label, lines)?;
        }
        root.present()?;
    }
    Ok(Some(text))
}

/// Share in budget (in %) by the time that frames were due.
pub(crate) fn timeline(records: &[Record]) -> Vec<(f64, f64)> {
    let mut parts: std::collections::BTreeMap<u64, Part> = std::collections::BTreeMap::new();
    for record in records {
        let stretch = record.shot.at.as_millis() as f64 / (1e3 * STRETCH_SECONDS);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a run has few stretches, and none before its start"
        )]
        parts.entry(stretch as u64).or_default().count(record);
    }
    let middle = |stretch: u64| (stretch as f64 + 0.5) * STRETCH_SECONDS;
    parts
        .into_iter()
        .map(|(stretch, part)| (middle(stretch), 100.0 * part.share()))
        .collect()
}

/// One line a policy.
fn lines(table: &Table, points: impl Fn(&Row) -> Vec<(f64, f64)>) -> Vec<Line> {
    let mut lines: Vec<Line> = Vec::new();
    for row in &table.rows {
        let points = points(row);
        match lines.iter_mut().find(|(policy, _)| *policy == row.policy) {
            Some((_, line)) => line.extend(points),
            None => lines.push((row.policy.clone(), points)),
        }
    }
    lines
}

fn panel(area: &Area<'_>, caption: &str, x_label: &str, lines: &[Line]) -> Result<()> {
    let top = |axis: fn(&(f64, f64)) -> f64| {
        let most = lines
            .iter()
            .flat_map(|(_, line)| line)
            .map(axis)
            .fold(0.0, f64::max);
        if most > 0.0 { most } else { 1.0 }
    };
    let mut chart = ChartBuilder::on(area)
        .caption(caption, ("sans-serif", 16))
        .margin(10)
        .x_label_area_size(36)
        .y_label_area_size(42)
        .build_cartesian_2d(0.0..top(|point| point.0) * 1.05, 0.0..top(|point| point.1) * 1.05)
        .context("can't lay out the chart")?;
    chart
        .configure_mesh()
        .x_desc(x_label)
        .x_labels(6)
        .y_labels(6)
        .light_line_style(WHITE)
        .draw()?;
    for ((policy, line), color) in lines.iter().zip(COLORS.iter().cycle()) {
        chart
            .draw_series(LineSeries::new(line.iter().copied(), color.stroke_width(2)))?
            .label(policy)
            .legend(|(x, y)| PathElement::new([(x, y), (x + 16, y)], color.stroke_width(2)));
        chart.draw_series(line.iter().map(|&point| Circle::new(point, 3, color.filled())))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerLeft)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .draw()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::of;
    use crate::table::tests::sample;

    #[test]
    fn the_picture_is_svg_that_names_every_policy() {
        let svg = of(&sample()).expect("it can be drawn").expect("a picture");
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
        assert!(svg.contains("edf") && svg.contains("fifo"));
    }
}
