//! `cargo eval foveation`: time until a region is done, against its area, and what it has over the rest then.

use std::fmt::Write as _;

use anyhow::Result;
use stereo::{Density, Focus, Params, Preset, Roi};
use stereo_tests::matching::{Bench, Matched};
use stereo_tests::score::share_within;

use crate::chart::{self, Axes, Line};
use crate::method::{Method, Views, ladder_length, preset_name};
use crate::source::{DISPARITIES, Document, KITTI, MIDDLEBURY, Source};
use crate::table::median;

/// Shares of the image that the region has.
const AREAS: [f64; 8] = [0.01, 0.03, 0.06, 0.12, 0.25, 0.5, 0.75, 1.0];
const ROUNDS: u32 = 4;
const BOUND_PX: f32 = 3.0;

pub(crate) fn run(source: &Source) -> Result<()> {
    let mut text = String::from(
        "One region in the middle of the image, of the image's proportions. Within 3 px of the truth, in %, every pixel, after the first \
         rung, when the region is done, and after the whole ladder; times are medians over the scenes.\n\n\
         | data set | preset | area, % | first rung, ms | region done, ms | of the whole ladder's time, % | region: first / done / whole | \
         rest then | whole ladder with the region, ms | without, ms |\n|---|---|---|---|---|---|---|---|---|---|\n",
    );
    let (mut times, mut shares) = (Vec::new(), Vec::new());
    for (set, name) in [(KITTI, "KITTI 2012"), (MIDDLEBURY, "Middlebury")] {
        let scenes = source.views(set)?;
        for preset in [Preset::Default, Preset::Fast] {
            let rows = AREAS
                .iter()
                .map(|area| Row::measure(preset, *area, &scenes))
                .collect::<Result<Vec<_>>>()?;
            for row in &rows {
                writeln!(
                    text,
                    "| {} | {} | {:.0} | {:.2} | {:.2} | {:.0} | {:.1} / {:.1} / {:.1} | {} | {:.2} | {:.2} |",
                    set.title,
                    preset_name(preset),
                    100.0 * row.area,
                    row.first_ms,
                    row.done_ms,
                    100.0 * row.done_ms / row.plain_ms,
                    row.region[0],
                    row.region[1],
                    row.region[2],
                    row.rest.map_or("-".to_owned(), |rest| format!("{rest:.1}")),
                    row.whole_ms,
                    row.plain_ms
                )?;
            }
            let preset = preset_name(preset);
            let line = |what: &str, y: &dyn Fn(&Row) -> Option<f64>| Line {
                name: format!("{name}, {preset}{what}"),
                points: rows
                    .iter()
                    .filter_map(|row| Some((100.0 * row.area, y(row)?)))
                    .collect(),
            };
            times.push(line("", &|row| Some(100.0 * row.done_ms / row.plain_ms)));
            if preset == "default" {
                shares.push(line(", region", &|row| Some(row.region[1])));
                shares.push(line(", rest", &|row| row.rest));
            }
        }
    }
    let axes = |caption, y| Axes {
        caption,
        x: "area of the region, % of the image",
        y,
        logarithmic_x: false,
    };
    let panels = [
        (
            axes("Time until the region is done", "% of the whole ladder's time"),
            times,
        ),
        (axes("What is right then", "within 3 px, %"), shares),
    ];
    source.publish_picture("foveation.svg", &chart::svg(&panels)?)?;
    source.publish(Document::Figures, "foveation", &text)
}

/// Figures of one area.
struct Row {
    area: f64,
    first_ms: f64,
    done_ms: f64,
    /// The whole ladder with the region, and without.
    whole_ms: f64,
    plain_ms: f64,
    /// What is right in the region after the first rung, when it is done and after the whole ladder; in the rest when it is done.
    region: [f64; 3],
    rest: Option<f64>,
}

impl Row {
    fn measure(preset: Preset, area: f64, scenes: &[Views]) -> Result<Self> {
        let mut times = [const { Vec::new() }; 4];
        let (mut region, mut rest) = ([0.0; 3], 0.0);
        for views in scenes {
            let (left, _) = &views.served;
            let (width, height) = (left.width_px(), left.height_px());
            let middle = middle(width, height, area);
            let plain = Method::new(preset, ladder_length(preset))
                .dense()
                .params(DISPARITIES);
            let with = Params {
                focus: vec![Focus {
                    region: middle,
                    weight: 1.0,
                }],
                density: Density::Dense,
                ..plain.clone()
            };
            let runs = fastest([(&with, 1), (&with, 2), (&with, 8), (&plain, 8)], views)?;
            for (times, run) in times.iter_mut().zip(&runs) {
                times.push(1e3 * run.elapsed.as_secs_f64());
            }
            let is_inside = |at: usize| {
                (middle.x..middle.x + middle.width).contains(&(at % width))
                    && (middle.y..middle.y + middle.height).contains(&(at / width))
            };
            let inside: Vec<bool> = (0..width * height).map(is_inside).collect();
            let outside: Vec<bool> = inside.iter().map(|inside| !inside).collect();
            let right = |run: &Matched, chosen: &[bool]| {
                share_within(
                    &run.disparity_px,
                    &views.scored.truth.disparity_px,
                    chosen,
                    BOUND_PX,
                )
            };
            for (sum, run) in region.iter_mut().zip(&runs) {
                *sum += right(run, &inside);
            }
            rest += right(&runs[1], &outside);
        }
        let mean = |sum: f64| sum / scenes.len() as f64;
        let [first_ms, done_ms, whole_ms, plain_ms] = times.map(median);
        Ok(Self {
            area,
            first_ms,
            done_ms,
            whole_ms,
            plain_ms,
            region: region.map(mean),
            rest: (area < 1.0).then_some(mean(rest)),
        })
    }
}

/// The fastest run of each of these parameters, up to so many rungs, in turns.
fn fastest(methods: [(&Params, u8); 4], views: &Views) -> Result<[Matched; 4]> {
    let (left, right) = &views.served;
    let mut benches = methods.map(|(params, rungs)| (Bench::new(left, params.clone()), rungs, None));
    for _ in 0..ROUNDS {
        for (bench, rungs, best) in &mut benches {
            let bench = bench.as_mut().map_err(|why| anyhow::anyhow!("{why}"))?;
            for _ in 0..2 {
                let run = bench.run(left, right, *rungs)?;
                if best
                    .as_ref()
                    .is_none_or(|best: &Matched| run.elapsed < best.elapsed)
                {
                    *best = Some(run);
                }
            }
        }
    }
    Ok(benches.map(|(_, _, best)| best.expect("there is a round at least")))
}

/// A rectangle in the middle, of the image's proportions, with this share of its area.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a part of the image"
)]
fn middle(width: usize, height: usize, area: f64) -> Roi {
    let part = |side: usize| ((side as f64 * area.sqrt()).round() as usize).clamp(1, side);
    let (w, h) = (part(width), part(height));
    Roi {
        x: (width - w) / 2,
        y: (height - h) / 2,
        width: w,
        height: h,
    }
}

#[cfg(test)]
mod tests {
    use super::middle;

    #[test]
    fn a_quarter_of_the_area_is_half_of_each_side() {
        let roi = middle(640, 480, 0.25);
        assert_eq!((roi.x, roi.y, roi.width, roi.height), (160, 120, 320, 240));
        let whole = middle(641, 33, 1.0);
        assert_eq!((whole.x, whole.y, whole.width, whole.height), (0, 0, 641, 33));
    }
}
