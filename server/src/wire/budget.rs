//! Latency budgets in the ways they can be written: a protobuf duration, a number of milliseconds, gRPC's header.

use std::time::Duration;

use crate::status::ServiceError;

/// The largest budget.
const MAX: Duration = Duration::from_secs(60);

/// A budget from `text`, a plain number of milliseconds; `name` is where it was written (`X-Latency-Budget-Ms`).
///
/// # Errors
/// [`ServiceError::Invalid`] naming `name` unless it is above 0 and at most 60000.
pub fn latency_budget_from_ms(name: &str, text: &str) -> Result<Duration, ServiceError> {
    let number = text.trim().parse::<f64>().map_err(|_| refuse_ms(name, text))?;
    from_ms(name, number)
}

/// A budget from gRPC's header `grpc-timeout`: up to 8 digits and a unit (`H`, `M`, `S`, `m`, `u`, `n`).
///
/// # Errors
/// [`ServiceError::Invalid`] naming the header if it is malformed, zero, or over 60 s.
pub fn latency_budget_from_grpc_timeout(text: &str) -> Result<Duration, ServiceError> {
    let refuse = || {
        ServiceError::Invalid(format!(
            "grpc-timeout must be 1 to 8 digits and a unit of H, M, S, m, u, n, above 0 and up to 60 s, such as 80m; \
             got `{text}`"
        ))
    };
    let mut digits = text.trim().chars();
    let unit = digits.next_back().ok_or_else(refuse)?;
    let digits = digits.as_str();
    if !(1..=8).contains(&digits.len()) || !digits.bytes().all(|digit| digit.is_ascii_digit()) {
        return Err(refuse());
    }
    let number: u64 = digits.parse().map_err(|_| refuse())?;
    let budget = match unit {
        'H' => Duration::from_secs(number * 3600),
        'M' => Duration::from_secs(number * 60),
        'S' => Duration::from_secs(number),
        'm' => Duration::from_millis(number),
        'u' => Duration::from_micros(number),
        'n' => Duration::from_nanos(number),
        _ => return Err(refuse()),
    };
    in_range(budget).ok_or_else(refuse)
}

/// A budget from a JSON number.
pub(super) fn from_ms(name: &str, ms: f64) -> Result<Duration, ServiceError> {
    let budget = Duration::try_from_secs_f64(ms / 1e3).ok();
    budget
        .and_then(in_range)
        .ok_or_else(|| refuse_ms(name, &ms.to_string()))
}

/// A budget from the wire.
pub(super) fn from_proto(budget: prost_types::Duration) -> Result<Duration, ServiceError> {
    let duration = Duration::try_from(budget).ok();
    duration.and_then(in_range).ok_or_else(|| {
        ServiceError::Invalid(format!(
            "latency_budget must be above 0 and up to 60 s, got {} s and {} ns",
            budget.seconds, budget.nanos
        ))
    })
}

fn in_range(budget: Duration) -> Option<Duration> {
    (budget > Duration::ZERO && budget <= MAX).then_some(budget)
}

fn refuse_ms(name: &str, got: &str) -> ServiceError {
    ServiceError::Invalid(format!(
        "{name} must be a number of milliseconds above 0 and up to 60000, got `{got}`"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budgets_are_read_from_every_spelling() {
        assert_eq!(latency_budget_from_ms("x", "80"), Ok(Duration::from_millis(80)));
        assert_eq!(
            latency_budget_from_ms("x", " 0.5 "),
            Ok(Duration::from_micros(500))
        );
        assert_eq!(latency_budget_from_ms("x", "60000"), Ok(MAX));
        for (text, budget) in [
            ("80m", 80_000),
            ("80000u", 80_000),
            ("1S", 1_000_000),
            ("1M", 60_000_000),
        ] {
            assert_eq!(
                latency_budget_from_grpc_timeout(text),
                Ok(Duration::from_micros(budget)),
                "{text}"
            );
        }
        let proto = prost_types::Duration {
            seconds: 0,
            nanos: 80_000_000,
        };
        assert_eq!(from_proto(proto), Ok(Duration::from_millis(80)));
    }

    #[test]
    fn budgets_out_of_range_are_refused_naming_where_they_were_given() {
        for text in ["0", "-1", "60000.1", "NaN", "inf", "1e300", "1e-9", "", "80ms"] {
            let error = latency_budget_from_ms("X-Latency-Budget-Ms", text).unwrap_err();
            assert_eq!(error.http_code(), 400);
            assert!(
                error.to_string().starts_with("X-Latency-Budget-Ms must be"),
                "{error}"
            );
        }
        for text in [
            "",
            "m",
            "80",
            "0m",
            "1H",
            "123456789n",
            "8 0m",
            "+80m",
            "80x",
            "80é",
        ] {
            let error = latency_budget_from_grpc_timeout(text).unwrap_err();
            assert!(
                error.to_string().starts_with("grpc-timeout must be"),
                "{text}: {error}"
            );
        }
        for (seconds, nanos) in [(0, 0), (-1, 0), (60, 1), (i64::MAX, 0), (i64::MIN, i32::MIN)] {
            let error = from_proto(prost_types::Duration { seconds, nanos }).unwrap_err();
            assert!(error.to_string().starts_with("latency_budget must be"), "{error}");
        }
    }
}
