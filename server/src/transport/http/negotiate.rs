//! What the client wants to get: the reply's format by `Accept` and `?view=`, and the form of a refusal.

use axum::http::HeaderMap;
use axum::http::header::{ACCEPT, CONTENT_TYPE, HeaderName};

use crate::job::ReplyFormat;
use crate::status::ServiceError;

/// The reply types there are; the server's order of preference where the client has none.
const TYPES: [(&str, ReplyFormat); 6] = [
    (PROTOBUF, ReplyFormat::Protobuf),
    ("application/protobuf", ReplyFormat::Protobuf),
    ("application/json", ReplyFormat::Json),
    ("image/png", ReplyFormat::DisparityPng),
    ("model/gltf-binary", ReplyFormat::Glb),
    ("application/ply", ReplyFormat::Ply),
];
const TYPE_NAMES: &str = "application/x-protobuf, application/json, image/png (?view=disparity or ?view=color), model/gltf-binary, application/ply";

/// Media type of protobuf messages.
pub(super) const PROTOBUF: &str = stereo_proto::CONTENT_TYPE;
/// Media type of refusals for people (RFC 9457).
pub(super) const PROBLEM_JSON: &str = "application/problem+json";

/// The reply's format and media type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Reply {
    pub(super) format: ReplyFormat,
    pub(super) media_type: &'static str,
}

/// How a refusal is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RefusalForm {
    Problem,
    Status,
}

/// The best reply for the `Accept` headers; `view` is the query's value, which asks for a picture.
pub(super) fn reply(headers: &HeaderMap, view: Option<&str>) -> Result<Reply, ServiceError> {
    let picture = view.map(picture).transpose()?;
    let ranges = ranges(headers)?;
    let candidates = TYPES
        .iter()
        .filter(|(_, format)| picture.is_none() || *format == ReplyFormat::DisparityPng);
    let mut best: Option<(Preference, Reply)> = None;
    for &(media_type, format) in candidates {
        let Some(preference) = preference(&ranges, media_type) else {
            continue;
        };
        // Only a better one replaces an earlier one, so that the table's order decides between equals.
        if best.is_none_or(|(known, _)| preference > known) {
            best = Some((
                preference,
                Reply {
                    format: picture.unwrap_or(format),
                    media_type,
                },
            ));
        }
    }
    best.map(|(_, reply)| reply)
        .ok_or_else(|| ServiceError::NotAcceptable {
            expected: if picture.is_some() {
                "image/png, which ?view= asks for"
            } else {
                TYPE_NAMES
            },
            got: joined(headers, &ACCEPT),
        })
}

/// A stream's frame with everything there is to see of it, if the `Accept` headers allow for it.
pub(super) fn whole_frame(headers: &HeaderMap) -> Result<Reply, ServiceError> {
    if preference(&ranges(headers)?, PROTOBUF).is_none() {
        return Err(ServiceError::NotAcceptable {
            expected: "application/x-protobuf, which ?view=frame asks for",
            got: joined(headers, &ACCEPT),
        });
    }
    Ok(Reply {
        format: ReplyFormat::StreamView,
        media_type: PROTOBUF,
    })
}

/// The form of refusals: what `Accept` names; if it names neither, the form the request was in.
pub(super) fn refusal_form(headers: &HeaderMap) -> RefusalForm {
    let ranges = ranges(headers).unwrap_or_default();
    let named = |names: &[&str]| {
        let named = ranges
            .iter()
            .filter(|range| names.contains(&range.media_type.as_str()));
        named
            .map(|range| range.quality_milli)
            .max()
            .filter(|&quality| quality > 0)
    };
    let problem = named(&[PROBLEM_JSON]).or_else(|| named(&["application/json"]).map(|quality| quality - 1));
    match (problem, named(&[PROTOBUF, "application/protobuf"])) {
        (None, Some(_)) => RefusalForm::Status,
        (Some(problem), Some(status)) if status > problem => RefusalForm::Status,
        (None, None) if is_protobuf(&essence(&joined(headers, &CONTENT_TYPE))) => RefusalForm::Status,
        _ => RefusalForm::Problem,
    }
}

/// Whether a media type without parameters is one of protobuf's.
pub(super) fn is_protobuf(essence: &str) -> bool {
    essence == PROTOBUF || essence == "application/protobuf"
}

/// A media type without its parameters, in lower case.
pub(super) fn essence(media_type: &str) -> String {
    media_type
        .split(';')
        .next()
        .unwrap_or_default()
        .trim()
        .to_ascii_lowercase()
}

fn picture(view: &str) -> Result<ReplyFormat, ServiceError> {
    match view {
        "disparity" => Ok(ReplyFormat::DisparityPng),
        "color" => Ok(ReplyFormat::ColorPng),
        _ => Err(ServiceError::Invalid(format!(
            "view must be disparity or color, got `{view}`"
        ))),
    }
}

/// Larger is better: quality first, then how exactly the type was named.
type Preference = (u16, u8);

/// One of the alternatives of an `Accept` header.
#[derive(Debug)]
struct MediaRange {
    media_type: String,
    /// The q-value in thousandths.
    quality_milli: u16,
}

impl MediaRange {
    /// How exactly this range names `media_type`: 3 as itself, 2 as `type/*`, 1 as `*/*`.
    fn exactness(&self, media_type: &str) -> Option<u8> {
        if self.media_type == media_type {
            return Some(3);
        }
        if self.media_type == "*/*" {
            return Some(1);
        }
        let kind = self.media_type.strip_suffix("/*")?;
        media_type.strip_prefix(kind)?.starts_with('/').then_some(2)
    }
}

/// The preference of the range that names `media_type` most exactly; `None` if none does or that one forbids it.
fn preference(ranges: &[MediaRange], media_type: &str) -> Option<Preference> {
    let matching = ranges
        .iter()
        .filter_map(|range| Some((range.exactness(media_type)?, range.quality_milli)));
    let (exactness, quality_milli) = matching.max()?;
    (quality_milli > 0).then_some((quality_milli, exactness))
}

/// All alternatives; no header means that anything goes.
fn ranges(headers: &HeaderMap) -> Result<Vec<MediaRange>, ServiceError> {
    let text = joined(headers, &ACCEPT);
    if text.trim().is_empty() {
        return Ok(vec![MediaRange {
            media_type: "*/*".to_owned(),
            quality_milli: 1000,
        }]);
    }
    let parts = text.split(',').filter(|part| !part.trim().is_empty());
    parts
        .map(|part| range(part).ok_or_else(|| malformed(part)))
        .collect()
}

fn range(part: &str) -> Option<MediaRange> {
    let media_type = essence(part);
    let (kind, subtype) = media_type.split_once('/')?;
    if kind.is_empty() || subtype.is_empty() {
        return None;
    }
    let mut quality_milli = 1000;
    for parameter in part.split(';').skip(1) {
        let (name, value) = parameter.split_once('=').unwrap_or((parameter, ""));
        if name.trim().eq_ignore_ascii_case("q") {
            quality_milli = milli_from_quality(value.trim())?;
        }
    }
    Some(MediaRange {
        media_type,
        quality_milli,
    })
}

/// RFC 9110, 12.4.2: `0` to `1` with at most three digits behind the point.
fn milli_from_quality(text: &str) -> Option<u16> {
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    if fraction.len() > 3 || !fraction.bytes().all(|digit| digit.is_ascii_digit()) {
        return None;
    }
    let milli = format!("{fraction:0<3}").parse::<u16>().ok()?;
    match (whole, milli) {
        ("0", _) => Some(milli),
        ("1", 0) => Some(1000),
        _ => None,
    }
}

fn malformed(part: &str) -> ServiceError {
    let part = part.trim();
    ServiceError::Invalid(format!(
        "Accept must be media types such as `image/png;q=0.5`, got `{part}`"
    ))
}

/// All values of one header, as if they had been sent in one.
fn joined(headers: &HeaderMap, name: &HeaderName) -> String {
    let values: Vec<_> = headers
        .get_all(name)
        .iter()
        .map(|value| String::from_utf8_lossy(value.as_bytes()))
        .collect();
    values.join(",")
}

#[cfg(test)]
mod tests;
