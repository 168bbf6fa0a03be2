//! `cargo load`: an open-loop load generator for stereod.
//!
//! ```text
//! arrivals (rate 1) -> plan (rates, cameras, budgets) -> pacer -> exchange (HTTP) -> record -> figures -> verdict or table
//! ```
//!
//! Frames are sent when they are due, whatever became of the earlier ones, and their latency counts from the moment they
//! were due: a server that stalls can't hide it by holding up its load (coordinated omission).

mod args;
mod arrivals;
mod chart;
mod cores;
mod csv;
mod exchange;
mod figures;
mod frames;
mod generator;
mod pacer;
mod plan;
mod record;
mod rejections;
mod scenario;
mod soak;
mod statistics;
mod suite;
mod table;
mod verdict;
mod zenoh;

use std::io::IsTerminal;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use clap::Parser;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use stereo_client::Client;
use stereo_tests::process::Stereod;

use crate::args::{Args, Arrivals};
use crate::arrivals::Process;
use crate::exchange::Exchange;
use crate::figures::Figures;
use crate::frames::Frames;
use crate::generator::{Generator, Until, millis};
use crate::scenario::{OWN_POLICY, Stage};

/// How long a server that was just started may take until it is ready.
const STARTED_WITHIN: Duration = Duration::from_secs(60);
/// How long one that is said to run may take to say that it is ready.
const READY_WITHIN: Duration = Duration::from_secs(5);
/// The exit code of a load that was not carried.
const NOT_KEPT: u8 = 2;

fn main() -> Result<ExitCode> {
    let args = Args::parse();
    args.check()?;
    match args.suite {
        Some(args::Suite::Overload) => suite::run(&args).map(|()| ExitCode::SUCCESS),
        Some(args::Suite::RoundTrips) => zenoh::round_trips(&args).map(|()| ExitCode::SUCCESS),
        Some(args::Suite::Cameras) => zenoh::cameras(&args).map(|()| ExitCode::SUCCESS),
        Some(args::Suite::Takeovers) => zenoh::takeovers(&args).map(|()| ExitCode::SUCCESS),
        Some(args::Suite::Soak) => soak::run(&args),
        Some(args::Suite::Rejections) => rejections::run(&args),
        None => one(&args),
    }
}

/// One load on one server, and the verdict.
#[expect(clippy::print_stdout, reason = "the verdict is what this program is for")]
fn one(args: &Args) -> Result<ExitCode> {
    let started = match args.server {
        Some(_) => None,
        None => Some(launch(args)?),
    };
    let url = started.as_ref().map(Stereod::url).or(args.server.as_deref());
    let url = url.context("there is no server")?;
    if started.is_none() {
        wait_until_ready(url, READY_WITHIN)?;
    }
    let pair = Frames::render(args.size).pair(args.size, args.codec)?;
    let exchange = Exchange::new(url, pair, args.cameras, args.preset)?;
    let generator = Generator::new(exchange, args.max_in_flight)?;
    let run = match args.arrivals {
        Arrivals::Open(process) => {
            let length = |seconds| Duration::try_from_secs_f64(seconds + args.burst_seconds());
            let least = length(args.seconds)?;
            let until = Until {
                least,
                most: length(args.max_seconds)?.max(least),
                share: args.attain,
            };
            let bar = progress_bar(millis(until.most), "{bar:30} {elapsed}, at most {msg}")?;
            bar.set_message(format!("{:.0} s", until.most.as_secs_f64()));
            bar.enable_steady_tick(Duration::from_millis(500));
            let run = generator.open(&args.load(process), until, &bar);
            bar.finish_and_clear();
            run
        }
        Arrivals::Closed(count) => {
            let length = Duration::from_secs_f64(args.seconds);
            generator.closed(count, &args.load(Process::Poisson), |now, _| now >= length)
        }
    };
    if let Some(path) = &args.records {
        std::fs::write(path, csv::of_records(&run.records))
            .with_context(|| format!("can't write {}", path.display()))?;
    }
    let figures = Figures::of(&run);
    ensure!(
        figures.answered + figures.expired > 0 || !figures.refused.is_empty(),
        "{url} answered nothing: {}",
        figures
            .broken
            .keys()
            .next()
            .map_or("no frame was due", String::as_str)
    );
    // Closed-loop there is nothing to keep: the rate is what comes out.
    let attain = matches!(args.arrivals, Arrivals::Open(_)).then_some(args.attain);
    let verdict = verdict::judge(&figures, attain, &described(args), run.length);
    println!("{}", verdict.text);
    if let Some(server) = started {
        server.stop()?;
    }
    Ok(if verdict.is_kept {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(NOT_KEPT)
    })
}

/// A server of its own policy on its own cores, ready.
fn launch(args: &Args) -> Result<Stereod> {
    Stage::new(args).start(OWN_POLICY)
}

/// The load in a few words.
fn described(args: &Args) -> String {
    let budgets: Vec<String> = args.budgets.iter().map(f64::to_string).collect();
    let arrivals = match args.arrivals {
        Arrivals::Open(Process::Fleet) => format!("at {} Hz", args.rate),
        Arrivals::Open(Process::Poisson) => format!("at {} Hz in the mean, at random", args.rate),
        Arrivals::Open(Process::Gamma { cv }) => {
            format!("at {} Hz in the mean, in bursts (CV {cv})", args.rate)
        }
        Arrivals::Closed(count) => format!("with always {count} frames under way"),
    };
    let plural = if args.cameras == 1 { "" } else { "s" };
    let codec = format!("{:?}", args.codec).to_lowercase();
    format!(
        "{} camera{plural} {arrivals}, {} {codec} pairs, budget {} ms",
        args.cameras,
        args.size,
        budgets.join(" / ")
    )
}

/// Waits until the server at `url` takes frames.
fn wait_until_ready(url: &str, within: Duration) -> Result<()> {
    let client = Client::new(url)?;
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("can't start a runtime")?
        .block_on(client.ready(within))?;
    Ok(())
}

/// A bar on a terminal, nothing elsewhere.
fn progress_bar(length: u64, template: &str) -> Result<ProgressBar> {
    let target = if std::io::stderr().is_terminal() {
        ProgressDrawTarget::stderr()
    } else {
        ProgressDrawTarget::hidden()
    };
    let bar = ProgressBar::with_draw_target(Some(length), target);
    bar.set_style(ProgressStyle::with_template(template)?);
    Ok(bar)
}
