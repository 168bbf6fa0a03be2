//! `cargo eval accuracy`: every preset after every rung beside OpenCV, in three data sets; the README's table and the picture
//! of accuracy over time.

use std::fmt::Write as _;

use anyhow::Result;
use stereo::Preset;
use stereo_tests::score::{Score, mean};

use crate::chart::{self, Axes, Line};
use crate::contest::{Turns, compete};
use crate::method::{Contestant, Method, ladder_length};
use crate::printed;
use crate::source::{DISPARITIES, Document, ETH3D, KITTI, MIDDLEBURY, Source};
use crate::table::{Row, Table};

/// The border of the confident subset.
const CONFIDENT: f32 = 0.5;
pub(crate) const PEERS: [&str; 3] = ["sgbm", "3way", "bm"];

/// The rungs that tables show, preset by preset.
pub(crate) fn methods() -> Vec<Method> {
    let whole = |preset| (1..=ladder_length(preset)).map(move |rungs| Method::new(preset, rungs));
    let paper = [1, 2, 4].map(|rungs| Method::new(Preset::Paper, rungs));
    whole(Preset::Fast)
        .chain(whole(Preset::Default))
        .chain(paper)
        .collect()
}

pub(crate) fn run(source: &Source) -> Result<()> {
    for (set, name) in [
        (KITTI, "accuracy-kitti"),
        (MIDDLEBURY, "accuracy-middlebury"),
        (ETH3D, "accuracy-eth3d"),
    ] {
        let scenes = source.views(set)?;
        let mut contestants: Vec<Contestant> = methods()
            .into_iter()
            .flat_map(|method| [method, method.dense()])
            .chain(confident())
            .map(Contestant::ours)
            .collect();
        contestants.extend(source.peers(&PEERS)?);
        let rows = compete(&mut contestants, &scenes, |_| Ok(DISPARITIES), Turns::TIMED)?;
        let table = Table {
            scenes: scenes.len(),
            rows,
        };
        source.publish(
            Document::Figures,
            name,
            &format!("{}: {}", set.title, table.markdown()),
        )?;
        if name == "accuracy-kitti" {
            source.publish(Document::Readme, "eval", &short(&table))?;
            source.publish(Document::Figures, "paper", &printed::accuracy(&table))?;
            source.publish_picture("accuracy_over_time.svg", &picture(&table)?)?;
        }
    }
    Ok(())
}

/// The confident subsets of the whole ladders.
fn confident() -> impl Iterator<Item = Method> {
    [Preset::Fast, Preset::Default]
        .into_iter()
        .map(|preset| Method::new(preset, ladder_length(preset)).confident(CONFIDENT))
}

fn row<'a>(table: &'a Table, method: &Method) -> Option<&'a Row> {
    let name = method.name();
    table.rows.iter().find(|row| row.name == name)
}

/// The README's table: what is asked of the semi-dense result, and D1 of the dense one.
fn short(table: &Table) -> String {
    let mut text = String::from(
        "| preset, rungs | ms | x SGBM | all <3 px, % | returned <3 px, % | density, % | D1-all (dense), % |\n\
         |---|---|---|---|---|---|---|\n",
    );
    let sgbm_ms = table.sgbm_ms();
    let mut line = |name: &str, row: &Row, d1: Option<&Row>| {
        let Score { edges, .. } = mean(&row.scores);
        let ratio = sgbm_ms.map_or_else(String::new, |sgbm| format!("{:.1}", sgbm / row.match_ms()));
        let d1 = d1.map_or_else(String::new, |row| format!("{:.1}", mean(&row.scores).dense.d1));
        writeln!(
            text,
            "| {name} | {:.2} | {ratio} | {:.1} | {:.1} | {:.1} | {d1} |",
            row.match_ms(),
            edges.all[1],
            edges.returned[1],
            edges.density
        )
        .expect("a String takes everything");
    };
    for method in methods() {
        if let Some(found) = row(table, &method) {
            line(&method.short_name(), found, row(table, &method.dense()));
        }
        if let Some(confident) = confident().find(|c| (c.preset, c.rungs) == (method.preset, method.rungs))
            && let Some(found) = row(table, &confident)
        {
            line(&format!("{}, confident", confident.short_name()), found, None);
        }
    }
    for peer in table.rows.iter().filter(|row| row.name.starts_with("OpenCV")) {
        line(&peer.name, peer, Some(peer));
    }
    text
}

/// Accuracy over time: a line of rungs for every preset, a point for every peer.
fn picture(table: &Table) -> Result<String> {
    let point = |row: &Row| (row.match_ms(), mean(&row.scores).edges.all[1]);
    let presets = [
        ("default", Preset::Default),
        ("fast", Preset::Fast),
        ("paper", Preset::Paper),
    ];
    let mut lines: Vec<Line> = presets
        .iter()
        .map(|&(name, preset)| Line {
            name: name.to_owned(),
            points: methods()
                .iter()
                .filter(|method| method.preset == preset)
                .filter_map(|method| row(table, method).map(point))
                .collect(),
        })
        .collect();
    let peers = table.rows.iter().filter(|row| row.name.starts_with("OpenCV"));
    lines.extend(peers.map(|row| Line {
        name: row.name.clone(),
        points: vec![point(row)],
    }));
    let axes = Axes {
        caption: "KITTI 2012, 1241x376, 128 disparities, one thread",
        x: "ms (logarithmic)",
        y: "all <3 px, %",
        logarithmic_x: true,
    };
    chart::svg(&[(axes, lines)])
}

#[cfg(test)]
mod tests {
    use super::{methods, short};

    use crate::table::{Row, Table};
    use stereo_tests::score::Score;

    #[test]
    fn the_short_table_has_a_line_for_every_method_and_its_dense_d1() {
        let row = |name: String, d1: f64| Row {
            name,
            scores: vec![Score {
                dense: stereo_tests::score::Accuracy {
                    d1,
                    ..Default::default()
                },
                ..Default::default()
            }],
            times_ms: vec![(2.0, 2.0)],
        };
        let mut rows: Vec<Row> = methods()
            .iter()
            .flat_map(|m| [row(m.name(), 80.0), row(m.dense().name(), 12.5)])
            .collect();
        rows.push(Row {
            times_ms: vec![(100.0, 100.0)],
            ..row("OpenCV 5.0.0 sgbm".to_owned(), 21.0)
        });
        let text = short(&Table { scenes: 1, rows });
        assert_eq!(text.lines().count(), 2 + methods().len() + 1);
        assert!(
            text.contains("| default 1 (mesh) | 2.00 | 50.0 | 0.0 | 0.0 | 0.0 | 12.5 |"),
            "{text}"
        );
        assert!(text.contains("| OpenCV 5.0.0 sgbm | 100.00 | 1.0 |"), "{text}");
    }
}
