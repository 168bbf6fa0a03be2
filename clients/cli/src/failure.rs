//! How a command can end, and the exit codes.

use std::fmt;

use serde_json::{Value, json};
use stereo_client::ClientError;

/// The exit codes, as `--help` explains them.
pub(crate) const EXIT_CODES: &str = "\
Exit codes:
  0  done
  1  failed: a file can't be read or written, an answer can't be understood, a check of `doctor` failed
  2  wrong use: an unknown flag or value, a folder without pairs
  3  no server reached, or none that is ready
  4  refused by the server, or too late
Of many pairs, the worst counts: 3, then 1, then 4.";

/// Why a command did not do what it was asked to.
#[derive(Debug, Clone)]
pub(crate) struct Failure {
    pub(crate) kind: Kind,
    /// What is wrong and what to do, in a sentence.
    pub(crate) message: String,
    /// Why a server refused, such as `DEADLINE_INFEASIBLE`.
    pub(crate) reason: Option<String>,
}

/// What kind of failure it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Failed,
    Usage,
    Unreachable,
    Refused,
    /// Whoever read the output is gone: nothing is left to do or to say.
    OutputClosed,
}

impl Kind {
    /// The exit code.
    pub(crate) fn code(self) -> u8 {
        match self {
            Self::OutputClosed => 0,
            Self::Failed => 1,
            Self::Usage => 2,
            Self::Unreachable => 3,
            Self::Refused => 4,
        }
    }

    /// Of the failures of many pairs, the largest counts.
    fn gravity(self) -> u8 {
        match self {
            Self::OutputClosed => 0,
            Self::Refused => 1,
            Self::Failed => 2,
            Self::Usage => 3,
            Self::Unreachable => 4,
        }
    }

    pub(crate) fn worse(self, other: Option<Self>) -> Self {
        other
            .filter(|other| other.gravity() > self.gravity())
            .unwrap_or(self)
    }

    fn name(self) -> &'static str {
        match self {
            Self::OutputClosed => "output closed",
            Self::Failed => "failed",
            Self::Usage => "usage",
            Self::Unreachable => "unreachable",
            Self::Refused => "refused",
        }
    }
}

impl Failure {
    pub(crate) fn new(kind: Kind, message: impl Into<String>) -> Self {
        Self {
            kind,
            message: message.into(),
            reason: None,
        }
    }

    pub(crate) fn failed(message: impl Into<String>) -> Self {
        Self::new(Kind::Failed, message)
    }

    pub(crate) fn usage(message: impl Into<String>) -> Self {
        Self::new(Kind::Usage, message)
    }

    /// As `--json` prints it.
    pub(crate) fn to_json(&self) -> Value {
        json!({
            "error": self.kind.name(), "reason": self.reason, "message": self.message, "exit_code": self.kind.code(),
        })
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl From<ClientError> for Failure {
    fn from(error: ClientError) -> Self {
        let kind = match &error {
            ClientError::BadUrl { .. } | ClientError::BadAccess { .. } => Kind::Usage,
            ClientError::Unreachable { .. }
            | ClientError::Insecure { .. }
            | ClientError::NotHttp { .. }
            | ClientError::Interrupted { .. }
            | ClientError::Unavailable { .. }
            | ClientError::NotServed { .. }
            | ClientError::NotReady { .. } => Kind::Unreachable,
            ClientError::Refused(_) => Kind::Refused,
            ClientError::Unexpected { .. }
            | ClientError::Malformed(_)
            | ClientError::Network(_)
            | ClientError::NoResults { .. } => Kind::Failed,
        };
        let reason = error.status().map(|status| {
            let name = status.reason().as_str_name();
            name.trim_start_matches("REASON_").to_owned()
        });
        let flags = match (&error, reason.as_deref()) {
            (ClientError::Insecure { why, .. }, _) if why.contains("give") => " (--ca FILE, --cert FILE)",
            (_, Some("UNAUTHENTICATED")) => " (--token or STEREO_TOKEN)",
            _ => "",
        };
        Self {
            kind,
            message: format!("{error}{flags}"),
            reason,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_server_that_is_gone_is_worse_than_a_refusal() {
        assert_eq!(Kind::Refused.worse(Some(Kind::Unreachable)), Kind::Unreachable);
        assert_eq!(Kind::Failed.worse(Some(Kind::Refused)), Kind::Failed);
        assert_eq!(Kind::Refused.worse(None), Kind::Refused);
    }
}
