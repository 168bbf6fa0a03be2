//! `cargo eval`: accuracy and time over a folder of scenes, in process, beside OpenCV on the same pairs.
//!
//! `cargo eval --data FOLDER --peers sgbm,3way,bm` prints one row a method; the protocol is [`stereo_tests::score`]'s.
//! Every method runs on one thread; of `--repeat` runs the fastest counts, over scenes the median.

mod method;
mod peers;
mod table;

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Parser;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use stereo_tests::dataset::{SceneFiles, find_scenes};
use stereo_tests::{machine, readme, score};

use crate::method::{Contestant, Method};
use crate::table::{Row, Table};

/// Accuracy and time over a folder of scenes, in process.
#[derive(Debug, Parser)]
struct Args {
    /// Folder of scenes: prepared ones, KITTI 2012 or 2015, Middlebury 2014 or ETH3D as downloaded.
    #[arg(long)]
    data: PathBuf,
    /// Presets: default, fast, paper.
    #[arg(long, value_delimiter = ',', default_value = "default")]
    preset: Vec<String>,
    /// Numbers of rungs to run at most, the first included.
    #[arg(long, value_delimiter = ',', default_value = "1,2,4")]
    iterations: Vec<u8>,
    /// semi_dense, dense.
    #[arg(long, value_delimiter = ',', default_value = "semi_dense")]
    density: Vec<String>,
    /// Least confidences, 0 to 1.
    #[arg(long, value_delimiter = ',', default_value = "0")]
    min_confidence: Vec<f32>,
    /// OpenCV's methods to run beside ours: sgbm, 3way, bm.
    #[arg(long, value_delimiter = ',')]
    peers: Vec<String>,
    /// Python with opencv-python-headless, for the peers (`make eval` makes this one).
    #[arg(long, default_value = "target/venv/bin/python")]
    python: PathBuf,
    /// Only scenes whose name begins with one of these.
    #[arg(long, value_delimiter = ',')]
    only: Vec<String>,
    /// At most so many scenes, spread over the list; 0 = all.
    #[arg(long, default_value_t = 0)]
    limit: usize,
    /// Disparities searched: a number, or auto = what the scene's own files ask for.
    #[arg(long, default_value = "128")]
    num_disparities: String,
    /// Runs a scene; the fastest counts.
    #[arg(long, default_value_t = 7, value_parser = clap::value_parser!(u32).range(1..))]
    repeat: u32,
    /// Writes all figures to this file.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Replaces the table between the markers of this Markdown file.
    #[arg(long)]
    readme: Option<PathBuf>,
}

#[expect(clippy::print_stdout, reason = "the table is what this program is for")]
fn main() -> Result<()> {
    let args = Args::parse();
    let scenes = selected_scenes(&args)?;
    let mut contestants = contestants(&args)?;
    let mut rows: Vec<Row> = contestants.iter().map(|c| Row::new(c.name())).collect();
    let bar = progress_bar(scenes.len() * contestants.len())?;
    for scene in &scenes {
        bar.set_message(scene.name.clone());
        let views = method::Views::load(scene)?;
        let disparities = disparities(&args, scene)?;
        for (contestant, row) in contestants.iter_mut().zip(&mut rows) {
            let run = contestant
                .best_of(args.repeat, &views, disparities)
                .with_context(|| format!("{} on {}", row.name, scene.name))?;
            row.scores.push(score::score(
                &run.disparity_px,
                &views.scored.left,
                &views.scored.truth.disparity_px,
            ));
            row.times_ms.push((run.match_ms, run.wall_ms));
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    let table = Table {
        scenes: scenes.len(),
        rows,
        machine: format!("{}, one thread", machine::describe()),
    };
    println!("{}", table.markdown());
    if let Some(path) = &args.json {
        write(path, &table.json()?)?;
    }
    if let Some(path) = &args.readme {
        readme::write_table(path, "eval", &table.markdown())?;
    }
    Ok(())
}

fn selected_scenes(args: &Args) -> Result<Vec<SceneFiles>> {
    let mut scenes = find_scenes(&args.data)?;
    if !args.only.is_empty() {
        scenes.retain(|scene| {
            args.only
                .iter()
                .any(|start| scene.name.starts_with(start.as_str()))
        });
    }
    if let Some(share) = scenes.len().checked_div(args.limit) {
        let step = share.max(1);
        scenes = scenes.into_iter().step_by(step).take(args.limit).collect();
    }
    ensure!(
        !scenes.is_empty(),
        "no scene with ground truth in {}{}",
        args.data.display(),
        if args.only.is_empty() {
            String::new()
        } else {
            format!(" whose name begins with {}", args.only.join(" or "))
        }
    );
    Ok(scenes)
}

/// Every combination of the options, then the peers.
fn contestants(args: &Args) -> Result<Vec<Contestant>> {
    let mut list = Vec::new();
    for preset in &args.preset {
        for density in &args.density {
            for &rungs in &args.iterations {
                for &min_confidence in &args.min_confidence {
                    let method = Method::new(preset, density, rungs, min_confidence)?;
                    list.push(Contestant::Ours {
                        method: Box::new(method),
                        bench: None,
                    });
                }
            }
        }
    }
    if !args.peers.is_empty() {
        let process = peers::Peers::start(&args.python)?;
        for name in &args.peers {
            list.push(Contestant::Peer {
                name: name.clone(),
                process: process.clone(),
            });
        }
    }
    Ok(list)
}

fn disparities(args: &Args, scene: &SceneFiles) -> Result<u16> {
    if args.num_disparities == "auto" {
        return scene.disparities();
    }
    args.num_disparities.parse().with_context(|| {
        format!(
            "--num-disparities must be a number or auto, got {}",
            args.num_disparities
        )
    })
}

fn progress_bar(steps: usize) -> Result<ProgressBar> {
    let target = if std::io::stderr().is_terminal() {
        ProgressDrawTarget::stderr()
    } else {
        ProgressDrawTarget::hidden()
    };
    let bar = ProgressBar::with_draw_target(Some(u64::try_from(steps)?), target);
    bar.set_style(ProgressStyle::with_template(
        "{bar:30} {pos}/{len} {eta} left  {msg}",
    )?);
    Ok(bar)
}

fn write(path: &Path, text: &str) -> Result<()> {
    std::fs::write(path, text).with_context(|| format!("can't write {}", path.display()))
}
