//! `hostile`: throws bad input at every decoder and says what it cost; `hostile --write-corpus` makes the good input it starts from.
#![forbid(unsafe_code)]
#![expect(clippy::print_stdout, reason = "a program whose output is a table")]

use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use clap::Parser;
use stereo_hostile::mutate::Mutator;
use stereo_hostile::{TARGETS, Target, corpus};

/// No input may take longer.
const SLOWEST: Duration = Duration::from_millis(100);
/// Memory may differ by this much between the first tenth of the inputs and all of them, in KiB.
const GROWTH_KIB: u64 = 16 << 10;
/// An input is slow if it is every time: anything takes long once on a busy machine.
const TRIES: usize = 4;

/// Throws bad input at every decoder of stereod: fails on a panic, on an input that takes over 100 ms, and on memory that grows.
#[derive(Debug, Parser)]
struct Args {
    /// Inputs in all.
    #[arg(long, default_value_t = 1_000_000)]
    inputs: usize,
    /// Other inputs for another number.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// One decoder alone.
    #[arg(long)]
    only: Option<String>,
    /// Where inputs are put that made a decoder fail.
    #[arg(long, default_value = "target/hostile")]
    found: PathBuf,
    /// Make the first files of fuzz/corpus anew, and do nothing else.
    #[arg(long)]
    write_corpus: bool,
}

/// What one decoder did.
struct Row {
    accepted: usize,
    took: Duration,
    slowest: Duration,
    growth_kib: u64,
    faults: usize,
}

fn main() -> Result<ExitCode> {
    let args = Args::parse();
    if args.write_corpus {
        corpus::write()?;
        return Ok(ExitCode::SUCCESS);
    }
    let chosen = |target: &&Target| args.only.as_ref().is_none_or(|only| only == target.name);
    let targets = Vec::from_iter(TARGETS.iter().filter(chosen));
    ensure!(!targets.is_empty(), "there is no such decoder");
    println!("| decoder | inputs | accepted | a second | slowest ms | growth MiB | faults |");
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    let mut is_good = true;
    let inputs = args.inputs / targets.len();
    for target in targets {
        let row = run(target, inputs, &args).with_context(|| target.name)?;
        println!(
            "| `{}` | {inputs} | {:.1} % | {:.0} | {:.1} | {:.1} | {} |",
            target.name,
            row.accepted as f64 / inputs as f64 * 100.0,
            inputs as f64 / row.took.as_secs_f64(),
            row.slowest.as_secs_f64() * 1e3,
            row.growth_kib as f64 / 1024.0,
            row.faults,
        );
        is_good &= row.faults == 0 && row.slowest <= SLOWEST && row.growth_kib <= GROWTH_KIB;
    }
    Ok(if is_good {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

fn run(target: &Target, inputs: usize, args: &Args) -> Result<Row> {
    let corpus = Vec::from_iter(corpus::files(target.name)?.into_iter().map(|(_, bytes)| bytes));
    let mut mutator = Mutator::new(args.seed);
    let mut row = Row {
        accepted: 0,
        took: Duration::ZERO,
        slowest: Duration::ZERO,
        growth_kib: 0,
        faults: 0,
    };
    let mut early = resident_kib()?;
    for index in 0..inputs {
        if index == inputs / 10 {
            early = resident_kib()?;
        }
        let input = mutator.changed(&corpus);
        let started = Instant::now();
        match catch_unwind(AssertUnwindSafe(|| (target.run)(&input))) {
            Ok(is_accepted) => row.accepted += usize::from(is_accepted),
            Err(_) => {
                row.faults += 1;
                keep(&input, target, args)?;
            }
        }
        let took = started.elapsed();
        row.took += took;
        let took = match took > SLOWEST {
            true => least(target, &input, took),
            false => took,
        };
        if took > SLOWEST {
            keep(&input, target, args)?;
        }
        row.slowest = row.slowest.max(took);
    }
    row.growth_kib = resident_kib()?.saturating_sub(early);
    Ok(row)
}

/// The least time of several tries.
fn least(target: &Target, input: &[u8], first: Duration) -> Duration {
    (1..TRIES).fold(first, |least, _| {
        let started = Instant::now();
        // That it panics has been counted.
        drop(catch_unwind(AssertUnwindSafe(|| (target.run)(input))));
        least.min(started.elapsed())
    })
}

/// Puts an input where it can be looked at.
fn keep(input: &[u8], target: &Target, args: &Args) -> Result<()> {
    let mut hasher = DefaultHasher::new();
    input.hash(&mut hasher);
    fs::create_dir_all(&args.found)?;
    let path = args
        .found
        .join(format!("{}-{:016x}", target.name, hasher.finish()));
    println!("a fault, or slow: {}", path.display());
    Ok(fs::write(path, input)?)
}

/// Memory that this process has now, in KiB.
fn resident_kib() -> Result<u64> {
    let status = fs::read_to_string("/proc/self/status").context("memory can be measured on Linux alone")?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let number = line.and_then(|line| line.trim().split(' ').next());
    Ok(number.context("no VmRSS")?.parse()?)
}
