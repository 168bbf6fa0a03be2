//! `cargo eval rooms`: the paper's table V, pairs of a camera without ground truth, with OpenCV's SGBM as reference.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use stereo_tests::dataset::LoadedScene;
use stereo_tests::gray::GrayImage;
use stereo_tests::score::{Accuracy, score};
use stereo_tests::truth::TruthMap;

use crate::accuracy::{PEERS, methods};
use crate::contest::{Turns, take_turns};
use crate::method::{Contestant, Method, Run, Views};
use crate::printed;
use crate::source::{DISPARITIES, Document, Source};

pub(crate) fn run(source: &Source) -> Result<()> {
    let rooms = rooms(&source.data.join("oakd_nogt"))?;
    let methods = methods();
    let mut contestants: Vec<Contestant> = methods.iter().copied().map(Contestant::ours).collect();
    contestants.extend(source.peers(&PEERS)?);
    let sgbm = methods.len();
    let mut names: Vec<String> = methods.iter().map(Method::short_name).collect();
    names.extend(contestants[sgbm..].iter().map(Contestant::name));

    let mut against_sgbm = Vec::new();
    for room in &rooms {
        let runs = take_turns(&mut contestants, room, DISPARITIES, Turns::ONCE)?;
        against_sgbm.push(within_reference(room, &runs, sgbm)?);
    }
    let mut text = String::from(
        "Of the high-gradient pixels that SGBM returns, in %: within 3 px of SGBM, of the returned ones / of all\n\n| method |",
    );
    for room in &rooms {
        write!(text, " {} |", room.name)?;
    }
    text.push_str(" mean | density |\n|---|");
    text.push_str(&"---|".repeat(rooms.len() + 2));
    text.push('\n');
    for (i, name) in names.iter().enumerate().filter(|(i, _)| *i != sgbm) {
        write!(text, "| {name} |")?;
        let mut sums = [0.0; 3];
        for room in &against_sgbm {
            let Accuracy {
                returned,
                all,
                density,
                ..
            } = room[i];
            write!(text, " {:.1} / {:.1} |", returned[1], all[1])?;
            for (sum, share) in sums.iter_mut().zip([returned[1], all[1], density]) {
                *sum += share;
            }
        }
        let [returned, all, density] = sums.map(|sum| sum / rooms.len() as f64);
        writeln!(text, " {returned:.1} / {all:.1} | {density:.1} |")?;
    }
    text.push_str("\n| paper, printed: within 3 px of SGBM, % | BumbleBee2 | ZED |\n|---|---|---|\n");
    for (method, [bumblebee, zed]) in printed::TABLE_5 {
        writeln!(text, "| *{method}* | *{bumblebee}* | *{zed}* |")?;
    }
    source.publish(Document::Figures, "rooms", &text)
}

/// Every contestant's accuracy at the high-gradient pixels where contestant `reference` has a disparity, which counts as
/// the truth.
fn within_reference(room: &Views, runs: &[Run], reference: usize) -> Result<Vec<Accuracy>> {
    let (width_px, height_px) = (room.scored.left.width_px(), room.scored.left.height_px());
    let truth = TruthMap::new(width_px, height_px, runs[reference].disparity_px.clone())?;
    let accuracy = |run: &Run| score(&run.disparity_px, &room.scored.left, &truth.disparity_px).edges;
    Ok(runs.iter().map(accuracy).collect())
}

/// Every folder of `folder` with a pair in it.
fn rooms(folder: &Path) -> Result<Vec<Views>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("can't list {}", folder.display()))?;
    let mut paths = entries
        .map(|entry| Ok(entry?.path()))
        .collect::<Result<Vec<_>>>()?;
    paths.sort();
    let mut rooms = Vec::new();
    for path in paths.iter().filter(|path| path.join("left.png").is_file()) {
        let (left, right) = (
            GrayImage::read(&path.join("left.png"))?,
            GrayImage::read(&path.join("right.png"))?,
        );
        let (width_px, height_px) = (left.width_px(), left.height_px());
        let truth = TruthMap::new(width_px, height_px, vec![0.0; width_px * height_px])?;
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
        rooms.push(Views {
            name: name.unwrap_or_default(),
            served: (left.clone(), right.clone()),
            scored: LoadedScene { left, right, truth },
        });
    }
    ensure!(
        !rooms.is_empty(),
        "no folder with left.png in {}",
        folder.display()
    );
    Ok(rooms)
}
