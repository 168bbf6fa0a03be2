//! `cargo eval any`: one row for every combination of options, over a folder of scenes, beside OpenCV on the same pairs.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args as Options;
use stereo_tests::dataset::SceneFiles;
use stereo_tests::machine;

use crate::contest::{Turns, compete};
use crate::method::{self, Contestant, Method, Views};
use crate::source::Source;
use crate::table::Table;

/// Accuracy and time of any combination of options.
#[derive(Debug, Options)]
pub(crate) struct Args {
    #[command(flatten)]
    source: Source,
    /// Presets: default, fast, paper.
    #[arg(long, value_delimiter = ',', default_value = "default")]
    preset: Vec<String>,
    /// Numbers of rungs to run at most, the first included.
    #[arg(long, value_delimiter = ',', default_value = "1,2,4")]
    iterations: Vec<u8>,
    /// `semi_dense`, `dense`.
    #[arg(long, value_delimiter = ',', default_value = "semi_dense")]
    density: Vec<String>,
    /// Least confidences, 0 to 1.
    #[arg(long, value_delimiter = ',', default_value = "0")]
    min_confidence: Vec<f32>,
    /// OpenCV's methods to run beside ours: sgbm, 3way, bm.
    #[arg(long, value_delimiter = ',')]
    peers: Vec<String>,
    /// Only scenes whose name begins with one of these.
    #[arg(long, value_delimiter = ',')]
    only: Vec<String>,
    /// At most so many scenes, spread over the list; 0 = all.
    #[arg(long, default_value_t = 0)]
    limit: usize,
    /// Disparities searched: a number, or auto = what the scene's own files ask for.
    #[arg(long, default_value = "128")]
    num_disparities: String,
    /// SIMD level: scalar, avx2, avx512; absent = this machine's best.
    #[arg(long)]
    level: Option<String>,
    /// Turns that everybody takes on a scene, each of two runs; the fastest run counts.
    #[arg(long, default_value_t = Turns::TIMED.rounds, value_parser = clap::value_parser!(u32).range(1..))]
    repeat: u32,
    /// Writes all figures to this file.
    #[arg(long)]
    json: Option<PathBuf>,
}

#[expect(clippy::print_stdout, reason = "the table is what this command is for")]
pub(crate) fn run(args: &Args) -> Result<()> {
    let scenes = selected_scenes(args)?;
    let views = scenes.iter().map(Views::load).collect::<Result<Vec<_>>>()?;
    let turns = Turns {
        rounds: args.repeat,
        ..Turns::TIMED
    };
    let disparities = |i: usize| disparities(args, &scenes[i]);
    let rows = compete(&mut contestants(args)?, &views, disparities, turns)?;
    let table = Table {
        scenes: scenes.len(),
        rows,
    };
    println!("{}, one thread\n\n{}", machine::describe(), table.markdown());
    if let Some(path) = &args.json {
        std::fs::write(path, table.json()?).with_context(|| format!("can't write {}", path.display()))?;
    }
    Ok(())
}

fn selected_scenes(args: &Args) -> Result<Vec<SceneFiles>> {
    let mut scenes = args.source.scenes(&args.only)?;
    if let Some(share) = scenes.len().checked_div(args.limit) {
        let step = share.max(1);
        scenes = scenes.into_iter().step_by(step).take(args.limit).collect();
    }
    Ok(scenes)
}

/// Every combination of the options, then the peers.
fn contestants(args: &Args) -> Result<Vec<Contestant>> {
    let level = args
        .level
        .as_deref()
        .map_or(Ok(stereo::Level::detect()), method::level)?;
    let mut list = Vec::new();
    for preset in &args.preset {
        for density in &args.density {
            for &rungs in &args.iterations {
                for &min_confidence in &args.min_confidence {
                    ensure!(rungs > 0, "--iterations counts the first one: it is at least 1");
                    ensure!(
                        (0.0..=1.0).contains(&min_confidence),
                        "--min-confidence must be 0 to 1, got {min_confidence}"
                    );
                    let method = Method {
                        density: method::density(density)?,
                        min_confidence,
                        ..Method::new(method::preset(preset)?, rungs)
                    };
                    list.push(Contestant::at_level(method, level));
                }
            }
        }
    }
    let names: Vec<&str> = args.peers.iter().map(String::as_str).collect();
    list.extend(args.source.peers(&names)?);
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
