//! The series of loads: capacity, then fractions and multiples of it, with the server's own policy and its rivals.

use std::time::Duration;

use anyhow::{Context, Result};
use bytes::Bytes;
use indicatif::ProgressBar;
use stereo_tests::{machine, readme};

use crate::args::{Args, Codec, Size};
use crate::arrivals::Process;
use crate::figures::{Figures, recovery};
use crate::frames::Frames;
use crate::generator::Until;
use crate::plan::{Load, Profile, Stretch};
use crate::scenario::{OWN_POLICY, Stage, Trial};
use crate::table::{Further, Row, Table};
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

/// Runs everything, prints the table, and writes the files.
#[expect(clippy::print_stdout, reason = "the table is what this program is for")]
pub(crate) fn run(args: &Args) -> Result<()> {
    let before = machine::load_average();
    let stage = Stage::new(args);
    let trials = args.policies.len() * (FACTORS.len() + 3) + FACTORS.len() + 5;
    let bar = progress_bar(trials as u64, "{bar:30} {pos}/{len} {elapsed}  {msg}")?;
    bar.enable_steady_tick(Duration::from_millis(500));
    let mut suite = Suite {
        args,
        stage,
        frames: Frames::render(Size::VGA),
        bar,
        rows: Vec::new(),
    };
    let raw = suite.frames.pair(Size::VGA, Codec::Raw)?;
    let capacity_hz = suite.capacity("raw", &raw)?;
    for policy in &args.policies {
        suite.policy(policy, &raw, capacity_hz)?;
    }
    let own = args.policies.iter().any(|policy| policy == OWN_POLICY);
    if own {
        suite.png()?;
        suite.large()?;
    }
    let capacity_after_hz = suite.capacity("raw, again", &raw)?;
    suite.bar.finish_and_clear();
    let table = Table {
        rows: suite.rows,
        capacity_hz,
        capacity_after_hz,
        machine: machine::describe(),
        cores: suite.stage.cores.said.clone(),
        load_average: before,
    };
    let text = table.markdown();
    println!("{text}");
    let written = write(args, &table)?;
    println!("Written: {written}");
    if let Some(path) = &args.write {
        readme::write_table(path, "load", &text)?;
    }
    Ok(())
}

fn write(args: &Args, table: &Table) -> Result<String> {
    std::fs::create_dir_all(&args.out).with_context(|| format!("can't make {}", args.out.display()))?;
    // To the second, and without the colons that some file systems refuse.
    let now = jiff::Timestamp::now().strftime("%Y-%m-%dT%H%M%SZ").to_string();
    let mut written = Vec::new();
    for (ending, content) in [("csv", csv::of(table, &now)), ("svg", chart::of(table)?)] {
        let path = args.out.join(format!("{now}-overload.{ending}"));
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
    fn capacity(&self, what: &str, pair: &Bytes) -> Result<f64> {
        self.bar.set_message(format!("capacity, {what}"));
        let capacity = self.stage.capacity_hz(pair, self.args.seconds);
        self.bar.inc(1);
        capacity.with_context(|| format!("can't measure the capacity for {what} pairs"))
    }

    /// Every load with one policy.
    fn policy(&mut self, policy: &str, raw: &Bytes, capacity_hz: f64) -> Result<()> {
        for (factor, share) in FACTORS {
            let load = self.load(Profile::steady(factor * capacity_hz), &RAW_BUDGETS_MS);
            let until = self.until(factor, share)?;
            let name = format!("{factor:.1} C");
            self.trial(name, policy, raw, &load, until, |_, _| Further::Load { factor })?;
        }
        self.burst(policy, raw, capacity_hz)?;
        self.flood(policy, raw, capacity_hz)
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
            let until = Until::exactly(Duration::from_secs_f64(self.args.seconds));
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

    /// PNG pairs with the server's own policy.
    fn png(&mut self) -> Result<()> {
        let png = self.frames.pair(Size::VGA, Codec::Png)?;
        let capacity_hz = self.capacity("PNG", &png)?;
        for (factor, share) in FACTORS {
            let load = self.load(Profile::steady(factor * capacity_hz), &PNG_BUDGETS_MS);
            let until = self.until(factor, share)?;
            let name = format!("PNG, {factor:.1} C of {capacity_hz:.1} /s");
            self.trial(name, OWN_POLICY, &png, &load, until, |_, _| Further::Nothing)?;
        }
        Ok(())
    }

    /// More large images than there is memory for, if nothing bounds it.
    fn large(&mut self) -> Result<()> {
        let pair = self.frames.pair(FOUR_MEGAPIXELS, Codec::Raw)?;
        let capacity_hz = self.capacity("4-megapixel", &pair)?;
        let load = self.load(Profile::steady(LARGE * capacity_hz), &[1000]);
        let until = Until::exactly(Duration::from_secs_f64(self.args.seconds));
        let name = format!("{FOUR_MEGAPIXELS}, {LARGE:.0} C of {capacity_hz:.1} /s, budget 1 s");
        self.trial(name, OWN_POLICY, &pair, &load, until, |_, _| Further::Nothing)
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
    fn until(&self, factor: f64, share: f64) -> Result<Until> {
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
        self.bar.inc(1);
        Ok(())
    }
}
