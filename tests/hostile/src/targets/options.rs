//! What is said in words: options and settings as JSON, selectors, budgets, types.

use std::sync::OnceLock;

use bytes::Bytes;
use stereod::wire::{
    FormParts, camera_settings_from_json, expect_message, latency_budget_from_grpc_timeout,
    latency_budget_from_ms, request_from_form, selector_parameters,
};

use super::request;
use crate::corpus;
use crate::refusal::is_accepted;

pub(crate) fn options(bytes: &[u8]) -> bool {
    static FILE: OnceLock<Bytes> = OnceLock::new();
    let file = FILE.get_or_init(|| corpus::gray_png().into());
    let json = serde_json::from_slice(bytes);
    let is_settings = json.is_ok_and(|json| is_accepted(&camera_settings_from_json(&json)));
    let parts = FormParts {
        left: Some(file.clone()),
        right: Some(file.clone()),
        options: Some(Bytes::copy_from_slice(bytes)),
    };
    is_accepted(&request_from_form(parts).and_then(|message| request::frame(message, "options")))
        || is_settings
}

pub(crate) fn selector(bytes: &[u8]) -> bool {
    // Headers are read so, and selectors are text.
    let text = String::from_utf8_lossy(bytes);
    let taken = [
        is_accepted(&selector_parameters(&text)),
        is_accepted(&latency_budget_from_ms("X-Latency-Budget-Ms", &text)),
        is_accepted(&latency_budget_from_grpc_timeout(&text)),
        is_accepted(&expect_message(&text, "StereoRequest")),
    ];
    taken.contains(&true)
}
