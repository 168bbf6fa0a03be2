//! The command line.

mod values;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Result, ensure};
use clap::Parser;

use crate::arrivals::Process;
use crate::plan::{Load, Profile, Stretch};

pub(crate) use values::{Arrivals, Burst, Codec, Part, Preset, Size, Suite};

/// Two minutes to warm up, and one to look at.
const LEAST_SOAK_SECONDS: f64 = 180.0;

/// An open-loop load generator for stereod: how much can this server take within its budgets?
///
/// Frames are sent when they are due, whether or not earlier ones were answered, and their latency counts from the moment
/// they were due. `load --cameras 8 --rate 30 --budget 50 --server http://host:8080` says whether that server carries
/// eight cameras; `load --suite overload` measures the one built here from 0.8 to 8 times its capacity.
#[derive(Debug, Clone, Parser)]
#[command(name = "load")]
pub(crate) struct Args {
    /// Server to load, such as http://127.0.0.1:8080. Absent: the release build is started on this machine.
    #[arg(long, value_name = "URL", conflicts_with = "suite")]
    pub(crate) server: Option<String>,
    /// Runs a series of loads against servers started here, and writes table, CSV and SVG.
    #[arg(long)]
    pub(crate) suite: Option<Suite>,

    /// Cameras, each a client of its own.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=10_000), help_heading = "What is sent")]
    pub(crate) cameras: u16,
    /// Frames of each camera in a second.
    #[arg(
        long,
        value_name = "HZ",
        default_value_t = 30.0,
        help_heading = "What is sent"
    )]
    pub(crate) rate: f64,
    /// When frames are due: fleet (periodic, each camera with its own phase), poisson, gamma:CV (bursts as strong as the
    /// coefficient of variation says), or closed:N (N frames always under way; finds the capacity).
    #[arg(long, default_value = "fleet", help_heading = "What is sent")]
    pub(crate) arrivals: Arrivals,
    /// Latency budgets in ms, mixed evenly (a fleet's cameras keep theirs).
    #[arg(
        long,
        visible_alias = "budget",
        allow_negative_numbers = true,
        value_name = "MS",
        value_delimiter = ',',
        default_value = "100",
        help_heading = "What is sent"
    )]
    pub(crate) budgets: Vec<f64>,
    /// Relative rates of the cameras, such as 10,1,1,1 (not with a fleet, whose cameras are alike).
    #[arg(
        long,
        value_name = "SHARE",
        value_delimiter = ',',
        help_heading = "What is sent"
    )]
    pub(crate) weights: Vec<f64>,
    /// A burst in the middle: so many times the rate for so many seconds.
    #[arg(long, value_name = "FACTOR:SECONDS", help_heading = "What is sent")]
    pub(crate) burst: Option<Burst>,
    /// Size of the images in pixels.
    #[arg(
        long,
        value_name = "WIDTHxHEIGHT",
        default_value = "640x480",
        help_heading = "What is sent"
    )]
    pub(crate) size: Size,
    /// How the images are sent, in protobuf messages.
    #[arg(long, default_value = "raw", help_heading = "What is sent")]
    pub(crate) codec: Codec,
    /// The algorithm's parameters.
    #[arg(long, default_value = "default", help_heading = "What is sent")]
    pub(crate) preset: Preset,
    /// Which arrivals: the same number gives the same ones.
    #[arg(long, default_value_t = 1, help_heading = "What is sent")]
    pub(crate) seed: u64,

    /// Least seconds of a run.
    #[arg(long, default_value_t = 10.0, help_heading = "How long and how sure")]
    pub(crate) seconds: f64,
    /// Most seconds of a run: it goes on until the verdict is certain or this is over.
    #[arg(long, default_value_t = 30.0, help_heading = "How long and how sure")]
    pub(crate) max_seconds: f64,
    /// Share of the offered frames that has to be answered within its budget, above 0 and below 1.
    #[arg(
        long,
        value_name = "SHARE",
        default_value_t = 0.99,
        help_heading = "How long and how sure"
    )]
    pub(crate) attain: f64,
    /// Frames under way at most; what is due beyond that counts as not sent.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1000,
        help_heading = "How long and how sure"
    )]
    pub(crate) max_in_flight: usize,

    /// Writes every frame with what became of it as CSV.
    #[arg(
        long,
        value_name = "FILE",
        conflicts_with = "suite",
        help_heading = "How long and how sure"
    )]
    pub(crate) records: Option<PathBuf>,

    /// Parts of the suite to run; the table is put together from the last run of each.
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "steady,burst,clients,png,large",
        requires = "suite",
        help_heading = "Servers started here"
    )]
    pub(crate) only: Vec<Part>,
    /// Scheduling policies to run in turn: edf is the server's own, the others are its rivals.
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "edf,fifo,fifo-timeout,fixed:2",
        help_heading = "Servers started here"
    )]
    pub(crate) policies: Vec<String>,
    /// Workers of the server that the suites `round-trips` and `cameras` start.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1,
        value_parser = clap::value_parser!(u16).range(1..=256),
        requires = "suite",
        help_heading = "Servers started here"
    )]
    pub(crate) workers: u16,
    /// Server program to start instead of the one built here.
    #[arg(long, value_name = "PROGRAM", help_heading = "Servers started here")]
    pub(crate) stereod: Option<PathBuf>,
    /// Folder for CSV and SVG; made if it doesn't exist.
    #[arg(long, default_value = "out/load", help_heading = "Servers started here")]
    pub(crate) out: PathBuf,
    /// Puts the suite's table between its markers in this Markdown file, such as `load:begin` and `load:end`.
    #[arg(
        long,
        value_name = "FILE",
        requires = "suite",
        help_heading = "Servers started here"
    )]
    pub(crate) write: Option<PathBuf>,
}

impl Args {
    /// Checks what the parser can't.
    ///
    /// # Errors
    /// Naming the flag, what it takes and what it got.
    pub(crate) fn check(&self) -> Result<()> {
        ensure!(
            self.rate > 0.0 && self.rate <= 10_000.0,
            "--rate must be above 0 and up to 10000, got {}",
            self.rate
        );
        ensure!(
            (1.0..=100_000.0).contains(&self.total_hz()) || self.total_hz() > 0.0 && self.total_hz() < 1.0,
            "cameras x rate must be up to 100000 frames a second, got {}",
            self.total_hz()
        );
        for &budget in &self.budgets {
            ensure!(
                budget > 0.0 && budget <= 60_000.0,
                "a budget must be above 0 and up to 60000 ms, got {budget}"
            );
        }
        ensure!(
            self.seconds > 0.0 && self.seconds <= 3600.0,
            "--seconds must be above 0 and up to 3600, got {}",
            self.seconds
        );
        ensure!(
            self.max_seconds.is_finite() && self.max_seconds <= 86_400.0,
            "--max-seconds must be up to 86400, got {}",
            self.max_seconds
        );
        ensure!(
            self.attain > 0.0 && self.attain < 1.0,
            "--attain must be above 0 and below 1, got {}",
            self.attain
        );
        ensure!(
            (1..=100_000).contains(&self.max_in_flight),
            "--max-in-flight must be 1 to 100000, got {}",
            self.max_in_flight
        );
        if !self.weights.is_empty() {
            ensure!(
                self.weights.len() == usize::from(self.cameras),
                "--weights needs one share for each of the {} cameras, got {}",
                self.cameras,
                self.weights.len()
            );
            ensure!(
                self.weights.iter().all(|w| *w > 0.0 && w.is_finite()),
                "every one of --weights must be above 0"
            );
            ensure!(
                self.arrivals != Arrivals::Open(Process::Fleet),
                "a fleet's cameras are alike: use --weights with --arrivals poisson or gamma:CV"
            );
        }
        if self.suite == Some(Suite::Soak) {
            ensure!(
                self.seconds >= LEAST_SOAK_SECONDS,
                "--suite soak needs --seconds {LEAST_SOAK_SECONDS} at least, 1800 to say much; got {}",
                self.seconds
            );
        }
        Ok(())
    }

    /// Frames a second of all cameras together.
    pub(crate) fn total_hz(&self) -> f64 {
        f64::from(self.cameras) * self.rate
    }

    /// The budgets as durations.
    pub(crate) fn budgets(&self) -> Vec<Duration> {
        self.budgets
            .iter()
            .map(|&ms| Duration::from_secs_f64(ms / 1e3))
            .collect()
    }

    /// The load that the flags describe.
    pub(crate) fn load(&self, process: Process) -> Load {
        let rate_hz = self.total_hz();
        let stretch = |seconds, rate_hz| Stretch { seconds, rate_hz };
        let profile = match self.burst {
            None => vec![stretch(f64::INFINITY, rate_hz)],
            Some(Burst { factor, seconds }) => vec![
                stretch(self.seconds / 2.0, rate_hz),
                stretch(seconds, rate_hz * factor),
                stretch(f64::INFINITY, rate_hz),
            ],
        };
        Load {
            process,
            profile: Profile(profile),
            weights: if self.weights.is_empty() {
                vec![1.0; usize::from(self.cameras)]
            } else {
                self.weights.clone()
            },
            budgets: self.budgets(),
            seed: self.seed,
        }
    }

    /// Seconds that a burst adds to a run.
    pub(crate) fn burst_seconds(&self) -> f64 {
        self.burst.map_or(0.0, |burst| burst.seconds)
    }
}

#[cfg(test)]
mod tests {
    use clap::{CommandFactory, Parser};

    use super::{Args, Arrivals};
    use crate::arrivals::Process;

    #[test]
    fn the_command_line_is_consistent() {
        Args::command().debug_assert();
    }

    #[test]
    fn every_value_out_of_range_is_refused_naming_it() {
        for (flags, word) in [
            (&["--rate", "0"][..], "--rate"),
            (&["--rate", "NaN"], "--rate"),
            (&["--budget", "-1"], "budget"),
            (&["--budgets", "10,60001"], "budget"),
            (&["--seconds", "inf"], "--seconds"),
            (&["--attain", "1"], "--attain"),
            (&["--suite", "soak", "--seconds", "60"], "--seconds"),
            (
                &["--cameras", "2", "--weights", "1", "--arrivals", "poisson"],
                "--weights",
            ),
            (&["--cameras", "2", "--weights", "1,2"], "fleet"),
        ] {
            let args = Args::try_parse_from([&["load"], flags].concat());
            let why = match args {
                Ok(args) => args.check().expect_err(&format!("{flags:?}")).to_string(),
                Err(why) => why.to_string(),
            };
            assert!(why.contains(word), "{flags:?}: {why}");
        }
        for bad in [
            "--size=640",
            "--size=8x8",
            "--arrivals=gamma",
            "--arrivals=closed:0",
            "--burst=5",
            "--burst=NaN:1",
            "--codec=gif",
        ] {
            assert!(Args::try_parse_from(["load", bad]).is_err(), "{bad}");
        }
    }

    #[test]
    fn arrivals_are_read_by_name() {
        assert_eq!(
            "gamma:4".parse::<Arrivals>().expect("good"),
            Arrivals::Open(Process::Gamma { cv: 4.0 })
        );
        assert_eq!("closed:2".parse::<Arrivals>().expect("good"), Arrivals::Closed(2));
    }
}
