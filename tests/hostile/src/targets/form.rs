//! A body of type `multipart/form-data`.

use bytes::Bytes;
use futures_util::FutureExt;
use stereod::transport::http::parts_from_multipart;
use stereod::wire::request_from_form;

use super::request;
use crate::refusal::is_accepted;

/// What stands between the parts.
pub(crate) const BOUNDARY: &str = "seam";

pub(crate) fn form(bytes: &[u8]) -> bool {
    let parts = parts_from_multipart(Bytes::copy_from_slice(bytes), BOUNDARY).now_or_never();
    // All of the body is there, so there is nothing to wait for.
    let parts = parts.unwrap_or_else(|| unreachable!("a body in memory was waited for"));
    let frame = parts
        .and_then(request_from_form)
        .and_then(|message| request::frame(message, "form"));
    is_accepted(&frame) && frame.is_ok_and(|frame| request::pixels(&frame))
}
