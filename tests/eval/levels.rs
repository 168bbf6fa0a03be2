//! `cargo eval levels`: whole answers at every SIMD level, beside OpenCV's SGBM.

use std::fmt::Write as _;

use anyhow::Result;
use stereo::{Level, Preset};

use crate::contest::{Turns, take_turns};
use crate::method::{Contestant, Method, ladder_length};
use crate::pairs::{HD, Pair, VGA};
use crate::source::{DISPARITIES, Document, Source};

pub(crate) fn run(source: &Source) -> Result<()> {
    let whole = |preset| Method::new(preset, ladder_length(preset));
    let methods = [
        Method::new(Preset::Fast, 1),
        Method::new(Preset::Fast, 2),
        whole(Preset::Fast),
        Method::new(Preset::Default, 2),
        whole(Preset::Default),
        whole(Preset::Paper),
    ];
    let mut levels = Level::available();
    levels.reverse();
    let mut contestants: Vec<Contestant> = methods
        .iter()
        .flat_map(|&method| {
            levels
                .iter()
                .map(move |&level| Contestant::at_level(method, level))
        })
        .collect();
    contestants.extend(source.peers(&["sgbm"])?);

    let best = levels[0].name();
    let mut text =
        format!("ms (times as long as {best}; x SGBM of the same run)\n\n| pair | preset, rungs |");
    for level in &levels {
        write!(text, " {} |", level.name())?;
    }
    text.push_str(" SGBM |\n|---|---|");
    text.push_str(&"---|".repeat(levels.len() + 1));
    text.push('\n');
    for (name, pair) in Pair::standard(&source.data, &[VGA, HD])? {
        let views = pair.views(&name)?;
        let runs = take_turns(&mut contestants, &views, DISPARITIES, Turns::TIMED)?;
        let times_ms: Vec<f64> = runs.iter().map(|run| run.match_ms).collect();
        let (ours, sgbm_ms) = times_ms.split_at(methods.len() * levels.len());
        for (method, times_ms) in methods.iter().zip(ours.chunks(levels.len())) {
            write!(text, "| {name} | {} |", method.short_name())?;
            for ms in times_ms {
                write!(
                    text,
                    " {ms:.2} ({:.2}; {:.1}x) |",
                    ms / times_ms[0],
                    sgbm_ms[0] / ms
                )?;
            }
            writeln!(text, " {:.1} |", sgbm_ms[0])?;
        }
    }
    source.publish(Document::Figures, "levels", &text)
}
