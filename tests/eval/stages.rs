//! `cargo eval stages`: where the time of a frame goes, by rung and stage.

use std::fmt::Write as _;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args as Options;
use stereo::{DisparityMap, Level, Matcher, Params, Preset, Progress, Serial, Shape, StereoPair, rung_names};
use stereo_tests::gray::GrayImage;

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
                    println!("{}", frame.markdown(size));
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

/// What one stage of the way to one rung took.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Stage {
    pub(crate) rung: &'static str,
    pub(crate) name: &'static str,
    /// All its steps together.
    pub(crate) ms: f64,
    pub(crate) steps: u32,
    /// The longest of its steps.
    pub(crate) longest_ms: f64,
}

/// The stages of a whole ladder, in the order in which they are first met.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Frame {
    pub(crate) stages: Vec<Stage>,
    /// Time of the fastest frame.
    pub(crate) ms: f64,
}

impl Frame {
    /// Every stage's fastest, of `repeat` frames after a first one that isn't counted.
    pub(crate) fn fastest(level: Level, pair: &Pair, params: &Params, repeat: u32) -> Result<Self> {
        let shape = Shape::new(pair.left.width_px(), pair.left.height_px())?;
        let mut matcher = Matcher::new(level, shape, params.clone())?;
        let mut map = DisparityMap::new(shape);
        let pair = (&pair.left, &pair.right);
        one_frame(&mut matcher, &mut map, pair, params.preset)?;
        let mut best = one_frame(&mut matcher, &mut map, pair, params.preset)?;
        for _ in 1..repeat {
            best.take_faster(&one_frame(&mut matcher, &mut map, pair, params.preset)?);
        }
        Ok(best)
    }

    fn take_faster(&mut self, other: &Self) {
        self.ms = self.ms.min(other.ms);
        for (stage, again) in self.stages.iter_mut().zip(&other.stages) {
            stage.ms = stage.ms.min(again.ms);
            stage.longest_ms = stage.longest_ms.min(again.longest_ms);
        }
    }

    fn add(&mut self, rung: &'static str, name: &'static str, ms: f64) {
        let known = self
            .stages
            .iter_mut()
            .rev()
            .find(|s| s.rung == rung && s.name == name);
        if let Some(stage) = known {
            stage.ms += ms;
            stage.steps += 1;
            stage.longest_ms = stage.longest_ms.max(ms);
        } else {
            self.stages.push(Stage {
                rung,
                name,
                ms,
                steps: 1,
                longest_ms: ms,
            });
        }
    }

    fn markdown(&self, size: Size) -> String {
        let pixels = (size.width_px * size.height_px) as f64;
        let sum: f64 = self.stages.iter().map(|stage| stage.ms).sum();
        let mut text = String::from(
            "| rung | stage | ms | % | ns/px | steps | longest step, ms |\n|---|---|---|---|---|---|---|\n",
        );
        for stage in &self.stages {
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
            self.ms
        )
        .expect("a String takes everything");
        text
    }
}

/// One frame through the whole ladder, by the clock.
fn one_frame(
    matcher: &mut Matcher,
    map: &mut DisparityMap,
    (left, right): (&GrayImage, &GrayImage),
    preset: Preset,
) -> Result<Frame> {
    let rungs = rung_names(preset);
    let pair = StereoPair::new(left.view(), right.view())?;
    let mut frame = Frame {
        stages: Vec::new(),
        ms: 0.0,
    };
    let start = Instant::now();
    let mut last = start;
    let mut since_last = || {
        let now = Instant::now();
        let ms = 1e3 * (now - last).as_secs_f64();
        last = now;
        ms
    };
    let mut progress = matcher.base_by_stage(pair, map, &Serial, &mut |stage| {
        frame.add(rungs[0], stage, since_last());
    })?;
    let mut rung = 0;
    loop {
        match progress {
            Progress::Working => {}
            Progress::Improved(_) => rung += 1,
            Progress::Converged(_) => break,
        }
        let name = rungs.get(rung).context("no more rungs than names")?;
        let stage = matcher.next_stage();
        progress = matcher.refine(pair, map, &Serial);
        frame.add(name, stage, since_last());
    }
    frame.ms = 1e3 * start.elapsed().as_secs_f64();
    Ok(frame)
}

#[cfg(test)]
mod tests {
    use super::{Frame, Stage};

    #[test]
    fn steps_of_a_stage_add_up_and_the_longest_is_kept() {
        let mut frame = Frame {
            stages: Vec::new(),
            ms: 7.0,
        };
        frame.add("mesh", "search", 1.0);
        frame.add("mesh", "search", 3.0);
        frame.add("half", "search", 2.0);
        let search = Stage {
            rung: "mesh",
            name: "search",
            ms: 4.0,
            steps: 2,
            longest_ms: 3.0,
        };
        assert_eq!(frame.stages[0], search);
        assert_eq!(frame.stages.len(), 2);
        let text = frame.markdown("100x10".parse().expect("a size"));
        assert!(
            text.contains("| mesh | search | 4.000 | 66.7 | 4000.00 | 2 | 3.000 |"),
            "{text}"
        );
    }
}
