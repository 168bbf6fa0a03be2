//! Contestants take turns on the same scenes, so that what else the machine does falls on all of them alike.

use std::io::IsTerminal;

use anyhow::{Context, Result};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use stereo_tests::score::score;

use crate::method::{Contestant, Run, Views};
use crate::table::Row;

/// How often everybody runs on a scene: `rounds` times in turns, each time `burst` times in a row. The fastest counts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Turns {
    pub(crate) rounds: u32,
    pub(crate) burst: u32,
}

impl Turns {
    /// For times. The second run of a burst finds its memory as warm as on a machine of its own.
    pub(crate) const TIMED: Self = Self { rounds: 4, burst: 2 };
    /// For accuracy alone: matching is deterministic.
    pub(crate) const ONCE: Self = Self { rounds: 1, burst: 1 };
}

/// The fastest run of everybody on one scene.
pub(crate) fn take_turns(
    contestants: &mut [Contestant],
    views: &Views,
    disparities: u16,
    turns: Turns,
) -> Result<Vec<Run>> {
    let mut best: Vec<Run> = Vec::with_capacity(contestants.len());
    for round in 0..turns.rounds {
        for (i, contestant) in contestants.iter_mut().enumerate() {
            let run = contestant
                .best_of(turns.burst, views, disparities)
                .with_context(|| format!("{} on {}", contestant.name(), views.name))?;
            if round == 0 {
                best.push(run);
            } else if run.match_ms < best[i].match_ms {
                best[i] = run;
            }
        }
    }
    Ok(best)
}

/// Scores and times of everybody over `scenes`.
pub(crate) fn compete(
    contestants: &mut [Contestant],
    scenes: &[Views],
    disparities: impl Fn(usize) -> Result<u16>,
    turns: Turns,
) -> Result<Vec<Row>> {
    let mut rows: Vec<Row> = contestants.iter().map(|c| Row::new(c.name())).collect();
    let bar = progress_bar(scenes.len())?;
    for (i, views) in scenes.iter().enumerate() {
        bar.set_message(views.name.clone());
        let runs = take_turns(contestants, views, disparities(i)?, turns)?;
        for (run, row) in runs.iter().zip(&mut rows) {
            let truth = &views.scored.truth.disparity_px;
            row.scores
                .push(score(&run.disparity_px, &views.scored.left, truth));
            row.times_ms.push((run.match_ms, run.wall_ms));
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(rows)
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
