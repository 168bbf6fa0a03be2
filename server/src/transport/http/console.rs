//! The console: the web page at `/` and its files, which `build.rs` has put into the binary. Nothing here computes, waits or reads a
//! body, so it costs no request its deadline.

use std::sync::Arc;

use axum::Router;
use axum::body::Body as HttpBody;
use axum::http::header::{
    ACCEPT_ENCODING, CACHE_CONTROL, CONTENT_ENCODING, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG,
    IF_NONE_MATCH, REFERRER_POLICY, VARY,
};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::Response;
use axum::routing::get;

use super::{Http, only};

/// One file of the console.
struct File {
    /// Where it is, from the console's folder on: `/index.html`.
    path: &'static str,
    content_type: &'static str,
    plain: Body,
    /// The same, compressed, where that is worth it.
    gzip: Option<Body>,
}

/// The bytes of a file in one encoding.
struct Body {
    /// An entity tag: another one whenever the bytes are others.
    tag: &'static str,
    bytes: &'static [u8],
}

include!(concat!(env!("OUT_DIR"), "/console.rs"));

/// What is at `/` if the console was not there when the server was built.
const ABSENT: File = File {
    path: INDEX,
    content_type: "text/html; charset=utf-8",
    plain: Body {
        tag: "\"absent\"",
        bytes: include_bytes!("console/absent.html"),
    },
    gzip: None,
};

const INDEX: &str = "/index.html";
/// Files below have their content's hash in their name.
const HASHED: &str = "/assets/";

/// The page may load what comes with it and talk to its own server, and nothing else; nobody may frame it.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// `router` with the console's files.
pub(super) fn routes(mut router: Router<Arc<Http>>) -> Router<Arc<Http>> {
    for file in FILES {
        router = at(router, file.path, file);
    }
    let index = FILES.iter().find(|file| file.path == INDEX).unwrap_or(&ABSENT);
    at(router, "/", index)
}

fn at(router: Router<Arc<Http>>, path: &str, file: &'static File) -> Router<Arc<Http>> {
    let answer = move |headers: HeaderMap| async move { serve(file, &headers) };
    router.route(path, only("GET, HEAD", get(answer)))
}

/// The file in the best encoding the browser takes, or that it has it already.
fn serve(file: &File, headers: &HeaderMap) -> Response {
    let zipped = file.gzip.as_ref().filter(|_| takes_gzip(headers));
    let body = zipped.unwrap_or(&file.plain);
    let is_known = headers
        .get_all(IF_NONE_MATCH)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .any(|tag| tag.trim().trim_start_matches("W/") == body.tag || tag.trim() == "*");
    let mut response = match is_known {
        true => Response::new(HttpBody::empty()),
        false => Response::new(HttpBody::from(body.bytes)),
    };
    if is_known {
        *response.status_mut() = StatusCode::NOT_MODIFIED;
    }
    let cache = match file.path.starts_with(HASHED) {
        true => "public, max-age=31536000, immutable",
        // Asked for again every time, answered with 304 if nothing has changed.
        false => "no-cache",
    };
    let mut set = |name: HeaderName, value: &'static str| {
        response
            .headers_mut()
            .insert(name, HeaderValue::from_static(value));
    };
    set(CONTENT_TYPE, file.content_type);
    set(CACHE_CONTROL, cache);
    set(ETAG, body.tag);
    set(VARY, "Accept-Encoding");
    set(CONTENT_SECURITY_POLICY, POLICY);
    set(REFERRER_POLICY, "no-referrer");
    if zipped.is_some() {
        set(CONTENT_ENCODING, "gzip");
    }
    response
}

/// Whether `Accept-Encoding` names gzip and does not rule it out.
fn takes_gzip(headers: &HeaderMap) -> bool {
    let given = headers.get_all(ACCEPT_ENCODING).iter();
    given
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .any(|range| {
            let (coding, weight) = range.split_once(';').unwrap_or((range, ""));
            let is_refused = weight
                .trim()
                .strip_prefix("q=")
                .is_some_and(|q| q.parse() == Ok(0.0_f32));
            coding.trim().eq_ignore_ascii_case("gzip") && !is_refused
        })
}

#[cfg(test)]
mod tests;
