//! How connections and batches end, and what that is called.

use super::Label;

/// Why a connection ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ConnectionEnd {
    /// The client closed it, or said that it would.
    Closed,
    /// The client broke the protocol or the network failed.
    Failed,
    /// It was silent for longer than a head may take.
    Silent,
    /// The client did not take what was sent.
    SlowReader,
    /// It had sent nothing yet and made room for a new one at the limit.
    Evicted,
    /// There was no place for it; it was told so.
    Refused,
    /// No TLS came about: another protocol, a version that is too old, a certificate that is not acceptable.
    Handshake,
    /// The server stopped.
    Stopping,
}

impl ConnectionEnd {
    pub(super) const ALL: [Self; 8] = [
        Self::Closed,
        Self::Failed,
        Self::Silent,
        Self::SlowReader,
        Self::Evicted,
        Self::Refused,
        Self::Handshake,
        Self::Stopping,
    ];

    pub(super) fn label(self) -> Label {
        let name = match self {
            Self::Closed => "closed",
            Self::Failed => "failed",
            Self::Silent => "silent",
            Self::SlowReader => "slow_reader",
            Self::Evicted => "evicted",
            Self::Refused => "refused",
            Self::Handshake => "handshake",
            Self::Stopping => "stopping",
        };
        [("why", name)]
    }
}

/// What ended a batch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum BatchEnd {
    /// Every request was read and answered.
    Complete,
    /// The body ended in the middle of a request, or something else than a request was in it.
    BrokenOff,
    /// The client did not read its replies.
    SlowReader,
    /// The client has gone, or the network between.
    HungUp,
    /// The server stopped; what was read before is answered.
    Stopping,
}

impl BatchEnd {
    pub(super) const ALL: [Self; 5] = [
        Self::Complete,
        Self::BrokenOff,
        Self::SlowReader,
        Self::HungUp,
        Self::Stopping,
    ];

    pub(super) fn label(self) -> Label {
        let name = match self {
            Self::Complete => "complete",
            Self::BrokenOff => "broken_off",
            Self::SlowReader => "slow_reader",
            Self::HungUp => "hung_up",
            Self::Stopping => "stopping",
        };
        [("outcome", name)]
    }
}
