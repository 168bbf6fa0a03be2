//! `cargo eval kernels`: time a pixel of every stage at every SIMD level, and the longest step of all.

use std::fmt::Write as _;

use anyhow::Result;
use stereo::{Level, Preset};

use crate::frame::Frame;
use crate::method::{Method, ladder_length, preset_name};
use crate::pairs::{HD, Pair, VGA};
use crate::source::{DISPARITIES, Document, Source};

const FRAMES: u32 = 15;
const PRESETS: [Preset; 3] = [Preset::Default, Preset::Fast, Preset::Paper];

pub(crate) fn run(source: &Source) -> Result<()> {
    let pairs = Pair::standard(&source.data, &[VGA, HD])?;
    source.publish(Document::Figures, "kernels", &kernels(&pairs)?)?;
    source.publish(Document::Figures, "steps", &steps(&pairs)?)
}

fn fastest(level: Level, pair: &Pair, preset: Preset) -> Result<Frame> {
    let method = Method::new(preset, ladder_length(preset));
    Frame::fastest(level, pair, &method.params(DISPARITIES), FRAMES)
}

/// Stages of the last pair at every level, the best first.
fn kernels(pairs: &[(String, Pair)]) -> Result<String> {
    let mut levels = Level::available();
    levels.reverse();
    let Some((name, pair)) = pairs.last() else {
        return Ok(String::new());
    };
    let pixels = (pair.size().width_px * pair.size().height_px) as f64;
    let mut text = format!(
        "{name}, all rungs; ns/px, and how many times as long as with {}\n",
        levels[0].name()
    );
    for preset in PRESETS {
        write!(text, "\n| {}: rung | stage | ms |", preset_name(preset))?;
        for level in &levels {
            write!(text, " {} |", level.name())?;
        }
        text.push_str("\n|---|---|---|");
        text.push_str(&"---|".repeat(levels.len()));
        text.push('\n');
        let frames = levels
            .iter()
            .map(|&level| Ok(fastest(level, pair, preset)?.stages()))
            .collect::<Result<Vec<_>>>()?;
        let mut line = |rung: &str, stage: &str, times_ms: Vec<f64>| -> Result<()> {
            write!(text, "| {rung} | {stage} | {:.3} |", times_ms[0])?;
            for (i, ms) in times_ms.iter().enumerate() {
                let ratio = if i > 0 {
                    format!(" ({:.1}x)", ms / times_ms[0])
                } else {
                    String::new()
                };
                write!(text, " {:.2}{ratio} |", 1e6 * ms / pixels)?;
            }
            text.push('\n');
            Ok(())
        };
        for (i, stage) in frames[0].iter().enumerate() {
            let times_ms = frames.iter().map(|stages| stages[i].ms).collect();
            line(stage.rung, stage.name, times_ms)?;
        }
        let sums = frames.iter().map(|stages| stages.iter().map(|s| s.ms).sum());
        line("all", "", sums.collect())?;
    }
    Ok(text)
}

/// The first answer, and the longest step after it, at this machine's best level.
fn steps(pairs: &[(String, Pair)]) -> Result<String> {
    let mut text = String::from(
        "| pair | preset | first answer, ms | steps after it | longest, ms | its rung and stage |\n|---|---|---|---|---|---|\n",
    );
    for (name, pair) in pairs {
        for preset in PRESETS {
            let frame = fastest(Level::detect(), pair, preset)?;
            let base_ms: f64 = frame.base.iter().map(|step| step.ms).sum();
            let longest = frame.refine.iter().max_by(|a, b| a.ms.total_cmp(&b.ms));
            let (ms, place) = longest.map_or_else(
                || (0.0, String::new()),
                |step| (step.ms, format!("{}, {}", step.rung, step.stage)),
            );
            writeln!(
                text,
                "| {name} | {} | {base_ms:.2} | {} | {ms:.2} | {place} |",
                preset_name(preset),
                frame.refine.len()
            )?;
        }
    }
    Ok(text)
}
