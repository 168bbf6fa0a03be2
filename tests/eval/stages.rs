//! `cargo eval stages`: where the time of a frame goes, by rung and stage.

use std::fmt::Write as _;

use anyhow::Result;
use clap::Args as Options;
use stereo::{Level, Params};

use crate::frame::Frame;
use crate::method::{level, preset};
use crate::pairs::{MOTORCYCLE, Pair, Size};
use crate::source::Source;

/// Time of every stage of a frame.
#[derive(Debug, Options)]
pub(crate) struct Args {
    /// Scene: the end of a folder's name below --data, or motorcycle (from the package registry).
    #[arg(long, value_delimiter = ',', default_value = MOTORCYCLE)]
    scene: Vec<String>,
    #[command(flatten)]
    source: Source,
    /// Sizes to bring the scene to, such as 640x480,1280x720; absent = its own.
    #[arg(long, value_delimiter = ',')]
    size: Vec<Size>,
    /// Presets: default, fast, paper.
    #[arg(long, value_delimiter = ',', default_value = "default")]
    preset: Vec<String>,
    /// SIMD levels: scalar, avx2, avx512; absent = this machine's best.
    #[arg(long, value_delimiter = ',')]
    level: Vec<String>,
    /// Disparities searched.
    #[arg(long, default_value_t = 128)]
    num_disparities: u16,
    /// Frames; every stage's fastest counts.
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u32).range(1..))]
    repeat: u32,
}

#[expect(clippy::print_stdout, reason = "the tables are what this command is for")]
pub(crate) fn run(args: &Args) -> Result<()> {
    for scene in &args.scene {
        let pair = Pair::load(&args.source.data, scene)?;
        let sizes = if args.size.is_empty() {
            vec![pair.size()]
        } else {
            args.size.clone()
        };
        for size in sizes {
            let pair = pair.resized(size)?;
            for name in &args.preset {
                for level in levels(&args.level)? {
                    let mut params = Params {
                        preset: preset(name)?,
                        ..Params::default()
                    };
                    params.range.count = args.num_disparities;
                    let frame = Frame::fastest(level, &pair, &params, args.repeat)?;
                    println!("{scene} {size}, preset {name}, {}\n", level.name());
                    println!("{}", markdown(&frame, size));
                }
            }
        }
    }
    Ok(())
}

/// The levels of these names; this machine's best for none.
fn levels(names: &[String]) -> Result<Vec<Level>> {
    if names.is_empty() {
        return Ok(vec![Level::detect()]);
    }
    names.iter().map(|name| level(name)).collect()
}

fn markdown(frame: &Frame, size: Size) -> String {
    let pixels = (size.width_px * size.height_px) as f64;
    let stages = frame.stages();
    let sum: f64 = stages.iter().map(|stage| stage.ms).sum();
    let mut text = String::from(
        "| rung | stage | ms | % | ns/px | steps | longest step, ms |\n|---|---|---|---|---|---|---|\n",
    );
    for stage in &stages {
        writeln!(
            text,
            "| {} | {} | {:.3} | {:.1} | {:.2} | {} | {:.3} |",
            stage.rung,
            stage.name,
            stage.ms,
            100.0 * stage.ms / sum,
            1e6 * stage.ms / pixels,
            stage.steps,
            stage.longest_ms
        )
        .expect("a String takes everything");
    }
    writeln!(
        text,
        "| all | | {sum:.3} | 100 | {:.2} | | fastest whole frame {:.3} |",
        1e6 * sum / pixels,
        frame.ms
    )
    .expect("a String takes everything");
    text
}

#[cfg(test)]
mod tests {
    use super::markdown;
    use crate::frame::{Frame, Step};

    #[test]
    fn a_stage_has_its_share_of_the_frame_and_its_time_a_pixel() {
        let step = |stage, ms| Step {
            rung: "mesh",
            stage,
            ms,
        };
        let frame = Frame {
            base: vec![step("search", 1.0), step("search", 3.0), step("publish", 2.0)],
            refine: Vec::new(),
            ms: 7.0,
        };
        let text = markdown(&frame, "100x10".parse().expect("a size"));
        let search = "| mesh | search | 4.000 | 66.7 | 4000.00 | 2 | 3.000 |";
        assert!(text.contains(search), "{text}");
    }
}
