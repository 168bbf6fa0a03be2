//! The values that flags take.

use std::str::FromStr;

use anyhow::{Context, Result, ensure};
use clap::ValueEnum;
use stereo_client::v1;

use crate::arrivals::Process;

/// The series of loads there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Suite {
    /// Capacity, then 0.8 to 4 times that, a burst of 5 times, one client at 10 times its share, 8 times in 4-megapixel pairs.
    Overload,
    /// Round trips over Zenoh beside HTTP.
    RoundTrips,
    /// Eight cameras of 30 Hz over Zenoh for `--seconds` each, their phases spread and all at once.
    Cameras,
    /// How long a camera is without results when a server or a Zenoh router fails.
    Takeovers,
    /// Mixed load over HTTP and Zenoh for `--seconds`: fails if anything grows or gets worse.
    Soak,
    /// How long hostile input takes to be refused: fails if that is 5 ms or more at the 99th percentile.
    Rejections,
}

/// A part of the suite.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
pub(crate) enum Part {
    /// 0.8, 1, 2 and 4 times the capacity, with every policy.
    Steady,
    /// Five times the capacity for five seconds.
    Burst,
    /// One client at ten times its share.
    Clients,
    /// PNG pairs.
    Png,
    /// 4-megapixel pairs at eight times their capacity.
    Large,
}

impl Part {
    /// Its name on the command line and in files.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Steady => "steady",
            Self::Burst => "burst",
            Self::Clients => "clients",
            Self::Png => "png",
            Self::Large => "large",
        }
    }
}

/// How images are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Codec {
    /// 8-bit gray pixels.
    Raw,
    /// PNG files.
    Png,
    /// JPEG files.
    Jpeg,
}

/// The algorithm's parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Preset {
    /// The server's best.
    Default,
    /// The fastest useful one.
    Fast,
    /// The published algorithm.
    Paper,
}

impl Preset {
    /// As the wire has it.
    pub(crate) fn on_the_wire(self) -> v1::Preset {
        match self {
            Self::Default => v1::Preset::Default,
            Self::Fast => v1::Preset::Fast,
            Self::Paper => v1::Preset::Paper,
        }
    }
}

/// When frames are due.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Arrivals {
    /// At their own times.
    Open(Process),
    /// When an earlier one has been answered; the number that is under way.
    Closed(usize),
}

impl FromStr for Arrivals {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> Result<Self> {
        let (name, number) = text.split_once(':').unwrap_or((text, ""));
        let unknown = || format!("expected fleet, poisson, gamma:CV or closed:N, got `{text}`");
        match name {
            "fleet" if number.is_empty() => Ok(Self::Open(Process::Fleet)),
            "poisson" if number.is_empty() => Ok(Self::Open(Process::Poisson)),
            "gamma" => {
                let cv: f64 = number.parse().with_context(unknown)?;
                ensure!(
                    (0.1..=20.0).contains(&cv),
                    "the coefficient of variation must be 0.1 to 20, got {cv}"
                );
                Ok(Self::Open(Process::Gamma { cv }))
            }
            "closed" => {
                let count = number.parse().with_context(unknown)?;
                ensure!(
                    (1..=1000).contains(&count),
                    "closed:N takes 1 to 1000, got {count}"
                );
                Ok(Self::Closed(count))
            }
            _ => anyhow::bail!(unknown()),
        }
    }
}

/// A stretch with a higher rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Burst {
    /// Times the rate before and after.
    pub(crate) factor: f64,
    /// How long.
    pub(crate) seconds: f64,
}

impl FromStr for Burst {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> Result<Self> {
        let expected = || format!("expected FACTOR:SECONDS such as 5:5, got `{text}`");
        let (factor, seconds) = text.split_once(':').with_context(expected)?;
        let burst = Self {
            factor: factor.parse().with_context(expected)?,
            seconds: seconds.parse().with_context(expected)?,
        };
        ensure!(
            (0.01..=1000.0).contains(&burst.factor),
            "a burst's factor must be 0.01 to 1000, got {factor}"
        );
        ensure!(
            (0.01..=3600.0).contains(&burst.seconds),
            "a burst must last 0.01 to 3600 s, got {seconds}"
        );
        Ok(burst)
    }
}

/// Size of an image in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Size {
    pub(crate) width_px: usize,
    pub(crate) height_px: usize,
}

impl Size {
    /// The size that capacities are measured at.
    pub(crate) const VGA: Self = Self {
        width_px: 640,
        height_px: 480,
    };
}

impl std::fmt::Display for Size {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} x {} px", self.width_px, self.height_px)
    }
}

impl FromStr for Size {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> Result<Self> {
        let expected = || format!("expected WIDTHxHEIGHT such as 640x480, got `{text}`");
        let (width, height) = text.split_once('x').with_context(expected)?;
        let side = |side: &str| -> Result<usize> {
            let px = side.parse().with_context(expected)?;
            ensure!(
                (32..=4096).contains(&px),
                "a side must be 32 to 4096 px, got {px}"
            );
            Ok(px)
        };
        Ok(Self {
            width_px: side(width)?,
            height_px: side(height)?,
        })
    }
}
