//! A fault that the server is told to have, so that it can be seen to survive it.

use std::fmt;
use std::str::FromStr;

use super::ConfigError;

/// What happens to a worker at a frame, counted from 1 over all workers: `panic@N`, or `stuck@N`, which never ends. Given on the command
/// line or by the environment of the process alone: nobody outside can ask for it, and no file can leave it behind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// The worker panics.
    Panic {
        /// At which frame.
        at: u64,
    },
    /// The worker makes no progress any more.
    Stuck {
        /// At which frame.
        at: u64,
    },
}

impl FromStr for Fault {
    type Err = ConfigError;

    fn from_str(text: &str) -> Result<Self, ConfigError> {
        let unknown = || ConfigError::NoSuchFault { got: text.to_owned() };
        let (what, at) = text.split_once('@').ok_or_else(unknown)?;
        let at = at.parse().ok().filter(|&at| at > 0).ok_or_else(unknown)?;
        match what {
            "panic" => Ok(Self::Panic { at }),
            "stuck" => Ok(Self::Stuck { at }),
            _ => Err(unknown()),
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Panic { at } => write!(f, "panic@{at}"),
            Self::Stuck { at } => write!(f, "stuck@{at}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_read_as_they_are_written() {
        for fault in [Fault::Panic { at: 1 }, Fault::Stuck { at: 20 }] {
            assert_eq!(fault.to_string().parse(), Ok(fault));
        }
        for bad in ["", "panic", "panic@", "panic@0", "panic@-1", "fire@3", "stuck@x"] {
            let error = bad.parse::<Fault>().unwrap_err().to_string();
            assert!(error.contains("panic@N") && error.contains(bad), "{error}");
        }
    }
}
