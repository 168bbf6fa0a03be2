//! `cargo eval sizes`: time by resolution, as the paper's table IV, beside OpenCV and beside what the paper printed.

use std::fmt::Write as _;

use anyhow::Result;

use crate::accuracy::{PEERS, methods};
use crate::contest::{Turns, take_turns};
use crate::method::{Contestant, Run};
use crate::pairs::{Pair, SIZES};
use crate::printed;
use crate::source::{DISPARITIES, Document, Source};

pub(crate) fn run(source: &Source) -> Result<()> {
    let methods = methods();
    let mut contestants: Vec<Contestant> = methods.iter().copied().map(Contestant::ours).collect();
    contestants.extend(source.peers(&PEERS)?);
    let mut names: Vec<String> = methods.iter().map(crate::method::Method::short_name).collect();
    names.extend(contestants[methods.len()..].iter().map(Contestant::name));

    let mut columns: Vec<(String, Vec<Run>)> = Vec::new();
    for (name, pair) in Pair::standard(&source.data, &SIZES)? {
        let views = pair.views(&name)?;
        let runs = take_turns(&mut contestants, &views, DISPARITIES, Turns::TIMED)?;
        columns.push((name, runs));
    }

    let mut text = String::from("ms (x SGBM of the same run)\n\n| preset, rungs |");
    for (name, _) in &columns {
        write!(text, " {name} |")?;
    }
    text.push_str("\n|---|");
    text.push_str(&"---|".repeat(columns.len()));
    text.push('\n');
    let sgbm = methods.len();
    for (i, name) in names.iter().enumerate() {
        write!(text, "| {name} |")?;
        for (_, runs) in &columns {
            let (ms, sgbm_ms) = (runs[i].match_ms, runs[sgbm].match_ms);
            write!(text, " {ms:.2} ({:.1}x) |", sgbm_ms / ms)?;
        }
        text.push('\n');
    }
    text.push_str(&printed::times_by_size(SIZES.len()));
    source.publish(Document::Figures, "sizes", &text)
}
