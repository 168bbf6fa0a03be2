//! Pictures as SVG: lines of points, one panel beside the other.

use anyhow::{Context, Result};
use plotters::chart::ChartContext;
use plotters::coord::Shift;
use plotters::coord::ranged1d::{Ranged, ValueFormatter};
use plotters::prelude::{
    BLACK, Cartesian2d, ChartBuilder, Circle, Color, DrawingArea, IntoDrawingArea, IntoLogRange, LineSeries,
    PathElement, RGBColor, SVGBackend, SeriesLabelPosition, WHITE,
};

const PANEL_PX: (u32, u32) = (640, 420);
/// Colours that people with colour blindness tell apart (Okabe and Ito).
const COLORS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
];

/// Points that belong together, in order; a single one is drawn as a point.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Line {
    pub(crate) name: String,
    pub(crate) points: Vec<(f64, f64)>,
}

/// What a panel says around its points.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Axes {
    pub(crate) caption: &'static str,
    pub(crate) x: &'static str,
    pub(crate) y: &'static str,
    pub(crate) logarithmic_x: bool,
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// All panels in one picture.
///
/// # Errors
/// If it can't be drawn.
pub(crate) fn svg(panels: &[(Axes, Vec<Line>)]) -> Result<String> {
    let mut text = String::new();
    {
        let count = u32::try_from(panels.len())?;
        let root = SVGBackend::with_string(&mut text, (PANEL_PX.0 * count, PANEL_PX.1)).into_drawing_area();
        root.fill(&WHITE)?;
        for (area, (axes, lines)) in root.split_evenly((1, panels.len())).iter().zip(panels) {
            panel(area, axes, lines).with_context(|| format!("can't draw {}", axes.caption))?;
        }
        root.present()?;
    }
    Ok(text)
}

fn panel(area: &Area<'_>, axes: &Axes, lines: &[Line]) -> Result<()> {
    let (x, y) = (bounds(lines, |point| point.0), bounds(lines, |point| point.1));
    let margin = 0.06 * (y.1 - y.0).max(1.0);
    let y = y.0 - margin..y.1 + margin;
    let mut builder = ChartBuilder::on(area);
    builder
        .caption(axes.caption, ("sans-serif", 16))
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(48);
    if axes.logarithmic_x {
        let x = (x.0 / 1.3..x.1 * 1.3).log_scale();
        draw(&mut builder.build_cartesian_2d(x, y)?, axes, lines)
    } else {
        let margin = 0.04 * (x.1 - x.0).max(1.0);
        draw(
            &mut builder.build_cartesian_2d(x.0 - margin..x.1 + margin, y)?,
            axes,
            lines,
        )
    }
}

/// Least and greatest of one coordinate.
fn bounds(lines: &[Line], coordinate: impl Fn(&(f64, f64)) -> f64) -> (f64, f64) {
    let values = lines.iter().flat_map(|line| &line.points).map(coordinate);
    let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    if low <= high { (low, high) } else { (0.0, 1.0) }
}

fn draw<'a, X, Y>(
    chart: &mut ChartContext<'a, SVGBackend<'a>, Cartesian2d<X, Y>>,
    axes: &Axes,
    lines: &[Line],
) -> Result<()>
where
    X: Ranged<ValueType = f64> + ValueFormatter<f64>,
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    let failed = |error: &dyn std::fmt::Display| anyhow::anyhow!("{error}");
    chart
        .configure_mesh()
        .x_desc(axes.x)
        .y_desc(axes.y)
        .x_labels(8)
        .y_labels(8)
        .light_line_style(WHITE)
        .draw()
        .map_err(|error| failed(&error))?;
    for (line, color) in lines.iter().zip(COLORS.iter().cycle()) {
        chart
            .draw_series(LineSeries::new(
                line.points.iter().copied(),
                color.stroke_width(2),
            ))
            .map_err(|error| failed(&error))?
            .label(&line.name)
            .legend(|(x, y)| PathElement::new([(x, y), (x + 16, y)], color.stroke_width(3)));
        let circles = line
            .points
            .iter()
            .map(|&point| Circle::new(point, 4, color.filled()));
        chart.draw_series(circles).map_err(|error| failed(&error))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerLeft)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .draw()
        .map_err(|error| failed(&error))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{Axes, Line, svg};

    #[test]
    fn the_picture_is_svg_that_names_every_line_and_axis() {
        let line = |name: &str, points: &[(f64, f64)]| Line {
            name: name.to_owned(),
            points: points.to_vec(),
        };
        let lines = vec![
            line("default", &[(1.0, 80.0), (9.0, 93.0)]),
            line("SGBM", &[(110.0, 82.6)]),
        ];
        let axes = |logarithmic_x| Axes {
            caption: "a caption",
            x: "milliseconds",
            y: "percent",
            logarithmic_x,
        };
        let text = svg(&[(axes(true), lines.clone()), (axes(false), lines)]).expect("a picture");
        assert!(text.starts_with("<svg") && text.trim_end().ends_with("</svg>"));
        for word in ["default", "SGBM", "a caption", "milliseconds", "percent"] {
            assert!(text.contains(word), "{word}");
        }
    }

    #[test]
    fn no_points_are_an_empty_picture() {
        let axes = Axes {
            caption: "nothing",
            x: "x",
            y: "y",
            logarithmic_x: true,
        };
        assert!(svg(&[(axes, Vec::new())]).is_ok());
    }
}
