//! One load on a fresh server that is started for it.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Result;
use bytes::Bytes;
use indicatif::ProgressBar;
use stereo_tests::process::{Launch, Stereod};

use crate::args::{Args, Preset};
use crate::arrivals::Process;
use crate::cores::Cores;
use crate::exchange::Exchange;
use crate::generator::{Generator, Run, Until};
use crate::plan::{Load, Profile};
use crate::{STARTED_WITHIN, wait_until_ready};

/// The policy that a server has without being told.
pub(crate) const OWN_POLICY: &str = "edf";
/// A budget that never cuts a rung.
const AMPLE: Duration = Duration::from_secs(60);
/// Frames under way when a capacity is measured: one is worked on while the other comes and goes.
const SATURATING: usize = 2;
/// Answers that teach a fresh server what its work costs, and the longest that may take.
const LEARNING: (usize, Duration) = (60, Duration::from_secs(10));
/// Measurements of a capacity; the median counts.
const REPEATS: usize = 3;

/// Where and how servers are started and loaded.
pub(crate) struct Stage {
    /// Who runs on which cores.
    pub(crate) cores: Cores,
    program: Option<PathBuf>,
    preset: Preset,
    max_in_flight: usize,
}

/// A load for a fresh server.
pub(crate) struct Trial<'a> {
    /// The server's policy.
    pub(crate) policy: &'a str,
    /// The pair that is sent.
    pub(crate) pair: &'a Bytes,
    /// What arrives when.
    pub(crate) load: &'a Load,
    /// For how long.
    pub(crate) until: Until,
}

/// What came of it.
pub(crate) struct Trialled {
    /// The run.
    pub(crate) run: Run,
    /// The server's largest memory, in bytes.
    pub(crate) memory_peak_bytes: Option<u64>,
}

impl Stage {
    /// A stage as the flags want it. Call it before any thread is started.
    pub(crate) fn new(args: &Args) -> Self {
        Self {
            cores: Cores::split(),
            program: args.stereod.clone(),
            preset: args.preset,
            max_in_flight: args.max_in_flight,
        }
    }

    /// Starts a server, lets it learn its costs, loads it, and stops it.
    ///
    /// # Errors
    /// If the server doesn't start, answers nothing, or doesn't stop cleanly.
    pub(crate) fn run(&self, trial: &Trial<'_>) -> Result<Trialled> {
        let server = self.start(trial.policy)?;
        let cameras = trial.load.weights.len();
        let generator = self.generator(&server, trial.pair, cameras)?;
        let learning = steady(cameras);
        generator.closed(SATURATING, &learning, |now, answers| {
            answers >= LEARNING.0 || now >= LEARNING.1
        });
        let run = generator.open(trial.load, trial.until, &ProgressBar::hidden());
        let memory_peak_bytes = server.memory_peak_bytes();
        drop(generator);
        stop(server)?;
        Ok(Trialled {
            run,
            memory_peak_bytes,
        })
    }

    /// Frames a second that a server of its own policy does at full quality, closed-loop; `seconds` in all.
    ///
    /// # Errors
    /// If the server doesn't start, or any frame isn't answered at full quality.
    pub(crate) fn capacity_hz(&self, pair: &Bytes, seconds: f64) -> Result<f64> {
        let server = self.start(OWN_POLICY)?;
        let generator = self.generator(&server, pair, 1)?;
        let length = Duration::from_secs_f64(seconds / REPEATS as f64);
        let measure = || -> Result<f64> {
            let run = generator.closed(SATURATING, &steady(1), |now, _| now >= length);
            let figures = crate::figures::Figures::of(&run);
            anyhow::ensure!(
                figures.answered == figures.offered && figures.rungs > 0.999,
                "capacity is that at full quality, but of {} frames {} were answered, with {:.1} % of the rungs: {:?}",
                figures.offered,
                figures.answered,
                100.0 * figures.rungs,
                figures.broken
            );
            Ok(figures.answered as f64 / run.length.as_secs_f64())
        };
        generator.closed(SATURATING, &steady(1), |now, answers| {
            answers >= LEARNING.0 || now >= LEARNING.1
        });
        let mut rates = (0..REPEATS).map(|_| measure()).collect::<Result<Vec<f64>>>()?;
        rates.sort_by(f64::total_cmp);
        drop(generator);
        stop(server)?;
        Ok(rates[REPEATS / 2])
    }

    /// Starts a server and waits until it is ready and its threads are where they belong.
    ///
    /// # Errors
    /// If the server doesn't start or can't be moved.
    pub(crate) fn start(&self, policy: &str) -> Result<Stereod> {
        let mut args = vec!["--workers", "1"];
        if policy != OWN_POLICY {
            args.extend(["--policy", policy]);
        }
        let server = Stereod::launch(&Launch {
            program: self.program.as_deref(),
            cores: self.cores.network.as_deref(),
            args: &args,
            ..Launch::default()
        })?;
        wait_until_ready(server.url(), STARTED_WITHIN)?;
        if let Some(cores) = &self.cores.worker {
            server.pin_workers(cores)?;
        }
        Ok(server)
    }

    fn generator(&self, server: &Stereod, pair: &Bytes, cameras: usize) -> Result<Generator> {
        let exchange = Exchange::new(server.url(), pair.clone(), u16::try_from(cameras)?, self.preset)?;
        Generator::new(exchange, self.max_in_flight)
    }
}

/// Frames of all cameras with all the time in the world.
fn steady(cameras: usize) -> Load {
    Load {
        process: Process::Poisson,
        profile: Profile::steady(1.0),
        weights: vec![1.0; cameras],
        budgets: vec![AMPLE],
        seed: 0,
    }
}

fn stop(server: Stereod) -> Result<()> {
    let status = server.stop()?;
    anyhow::ensure!(status.success(), "the server ended with {status}");
    Ok(())
}
