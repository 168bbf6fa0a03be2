//! `cargo eval confidence`: what `min_confidence` gives and takes, as a table and as a picture.

use std::fmt::Write as _;

use anyhow::Result;
use stereo::Preset;
use stereo_tests::score::{Accuracy, mean};

use crate::chart::{self, Axes, Line};
use crate::contest::{Turns, compete};
use crate::method::{Contestant, Method, ladder_length};
use crate::source::{DISPARITIES, Document, KITTI, MIDDLEBURY, Source};

const LEAST: [f32; 11] = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95];

pub(crate) fn run(source: &Source) -> Result<()> {
    let methods = [
        Method::new(Preset::Default, ladder_length(Preset::Default)),
        Method::new(Preset::Default, 2),
        Method::new(Preset::Fast, ladder_length(Preset::Fast)),
    ];
    let mut text = String::from(
        "Over the high-gradient pixels, in %: density / returned <3 px / all <3 px of what is kept.\n",
    );
    let mut panels = Vec::new();
    for (set, caption) in [(KITTI, "KITTI 2012"), (MIDDLEBURY, "Middlebury")] {
        let scenes = source.views(set)?;
        let mut contestants: Vec<Contestant> = methods
            .iter()
            .flat_map(|method| LEAST.map(|least| Contestant::ours(method.confident(least))))
            .collect();
        contestants.extend(source.peers(&["sgbm", "3way"])?);
        let rows = compete(&mut contestants, &scenes, |_| Ok(DISPARITIES), Turns::ONCE)?;
        let edges: Vec<Accuracy> = rows.iter().map(|row| mean(&row.scores).edges).collect();
        let (ours, peers) = edges.split_at(methods.len() * LEAST.len());
        let curves: Vec<&[Accuracy]> = ours.chunks(LEAST.len()).collect();

        write!(
            text,
            "\n{}, {} scenes\n\n| least confidence |",
            set.title,
            scenes.len()
        )?;
        for method in &methods {
            write!(text, " {} |", method.short_name())?;
        }
        text.push_str("\n|---|");
        text.push_str(&"---|".repeat(methods.len()));
        text.push('\n');
        for (i, least) in LEAST.iter().enumerate() {
            write!(text, "| {least} |")?;
            for curve in &curves {
                write!(text, " {} |", three(&curve[i]))?;
            }
            text.push('\n');
        }
        let peer_rows = &rows[ours.len()..];
        for (row, edges) in peer_rows.iter().zip(peers) {
            writeln!(
                text,
                "| {} | {} |{}",
                row.name,
                three(edges),
                " |".repeat(methods.len() - 1)
            )?;
        }

        let point = |edges: &Accuracy| (edges.density, edges.returned[1]);
        let mut lines: Vec<Line> = methods
            .iter()
            .zip(&curves)
            .map(|(method, curve)| Line {
                name: method.short_name(),
                // Where most pixels are gone, nobody looks.
                points: curve
                    .iter()
                    .filter(|edges| edges.density > 50.0)
                    .map(point)
                    .collect(),
            })
            .collect();
        lines.extend(peer_rows.iter().zip(peers).map(|(row, edges)| Line {
            name: row.name.clone(),
            points: vec![point(edges)],
        }));
        let axes = Axes {
            caption,
            x: "density, % of the high-gradient pixels",
            y: "returned <3 px, %",
            logarithmic_x: false,
        };
        panels.push((axes, lines));
    }
    source.publish_picture("min_confidence.svg", &chart::svg(&panels)?)?;
    source.publish(Document::Figures, "confidence", &text)
}

fn three(edges: &Accuracy) -> String {
    format!(
        "{:.1} / {:.1} / {:.1}",
        edges.density, edges.returned[1], edges.all[1]
    )
}
