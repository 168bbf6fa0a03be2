//! The validated configuration, one struct a subsystem. The same names are the keys of the TOML file.
//!
//! Precedence: command line, then environment (both in [`args`](crate::args)), then the file, then the defaults here.

mod clients;
mod error;
mod fault;
mod policy;
mod tls;
mod zenoh;

use std::collections::BTreeMap;
use std::net::{Ipv4Addr, SocketAddr};
use std::ops::RangeInclusive;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use stereo::{Level, Shape};

pub use self::clients::ClientConfig;
pub use self::error::ConfigError;
pub use self::fault::Fault;
pub use self::policy::PolicyName;
pub use self::tls::TlsConfig;
pub use self::zenoh::{ZenohConfig, zenoh_file};

/// Everything the server can be told.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Name of this server in reports, `[A-Za-z0-9_.-]{1,64}`.
    pub instance: String,
    /// The HTTP transport.
    pub http: HttpConfig,
    /// The threads that compute.
    pub workers: WorkersConfig,
    /// What is refused before any work is done.
    pub limits: LimitsConfig,
    /// Who may ask for what, by name; empty = anybody for anything.
    pub clients: BTreeMap<String, ClientConfig>,
    /// The Zenoh transport.
    pub zenoh: ZenohConfig,
}

/// The HTTP transport.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HttpConfig {
    /// Address and port to listen on; port 0 lets the system choose one.
    pub listen: SocketAddr,
    /// A second address, for whoever runs the server: `/metrics` is there then and no longer at the first, without TLS and without asking who
    /// it is.
    pub admin: Option<SocketAddr>,
    /// Whose certificate is shown, and whose are taken.
    pub tls: TlsConfig,
    /// Connections open at one time, 1 to 65536; more wait to be accepted.
    pub connections: u32,
    /// Time to send a request's head, and for a connection to rest between two requests, 10 to 600000 ms.
    #[serde(rename = "header_timeout_ms", with = "milliseconds")]
    pub header_timeout: Duration,
    /// Time to send a request's body, and to take its answer, 10 to 600000 ms.
    #[serde(rename = "body_timeout_ms", with = "milliseconds")]
    pub body_timeout: Duration,
}

/// The threads that compute.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorkersConfig {
    /// Number of threads, 1 to 256. Default: one less than the machine has cores, which leaves one to receive and send.
    pub count: u32,
    /// `auto`, or the name of a lower instruction-set level than the machine's best.
    pub simd: String,
    /// Requests that wait for a worker at one time, 1 to 65536; more are refused.
    pub queue_capacity: u32,
    /// How requests are ordered, admitted and ended: `edf`, or for comparison only `fifo`, `fifo-timeout` or `fixed:N`.
    pub policy: PolicyName,
    /// Whether workers that have nothing to do help with the frames of others: lower latency while the server has little to do, the
    /// same results.
    pub split_frames: bool,
    /// Time without a finished step after which a worker is given up and replaced, 100 to 600000 ms.
    #[serde(rename = "stuck_after_ms", with = "milliseconds")]
    pub stuck_after: Duration,
    /// Workers that may be replaced in the life of the process, 0 to 1024; after that the server is not ready any more.
    pub replacements: u32,
    /// A fault to have, for tests; not a key of the file.
    #[serde(skip)]
    pub fault: Option<Fault>,
}

/// What is refused before any work is done.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LimitsConfig {
    /// Size of one request's body in bytes, 1 KiB to 1 GiB.
    pub body_bytes: u64,
    /// Pixels of one image, 1024 to 16777216 (4096 x 4096).
    pub image_pixels: u64,
    /// All bodies that are being received, wait, are worked on or are being sent, in bytes; at least `body_bytes`, up to 64 GiB.
    pub bytes_in_flight: u64,
    /// The same for batches, which have a bound of their own so that they never take the others' memory; at least `body_bytes`, up to
    /// 64 GiB.
    pub batch_bytes_in_flight: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            instance: "stereod".to_owned(),
            http: HttpConfig::default(),
            workers: WorkersConfig::default(),
            limits: LimitsConfig::default(),
            clients: BTreeMap::new(),
            zenoh: ZenohConfig::default(),
        }
    }
}

impl Default for HttpConfig {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from((Ipv4Addr::LOCALHOST, 8080)),
            admin: None,
            tls: TlsConfig::default(),
            connections: 1024,
            header_timeout: Duration::from_secs(10),
            body_timeout: Duration::from_secs(30),
        }
    }
}

impl Default for WorkersConfig {
    fn default() -> Self {
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let count = u32::try_from(cores.saturating_sub(1).clamp(1, 256)).unwrap_or(1);
        Self {
            count,
            simd: "auto".to_owned(),
            queue_capacity: 64,
            policy: PolicyName::default(),
            split_frames: false,
            stuck_after: Duration::from_secs(20),
            replacements: 8,
            fault: None,
        }
    }
}

impl Default for LimitsConfig {
    fn default() -> Self {
        Self {
            body_bytes: 64 << 20,
            image_pixels: MAX_IMAGE_PIXELS,
            bytes_in_flight: 512 << 20,
            batch_bytes_in_flight: 128 << 20,
        }
    }
}

const MAX_IMAGE_PIXELS: u64 = (Shape::MAX_SIDE_PX * Shape::MAX_SIDE_PX) as u64;

impl Config {
    /// The configuration a TOML text describes; what it doesn't name has its default. Not yet validated.
    ///
    /// # Errors
    /// [`ConfigError::Malformed`] naming `path`, the line, and for an unknown key the keys there are. The line itself is not shown: it may
    /// hold a secret.
    pub fn from_toml(text: &str, path: &str) -> Result<Self, ConfigError> {
        toml::from_str(text).map_err(|error| {
            let before = error.span().and_then(|span| text.get(..span.start));
            ConfigError::Malformed {
                path: path.to_owned(),
                line: before.map_or(1, |before| 1 + before.matches('\n').count()),
                reason: error.message().trim_end().to_owned(),
            }
        })
    }

    /// Checks every value.
    ///
    /// # Errors
    /// The first [`ConfigError`] found.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let Self {
            instance,
            http,
            workers,
            limits,
            clients: _,
            zenoh,
        } = self;
        if !is_name(instance) {
            return Err(ConfigError::BadName {
                name: "instance",
                got: instance.clone(),
            });
        }
        http.tls.validate()?;
        in_range("http.connections", http.connections.into(), 1..=65_536)?;
        in_range(
            "http.header_timeout_ms",
            whole_ms(http.header_timeout),
            10..=600_000,
        )?;
        in_range("http.body_timeout_ms", whole_ms(http.body_timeout), 10..=600_000)?;
        in_range("workers.count", workers.count.into(), 1..=256)?;
        in_range(
            "workers.queue_capacity",
            workers.queue_capacity.into(),
            1..=65_536,
        )?;
        in_range(
            "workers.stuck_after_ms",
            whole_ms(workers.stuck_after),
            100..=600_000,
        )?;
        in_range("workers.replacements", workers.replacements.into(), 0..=1024)?;
        in_range("limits.body_bytes", limits.body_bytes, 1 << 10..=1 << 30)?;
        in_range(
            "limits.image_pixels",
            limits.image_pixels,
            1024..=MAX_IMAGE_PIXELS,
        )?;
        let body_bytes = limits.body_bytes;
        for (name, bytes_in_flight) in [
            ("limits.bytes_in_flight", limits.bytes_in_flight),
            ("limits.batch_bytes_in_flight", limits.batch_bytes_in_flight),
        ] {
            in_range(name, bytes_in_flight, 1 << 10..=1 << 36)?;
            if bytes_in_flight < body_bytes {
                return Err(ConfigError::FlightBelowBody {
                    name,
                    bytes_in_flight,
                    body_bytes,
                });
            }
        }
        self.validate_clients()?;
        zenoh.camera_settings()?;
        workers.level().map(drop)
    }
}

impl WorkersConfig {
    /// The instruction-set level to compute with: the machine's best, or the lower one that was named.
    ///
    /// # Errors
    /// [`ConfigError::NoSuchLevel`] naming those that exist.
    pub fn level(&self) -> Result<Level, ConfigError> {
        if self.simd == "auto" {
            return Ok(Level::detect());
        }
        let levels = Level::available();
        levels
            .iter()
            .copied()
            .find(|level| level.name() == self.simd)
            .ok_or_else(|| {
                let names: Vec<&str> = std::iter::once("auto")
                    .chain(levels.iter().map(|level| level.name()))
                    .collect();
                ConfigError::NoSuchLevel {
                    got: self.simd.clone(),
                    available: names.join(", "),
                }
            })
    }
}

pub(crate) fn is_name(text: &str) -> bool {
    (1..=64).contains(&text.len())
        && text
            .bytes()
            .all(|b| b.is_ascii_alphanumeric() || b"_.-".contains(&b))
}

fn in_range(name: &'static str, got: u64, range: RangeInclusive<u64>) -> Result<(), ConfigError> {
    if range.contains(&got) {
        return Ok(());
    }
    let (min, max) = range.into_inner();
    Err(ConfigError::OutOfRange { name, min, max, got })
}

fn whole_ms(duration: Duration) -> u64 {
    u64::try_from(duration.as_millis()).unwrap_or(u64::MAX)
}

/// Durations as whole milliseconds.
mod milliseconds {
    use std::time::Duration;

    use serde::{Deserialize, Deserializer, Serializer};

    pub(super) fn serialize<S: Serializer>(duration: &Duration, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u64(super::whole_ms(*duration))
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Duration, D::Error> {
        u64::deserialize(deserializer).map(Duration::from_millis)
    }
}

#[cfg(test)]
mod tests;
