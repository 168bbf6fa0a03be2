//! `POST /v1/stereo`: one pair in, one reply out.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::body::{Body, HttpBody};
use axum::extract::{Extension, Request, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Uri};
use axum::response::Response;

use super::Http;
use super::body::{Received, Share};
use super::connections::Departures;
use super::description::{Binary, PictureName};
use super::early::Sender;
use super::envelope::{ReceivedAt, RequestId};
use super::form::parts_from_multipart;
use super::negotiate::{self, Reply};
use super::refusal::Refusal;
use crate::clients::Caller;
use crate::encode::Summary;
use crate::job::{FrameRequest, PriorityClass, Report};
use crate::service::Service;
use crate::status::ServiceError;
use crate::wire::{
    FormDescription, Intake, decode_request, frame_request, is_request_id, latency_budget_from_grpc_timeout,
    latency_budget_from_ms, request_from_form,
};

const SERVER_TIMING: HeaderName = HeaderName::from_static("server-timing");
const CONTENT_TYPES: &str =
    "multipart/form-data with the parts left, right and options, or application/x-protobuf";

/// Replies that are slower than this have a slow reader.
const SLOWEST_START: Duration = Duration::from_millis(2);
const SLOWEST_NS_BY_BYTE: u64 = 5;

/// What the head of a request says.
struct Head {
    reply: Reply,
    content: Content,
    budget: Option<Duration>,
}

/// How the body is written.
enum Content {
    Protobuf,
    Multipart { boundary: String },
}

/// The route.
#[utoipa::path(
    post,
    path = "/v1/stereo",
    tag = "pairs",
    summary = "Match one pair within its latency budget",
    description = "`Accept` chooses the reply: protobuf (`stereo.v1.StereoResult`), a summary as JSON, a 16-bit or colour PNG, the mesh \
                   as GLB or PLY. Refusals come as `application/problem+json`, or as `stereo.v1.Status` to those who accept protobuf.",
    params(
        ("view" = inline(Option<PictureName>), Query, description = "A picture as PNG: disparity in 1/256 px (KITTI's convention), or in colours"),
        ("X-Latency-Budget-Ms" = Option<f64>, Header, description = "Time to the answer; the smallest budget given counts",
            exclusive_minimum = 0, maximum = 60000),
        ("X-Request-Id" = Option<String>, Header, description = "The client's name for the request",
            min_length = 1, max_length = 128, pattern = "^[ -~]*$"),
    ),
    request_body(description = "The pair: two image files and options, or a `stereo.v1.StereoRequest`", content(
        (FormDescription = "multipart/form-data"),
        (Binary = "application/x-protobuf"),
    )),
    responses(
        (status = 200, description = "The result", content(
            (Summary = "application/json"),
            (Binary = "application/x-protobuf"),
            (Binary = "image/png"),
            (Binary = "model/gltf-binary"),
            (Binary = "application/ply"),
        )),
        Refusal,
    ),
)]
pub(super) async fn post(
    State(http): State<Arc<Http>>,
    Extension(ReceivedAt(received_at)): Extension<ReceivedAt>,
    Extension(RequestId(mut request_id)): Extension<RequestId>,
    (Extension(caller), departures): (Extension<Caller>, Option<Extension<Departures>>),
    request: Request,
) -> Result<Response, Refusal> {
    let (parts, body) = request.into_parts();
    let sender = body.size_hint().exact().map(|bytes| (caller.share(""), bytes));
    let head = match assess(&http, &parts, sender.as_ref(), received_at) {
        Ok(head) => head,
        Err(error) => {
            let error = http.service.refuse(error, received_at, &request_id);
            return Err(Refusal::unread(body, error));
        }
    };
    let mut unfinished = CountIfCancelled(Some(&http.service));
    let read = read(
        &http,
        &head,
        body,
        received_at,
        (&mut request_id, &caller, sender),
    )
    .await;
    unfinished.0 = None;
    let (frame, share) = match read {
        Ok(read) => read,
        Err(error) => {
            let error = http.service.refuse(error, received_at, &request_id);
            return Err(Refusal::of(error, request_id));
        }
    };
    let named = |error| Refusal::of(error, request_id.clone());
    let spec = http.service.spec(&frame);
    let finished = http.service.submit(frame).await.map_err(named)?;
    let encoded_at = received_at + finished.report.total;
    let service = Arc::clone(&http.service);
    let departures = departures
        .map(|Extension(departures)| departures)
        .unwrap_or_default();
    let on_handed_over = move |bytes: usize| {
        let service = Arc::clone(&service);
        departures.notify(move || {
            let took = encoded_at.elapsed();
            // A reply that takes longer says something about its client, which must not make the others' budgets shorter.
            if took <= SLOWEST_START + Duration::from_nanos(SLOWEST_NS_BY_BYTE.saturating_mul(bytes as u64)) {
                service.replied(&spec, took);
            }
        });
    };
    // The pixels were slices of the request's body; from here on the reply's takes its place.
    drop(share);
    let body = finished.bodies.into_iter().next();
    let body = body.ok_or_else(|| ServiceError::Internal("a reply without a body".to_owned()));
    let body = body.and_then(|body| http.bodies.reply(&caller, body.into_bytes(), on_handed_over));
    let body = body.map_err(|error| {
        http.service.count_unsent(&error);
        named(error)
    })?;
    let mut response = Response::new(body);
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(head.reply.media_type));
    // Digits, letters and punctuation, so always a valid header value.
    if let Ok(timing) = HeaderValue::from_str(&server_timing(&finished.report)) {
        headers.insert(SERVER_TIMING, timing);
    }
    Ok(response)
}

/// Whether the body is worth reading, by what the head says.
fn assess(
    http: &Http,
    parts: &Parts,
    sender: Option<&Sender>,
    received_at: Instant,
) -> Result<Head, ServiceError> {
    let head = read_head(http, &parts.uri, &parts.headers)?;
    if let (Some(budget), Some(sender)) = (head.budget, sender) {
        http.hints.assess(&http.service, sender, budget, received_at)?;
    }
    Ok(head)
}

/// From the head to a whole and checked frame and its share of the bytes in flight. `request_id` becomes the one in the body, if that
/// has one.
async fn read(
    http: &Http,
    head: &Head,
    body: Body,
    received_at: Instant,
    (request_id, caller, sender): (&mut String, &Caller, Option<Sender>),
) -> Result<(FrameRequest, Share), ServiceError> {
    let received = http.bodies.read(caller, body, received_at, head.budget);
    let Received { bytes, share } = received.await?;
    let message = match &head.content {
        Content::Protobuf => decode_request(bytes)?,
        Content::Multipart { boundary } => request_from_form(parts_from_multipart(bytes, boundary).await?)?,
    };
    if !message.request_id.is_empty() && is_request_id(&message.request_id) {
        request_id.clone_from(&message.request_id);
    }
    let intake = Intake {
        received_at,
        latency_budget: head.budget,
        request_id: request_id.clone(),
        formats: vec![head.reply.format],
        max_image_px: http.max_image_px,
        caller: caller.clone(),
        priority: PriorityClass::default(),
    };
    let frame = frame_request(message, intake)?;
    if let (Some(_), Some(sender)) = (head.budget, sender) {
        http.hints.remember(sender, http.service.spec(&frame));
    }
    Ok((frame, share))
}

/// Counts a request whose client goes away before it has become a frame.
struct CountIfCancelled<'a>(Option<&'a Service>);

impl Drop for CountIfCancelled<'_> {
    fn drop(&mut self) {
        if let Some(service) = self.0 {
            service.count_cancelled();
        }
    }
}

fn read_head(http: &Http, uri: &Uri, headers: &HeaderMap) -> Result<Head, ServiceError> {
    if http.service.is_draining() {
        return Err(ServiceError::Draining);
    }
    let content = content(headers)?;
    let reply = negotiate::reply(headers, view(uri.query().unwrap_or_default())?.as_deref())?;
    Ok(Head {
        reply,
        content,
        budget: budget(headers)?,
    })
}

fn content(headers: &HeaderMap) -> Result<Content, ServiceError> {
    let unsupported = |got: &str| ServiceError::UnsupportedMediaType {
        expected: CONTENT_TYPES,
        got: got.to_owned(),
    };
    let Some(given) = headers.get(CONTENT_TYPE) else {
        return Err(unsupported("none"));
    };
    let given = String::from_utf8_lossy(given.as_bytes());
    let essence = negotiate::essence(&given);
    if negotiate::is_protobuf(&essence) {
        return Ok(Content::Protobuf);
    }
    if essence != "multipart/form-data" {
        return Err(unsupported(&given));
    }
    let boundary = multer::parse_boundary(given.as_ref()).map_err(|_| {
        ServiceError::Invalid(format!(
            "Content-Type must name the boundary of the parts, got `{given}`"
        ))
    })?;
    Ok(Content::Multipart { boundary })
}

/// The value of `?view=`; every other parameter is refused by name.
pub(super) fn view(query: &str) -> Result<Option<String>, ServiceError> {
    let mut view = None;
    for parameter in query.split('&').filter(|parameter| !parameter.is_empty()) {
        let (name, value) = parameter.split_once('=').unwrap_or((parameter, ""));
        if name != "view" {
            return Err(ServiceError::Invalid(format!(
                "the query parameter `{name}` doesn't exist: there is view=disparity and view=color; options go into the body"
            )));
        }
        if view.replace(value.to_owned()).is_some() {
            return Err(ServiceError::Invalid(
                "the query parameter `view` is given twice".to_owned(),
            ));
        }
    }
    Ok(view)
}

/// The smallest budget that the headers give.
fn budget(headers: &HeaderMap) -> Result<Option<Duration>, ServiceError> {
    let mut smallest: Option<Duration> = None;
    let mut take = |budget: Duration| smallest = Some(smallest.map_or(budget, |known| known.min(budget)));
    for value in headers.get_all("x-latency-budget-ms") {
        take(latency_budget_from_ms(
            "X-Latency-Budget-Ms",
            &String::from_utf8_lossy(value.as_bytes()),
        )?);
    }
    for value in headers.get_all("grpc-timeout") {
        take(latency_budget_from_grpc_timeout(&String::from_utf8_lossy(
            value.as_bytes(),
        ))?);
    }
    Ok(smallest)
}

/// The stages of a frame as `Server-Timing` (W3C) has them, in plain decimal milliseconds.
fn server_timing(report: &Report) -> String {
    let stages = [
        ("queue", report.queued),
        ("decode", report.decoded),
        ("match", report.matched),
        ("mesh", report.meshed),
        ("encode", report.encoded),
    ];
    let stages = stages.map(|(name, took)| format!("{name};dur={:.3}", took.as_secs_f64() * 1e3));
    stages.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(pairs: &[(&'static str, &'static str)]) -> HeaderMap {
        pairs
            .iter()
            .map(|&(name, value)| (HeaderName::from_static(name), HeaderValue::from_static(value)))
            .collect()
    }

    #[test]
    fn the_smallest_budget_given_wins() {
        let both = headers(&[("x-latency-budget-ms", "80"), ("grpc-timeout", "50m")]);
        assert_eq!(budget(&both), Ok(Some(Duration::from_millis(50))));
        let one = headers(&[("x-latency-budget-ms", "12.5")]);
        assert_eq!(budget(&one), Ok(Some(Duration::from_micros(12_500))));
        assert_eq!(budget(&HeaderMap::new()), Ok(None));
    }

    #[test]
    fn a_malformed_budget_is_refused_even_beside_a_good_one() {
        for (name, bad) in [("grpc-timeout", "50"), ("x-latency-budget-ms", "soon")] {
            let mut given = headers(&[("x-latency-budget-ms", "80")]);
            given.append(name, HeaderValue::from_static(bad));
            assert_eq!(budget(&given).unwrap_err().http_code(), 400, "{name}");
        }
    }

    #[test]
    fn only_the_view_is_taken_from_the_query_and_only_once() {
        assert_eq!(view(""), Ok(None));
        assert_eq!(view("view=color"), Ok(Some("color".to_owned())));
        assert!(view("preset=paper").unwrap_err().to_string().contains("`preset`"));
        assert!(view("view=color&view=disparity").is_err());
    }

    #[test]
    fn stage_times_are_plain_decimal_milliseconds() {
        let report = Report {
            queued: Duration::from_micros(10),
            matched: Duration::from_micros(5_250),
            ..Report::default()
        };
        let expected = "queue;dur=0.010, decode;dur=0.000, match;dur=5.250, mesh;dur=0.000, encode;dur=0.000";
        assert_eq!(server_timing(&report), expected);
    }

    #[test]
    fn unknown_content_types_are_refused_naming_the_known_ones() {
        for (pairs, code) in [
            (headers(&[]), 415),
            (headers(&[("content-type", "text/plain")]), 415),
            (headers(&[("content-type", "multipart/form-data")]), 400),
        ] {
            let error = content(&pairs).map(|_| ()).unwrap_err();
            assert_eq!(error.http_code(), code, "{error}");
        }
        let quoted = headers(&[("content-type", "Multipart/Form-Data; boundary=\"a b\"")]);
        assert!(matches!(content(&quoted), Ok(Content::Multipart { boundary }) if boundary == "a b"));
    }
}
