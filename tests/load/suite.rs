//! The series of loads: capacity, then fractions and multiples of it, with the server's own policy and its rivals.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result};
use bytes::Bytes;
use clap::ValueEnum;
use indicatif::ProgressBar;
use stereo_tests::{machine, readme};

use crate::args::{Args, Codec, Part, Size};
use crate::arrivals::Process;
use crate::figures::{Figures, recovery};
use crate::frames::Frames;
use crate::generator::Until;
use crate::plan::{Load, Profile, Stretch};
use crate::scenario::{OWN_POLICY, Stage, Trial};
use crate::table::{Further, LEGEND, Row, Table};
use crate::{chart, csv, progress_bar};

/// Budgets of raw pairs in ms.
const RAW_BUDGETS_MS: [u64; 4] = [10, 20, 50, 100];
/// Budgets of PNG pairs in ms, which take longer to decode.
const PNG_BUDGETS_MS: [u64; 4] = [20, 50, 100, 200];
/// Loads as multiples of the capacity, each with the share in budget that is asked of it.
const FACTORS: [(f64, f64); 4] = [(0.8, 0.99), (1.0, 0.97), (2.0, 0.99), (4.0, 0.99)];
/// Clients that share the server.
const CLIENTS: usize = 5;
/// The load around a burst and among well-behaved clients, as a multiple of the capacity.
const QUIET: f64 = 0.8;
/// A burst, as a multiple of the capacity.
const BURST: f64 = 5.0;
/// How long a burst and the time after it last.
const BURST_SECONDS: f64 = 5.0;
/// What the flooding client sends, as a multiple of its share.
const FLOOD: f64 = 10.0;
/// The load of large images, as a multiple of their own capacity.
const LARGE: f64 = 8.0;
const FOUR_MEGAPIXELS: Size = Size {
    width_px: 2048,
    height_px: 2048,
};

/// Seconds of a measurement of a capacity.
const CAPACITY_SECONDS: f64 = 6.0;
/// Seconds of a rival's run: how it fares is plain soon.
const RIVAL_SECONDS: f64 = 5.0;

/// Runs the parts asked for, prints their tables, and writes the files. Each part measures the capacity for itself, so that parts can be
/// run at different times; the table of the README has the last run of each.
#[expect(clippy::print_stdout, reason = "the table is what this program is for")]
pub(crate) fn run(args: &Args) -> Result<()> {
    let mut parts = args.only.clone();
    parts.sort_unstable();
    parts.dedup();
    let bar = progress_bar(parts.len() as u64, "{bar:30} {pos}/{len} parts {elapsed}  {msg}")?;
    bar.enable_steady_tick(Duration::from_millis(500));
    let mut suite = Suite {
        args,
        stage: Stage::new(args),
        frames: Frames::render(Size::VGA),
        bar,
        rows: Vec::new(),
    };
    for part in parts {
        let table = suite.part(part)?;
        let written = write(args, part, &table)?;
        suite
            .bar
            .suspend(|| println!("{}\nWritten: {written}\n", table.markdown(part)));
        suite.bar.inc(1);
    }
    suite.bar.finish_and_clear();
    if let Some(path) = &args.write {
        readme::write_table(path, "load", &whole(args))?;
    }
    Ok(())
}

/// The tables of all parts that were ever run with this output folder.
fn whole(args: &Args) -> String {
    let parts = Part::value_variants().iter();
    let tables = parts.filter_map(|&part| std::fs::read_to_string(kept(args, part)).ok());
    tables.chain([LEGEND.to_owned()]).collect::<Vec<_>>().join("\n")
}

/// Where the table of a part is kept.
fn kept(args: &Args, part: Part) -> PathBuf {
    args.out.join(format!("{}.md", part.name()))
}

fn write(args: &Args, part: Part, table: &Table) -> Result<String> {
    std::fs::create_dir_all(&args.out).with_context(|| format!("can't make {}", args.out.display()))?;
    let dated = |ending| {
        let time = table.file_time();
        args.out.join(format!("{time}-{}.{ending}", part.name()))
    };
    let mut files = vec![
        (kept(args, part), table.markdown(part)),
        (dated("csv"), csv::of(table, &table.file_time())),
    ];
    files.extend(chart::of(table)?.map(|picture| (dated("svg"), picture)));
    let mut written = Vec::new();
    for (path, content) in files {
        std::fs::write(&path, content).with_context(|| format!("can't write {}", path.display()))?;
        written.push(path.display().to_string());
    }
    Ok(written.join(", "))
}

struct Suite<'a> {
    args: &'a Args,
    stage: Stage,
    frames: Frames,
    bar: ProgressBar,
    rows: Vec<Row>,
}

impl Suite<'_> {
    /// One part, with the capacity for its pairs before and after it.
    fn part(&mut self, part: Part) -> Result<Table> {
        let load_average = machine::load_average();
        let started = jiff::Timestamp::now();
        let pair = match part {
            Part::Steady | Part::Burst | Part::Clients => self.frames.pair(Size::VGA, Codec::Raw),
            Part::Png => self.frames.pair(Size::VGA, Codec::Png),
            Part::Large => self.frames.pair(FOUR_MEGAPIXELS, Codec::Raw),
        }?;
        let capacity_hz = self.capacity(part, &pair)?;
        let policies = &self.args.policies;
        let own = policies.iter().filter(|policy| *policy == OWN_POLICY);
        match part {
            Part::Steady => {
                for policy in policies {
                    self.steady(policy, &pair, capacity_hz, &RAW_BUDGETS_MS)?;
                }
            }
            Part::Burst => {
                for policy in policies {
                    self.burst(policy, &pair, capacity_hz)?;
                }
            }
            Part::Clients => {
                for policy in policies {
                    self.flood(policy, &pair, capacity_hz)?;
                }
            }
            Part::Png => {
                for policy in own {
                    self.steady(policy, &pair, capacity_hz, &PNG_BUDGETS_MS)?;
                }
            }
            Part::Large => self.large(&pair, capacity_hz)?,
        }
        Ok(Table {
            rows: std::mem::take(&mut self.rows),
            capacity_hz,
            capacity_after_hz: self.capacity(part, &pair)?,
            machine: machine::describe(),
            cores: self.stage.cores.said.clone(),
            load_average,
            started,
        })
    }

    fn capacity(&self, part: Part, pair: &Bytes) -> Result<f64> {
        self.bar.set_message(format!("{}: capacity", part.name()));
        let capacity = self.stage.capacity_hz(pair, CAPACITY_SECONDS);
        capacity.with_context(|| format!("can't measure the capacity for the part `{}`", part.name()))
    }

    /// Fractions and multiples of the capacity with one policy.
    fn steady(&mut self, policy: &str, pair: &Bytes, capacity_hz: f64, budgets_ms: &[u64]) -> Result<()> {
        for (factor, share) in FACTORS {
            let load = self.load(Profile::steady(factor * capacity_hz), budgets_ms);
            let until = self.until(policy, factor, share)?;
            let name = format!("{factor:.1} C");
            self.trial(name, policy, pair, &load, until, |_, _| Further::Load { factor })?;
        }
        Ok(())
    }

    fn burst(&mut self, policy: &str, raw: &Bytes, capacity_hz: f64) -> Result<()> {
        let stretch = |factor: f64| Stretch {
            seconds: BURST_SECONDS,
            rate_hz: factor * capacity_hz,
        };
        let profile = Profile(vec![stretch(QUIET), stretch(BURST), stretch(QUIET)]);
        let load = self.load(profile, &RAW_BUDGETS_MS);
        let until = Until::exactly(Duration::from_secs_f64(3.0 * BURST_SECONDS));
        let end = Duration::from_secs_f64(2.0 * BURST_SECONDS);
        let name = format!("{QUIET} C, {BURST:.0} C for {BURST_SECONDS:.0} s, {QUIET} C");
        self.trial(name, policy, raw, &load, until, |_, records| Further::Burst {
            recovery: recovery(records, end),
            timeline: chart::timeline(records),
        })
    }

    /// All clients at their share, then the first one at ten times that.
    fn flood(&mut self, policy: &str, raw: &Bytes, capacity_hz: f64) -> Result<()> {
        let share_hz = QUIET * capacity_hz / CLIENTS as f64;
        let mut others_before = 0.0;
        for flood in [1.0, FLOOD] {
            let total_hz = share_hz * (flood + (CLIENTS - 1) as f64);
            let mut load = self.load(Profile::steady(total_hz), &RAW_BUDGETS_MS);
            load.weights[0] = flood;
            let seconds = match policy {
                OWN_POLICY => self.args.seconds,
                _ => RIVAL_SECONDS,
            };
            let until = Until::exactly(Duration::from_secs_f64(seconds));
            let name = if flood > 1.0 {
                format!("one of {CLIENTS} clients at {FLOOD:.0} x its share")
            } else {
                format!("{CLIENTS} clients at their share ({QUIET} C)")
            };
            self.trial(name, policy, raw, &load, until, |figures, _| Further::Clients {
                lost: (flood > 1.0).then(|| others_before - figures.others()),
                fairness: figures.fairness(),
            })?;
            others_before = self.rows.last().map_or(0.0, |row| row.figures.others());
        }
        Ok(())
    }

    /// More large images than there is memory for, if nothing bounds it.
    fn large(&mut self, pair: &Bytes, capacity_hz: f64) -> Result<()> {
        let load = self.load(Profile::steady(LARGE * capacity_hz), &[1000]);
        let until = Until::exactly(Duration::from_secs_f64(self.args.seconds));
        let name = format!("{LARGE:.0} C, budget 1 s");
        self.trial(name, OWN_POLICY, pair, &load, until, |_, _| Further::Nothing)
    }

    fn load(&self, profile: Profile, budgets_ms: &[u64]) -> Load {
        Load {
            process: Process::Poisson,
            profile,
            weights: vec![1.0; CLIENTS],
            budgets: budgets_ms.iter().map(|&ms| Duration::from_millis(ms)).collect(),
            seed: self.args.seed,
        }
    }

    /// Below saturation, a run goes on until it is certain whether the share is attained.
    fn until(&self, policy: &str, factor: f64, share: f64) -> Result<Until> {
        if policy != OWN_POLICY {
            return Ok(Until::exactly(Duration::from_secs_f64(RIVAL_SECONDS)));
        }
        let least = Duration::try_from_secs_f64(self.args.seconds)?;
        let most = if factor > 1.0 {
            least
        } else {
            least.max(Duration::try_from_secs_f64(self.args.max_seconds)?)
        };
        Ok(Until { least, most, share })
    }

    fn trial(
        &mut self,
        name: String,
        policy: &str,
        pair: &Bytes,
        load: &Load,
        until: Until,
        further: impl FnOnce(&Figures, &[crate::record::Record]) -> Further,
    ) -> Result<()> {
        self.bar.set_message(format!("{name}, {policy}"));
        let trial = Trial {
            policy,
            pair,
            load,
            until,
        };
        let trialled = self
            .stage
            .run(&trial)
            .with_context(|| format!("{name} with the policy {policy}"))?;
        let figures = Figures::of(&trialled.run);
        self.rows.push(Row {
            further: further(&figures, &trialled.run.records),
            name,
            policy: policy.to_owned(),
            figures,
            memory_peak_bytes: trialled.memory_peak_bytes,
        });
        Ok(())
    }
}
