//! What can be wrong with a configuration.

use thiserror::Error;

/// Why the server can't start with this configuration; each says what to do.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum ConfigError {
    /// The file can't be read.
    #[error("can't read the configuration file {path}: {reason}")]
    Unreadable {
        /// The file.
        path: String,
        /// What the system said.
        reason: String,
    },
    /// The file isn't TOML, or has an unknown key or a value of the wrong type.
    #[error("the configuration file {path} is not valid at line {line}: {reason}")]
    Malformed {
        /// The file.
        path: String,
        /// Where, from 1.
        line: usize,
        /// What, and which keys there are.
        reason: String,
    },
    /// A number outside its range.
    #[error("{name} must be {min} to {max}, got {got}")]
    OutOfRange {
        /// Key in the file.
        name: &'static str,
        /// Smallest accepted value.
        min: u64,
        /// Largest accepted value.
        max: u64,
        /// The value given.
        got: u64,
    },
    /// A name with other characters than those allowed.
    #[error("{name} must be 1 to 64 of the characters A-Z a-z 0-9 _ . -, got `{got}`")]
    BadName {
        /// Key in the file.
        name: &'static str,
        /// The value given.
        got: String,
    },
    /// An instruction-set level that this build or this machine doesn't have.
    #[error("simd level `{got}` doesn't exist here; there are: {available}")]
    NoSuchLevel {
        /// The value given.
        got: String,
        /// What can be given.
        available: String,
    },
    /// No such policy.
    #[error("policy must be edf, fifo, fifo-timeout or fixed:N with N from 1 to 8, got `{got}`")]
    NoSuchPolicy {
        /// The value given.
        got: String,
    },
    /// No such fault.
    #[error("a fault must be panic@N or stuck@N with N the number of a frame from 1, got `{got}`")]
    NoSuchFault {
        /// The value given.
        got: String,
    },
    /// A client can't be as described.
    #[error("clients.{client} is not acceptable: {reason}")]
    Client {
        /// Its name.
        client: String,
        /// What is wrong.
        reason: String,
    },
    /// TLS can't be done so.
    #[error("TLS can't be configured so: {reason}")]
    Tls {
        /// Which file, and why.
        reason: String,
    },
    /// Zenoh's own configuration can't be used.
    #[error("zenoh can't be configured so: {reason}")]
    Zenoh {
        /// Where and why.
        reason: String,
    },
    /// The settings of a camera can't be used.
    #[error("zenoh.cameras.{camera} is not acceptable: {reason}")]
    Camera {
        /// Its name.
        camera: String,
        /// What is wrong.
        reason: String,
    },
    /// Bodies of the largest size could never be accepted.
    #[error("{name} ({bytes_in_flight}) must be at least limits.body_bytes ({body_bytes})")]
    FlightBelowBody {
        /// Key in the file.
        name: &'static str,
        /// The bound on all bodies together.
        bytes_in_flight: u64,
        /// The bound on one body.
        body_bytes: u64,
    },
}
