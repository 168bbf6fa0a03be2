//! What holds for every refusal.

use stereod::status::{LONGEST_TEXT, ServiceError};

/// Whether it was accepted; a refusal is the sender's fault and short.
pub(crate) fn is_accepted<T>(outcome: &Result<T, ServiceError>) -> bool {
    let Err(error) = outcome else { return true };
    let (code, text) = (error.http_code(), error.text());
    assert!((400..500).contains(&code), "{code}: {text}");
    assert!(text.len() <= LONGEST_TEXT, "{} bytes: {text}", text.len());
    false
}
