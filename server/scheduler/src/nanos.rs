//! Signed time: slack may be negative, which a [`Duration`] can't be.

use std::time::Duration;

/// Nanoseconds; as many as fit, which is 292 years.
pub(crate) fn nanos(duration: Duration) -> i64 {
    i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX / 4)
}

/// The other way; negative is zero.
pub(crate) fn duration(nanos: i64) -> Duration {
    Duration::from_nanos(u64::try_from(nanos).unwrap_or(0))
}
