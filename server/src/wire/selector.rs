//! What a Zenoh selector says besides its key.

use std::time::Duration;

use super::budget::latency_budget_from_ms;
use crate::status::ServiceError;

/// The budget and `partial` of a selector's parameters, which `;` separates.
///
/// # Errors
/// [`ServiceError::Invalid`] naming the parameter that has no meaning or no acceptable value.
pub fn selector_parameters(parameters: &str) -> Result<(Option<Duration>, bool), ServiceError> {
    let (mut budget, mut is_partial) = (None, false);
    for parameter in parameters.split(';').filter(|parameter| !parameter.is_empty()) {
        let (name, value) = parameter.split_once('=').unwrap_or((parameter, ""));
        match (name, value) {
            ("budget_ms", _) => budget = Some(latency_budget_from_ms("budget_ms", value)?),
            ("partial", "true") => is_partial = true,
            ("partial", "false") => is_partial = false,
            // Zenoh's own.
            (own, _) if own.starts_with('_') => {}
            _ => {
                return Err(ServiceError::Invalid(format!(
                    "the selector's parameter `{parameter}` has no meaning: there are budget_ms=80, partial=true and \
                     partial=false, separated by ;"
                )));
            }
        }
    }
    Ok((budget, is_partial))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_are_read_and_unknown_ones_refused_by_name() {
        assert_eq!(selector_parameters("").unwrap(), (None, false));
        let both = selector_parameters("budget_ms=80;partial=true").unwrap();
        assert_eq!(both, (Some(Duration::from_millis(80)), true));
        assert_eq!(
            selector_parameters("_anyke;budget_ms=1").unwrap().0,
            Some(Duration::from_millis(1))
        );
        for (bad, word) in [
            ("budget_ms=0", "budget_ms"),
            ("preset=fast", "preset"),
            ("partial=1", "partial=1"),
        ] {
            let error = selector_parameters(bad).unwrap_err();
            assert!(error.to_string().contains(word), "{error}");
        }
    }
}
