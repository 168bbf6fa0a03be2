//! The scheduler's policy by its name.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use stereo_scheduler::Policy;

use super::ConfigError;

/// Most rungs of any ladder.
const MAX_RUNGS: u8 = 8;

/// `edf`, `fifo`, `fifo-timeout` or `fixed:N`. All but the first are there to be compared with.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct PolicyName(pub Policy);

impl FromStr for PolicyName {
    type Err = ConfigError;

    fn from_str(name: &str) -> Result<Self, ConfigError> {
        let rungs = |count: &str| count.parse().ok().filter(|count| (1..=MAX_RUNGS).contains(count));
        let policy = match name {
            "edf" => Some(Policy::Edf),
            "fifo" => Some(Policy::Fifo),
            "fifo-timeout" => Some(Policy::FifoTimeout),
            other => other.strip_prefix("fixed:").and_then(rungs).map(Policy::Fixed),
        };
        policy
            .map(Self)
            .ok_or_else(|| ConfigError::NoSuchPolicy { got: name.to_owned() })
    }
}

impl TryFrom<String> for PolicyName {
    type Error = ConfigError;

    fn try_from(name: String) -> Result<Self, ConfigError> {
        name.parse()
    }
}

impl From<PolicyName> for String {
    fn from(name: PolicyName) -> Self {
        name.to_string()
    }
}

impl fmt::Display for PolicyName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Policy::Edf => f.write_str("edf"),
            Policy::Fifo => f.write_str("fifo"),
            Policy::FifoTimeout => f.write_str("fifo-timeout"),
            Policy::Fixed(rungs) => write!(f, "fixed:{rungs}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_policy_reads_back_as_its_name() {
        for name in ["edf", "fifo", "fifo-timeout", "fixed:1", "fixed:8"] {
            assert_eq!(name.parse::<PolicyName>().unwrap().to_string(), name);
        }
        for bad in ["", "EDF", "fixed", "fixed:0", "fixed:9", "fixed:x"] {
            assert!(
                bad.parse::<PolicyName>()
                    .unwrap_err()
                    .to_string()
                    .contains("fixed:N"),
                "{bad}"
            );
        }
    }
}
