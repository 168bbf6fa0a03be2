//! `cargo eval shared-pixels`: our dense result at exactly the pixels that OpenCV returns, beside OpenCV's own.

use std::fmt::Write as _;

use anyhow::Result;
use stereo::Preset;
use stereo_tests::score::{high_gradient, share_within};

use crate::contest::{Turns, take_turns};
use crate::method::{Contestant, Method, Run, Views, ladder_length};
use crate::source::{DISPARITIES, Document, ETH3D, KITTI, MIDDLEBURY, Source};

const BOUNDS_PX: [f32; 2] = [1.0, 3.0];

pub(crate) fn run(source: &Source) -> Result<()> {
    let methods: Vec<Method> = (2..=ladder_length(Preset::Default))
        .map(|rungs| Method::new(Preset::Default, rungs).dense())
        .collect();
    let mut text = String::from(
        "Within 1 / 3 px of the truth, in %, at the pixels that OpenCV returns; what we miss is wrong.\n\n",
    );
    write!(text, "| data set | pixels | returned by | of which it has |")?;
    for method in &methods {
        write!(text, " {} |", method.short_name())?;
    }
    text.push_str("\n|---|---|---|---|");
    text.push_str(&"---|".repeat(methods.len()));
    text.push('\n');
    for set in [KITTI, MIDDLEBURY, ETH3D] {
        let scenes = source.views(set)?;
        let mut contestants: Vec<Contestant> = methods.iter().copied().map(Contestant::ours).collect();
        contestants.extend(source.peers(&["sgbm", "3way"])?);
        let runs = scenes
            .iter()
            .map(|views| take_turns(&mut contestants, views, DISPARITIES, Turns::ONCE))
            .collect::<Result<Vec<_>>>()?;
        for only_edges in [true, false] {
            for (peer, contestant) in contestants.iter().enumerate().skip(methods.len()) {
                let pixels = if only_edges { "high-gradient" } else { "all" };
                write!(text, "| {} | {pixels} | {} |", set.title, contestant.name())?;
                for column in std::iter::once(peer).chain(0..methods.len()) {
                    let shares = mean_shares(&scenes, &runs, only_edges, (peer, column));
                    write!(text, " {:.1} / {:.1} |", shares[0], shares[1])?;
                }
                text.push('\n');
            }
        }
    }
    source.publish(Document::Figures, "shared-pixels", &text)
}

/// Shares of contestant `scored` at the pixels that contestant `peer` returns, means over the scenes.
fn mean_shares(
    scenes: &[Views],
    runs: &[Vec<Run>],
    only_edges: bool,
    (peer, scored): (usize, usize),
) -> [f64; 2] {
    let mut sums = [0.0; 2];
    for (views, runs) in scenes.iter().zip(runs) {
        let mut chosen: Vec<bool> = runs[peer].disparity_px.iter().map(|d| *d > 0.0).collect();
        if only_edges {
            for (chosen, strong) in chosen.iter_mut().zip(high_gradient(&views.scored.left)) {
                *chosen &= strong;
            }
        }
        let truth = &views.scored.truth.disparity_px;
        for (sum, bound) in sums.iter_mut().zip(BOUNDS_PX) {
            *sum += share_within(&runs[scored].disparity_px, truth, &chosen, bound);
        }
    }
    sums.map(|sum| sum / scenes.len() as f64)
}
