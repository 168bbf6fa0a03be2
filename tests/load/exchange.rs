//! One frame to the server and its answer back, over HTTP/1.1 connections that are kept.

use std::net::IpAddr;
use std::pin::Pin;
use std::task::{Context as TaskContext, Poll};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use bytes::Bytes;
use hyper::body::{Body, Frame, SizeHint};
use prost::Message;
use reqwest::header::{ACCEPT, CONTENT_TYPE};
use reqwest::{Response, Url};
use stereo_client::v1;

use crate::args::Preset;
use crate::plan::Shot;
use crate::record::{Digest, Outcome, Record};

const PROTOBUF: &str = "application/x-protobuf";
/// How long an answer may take beyond the frame's budget; later ones are worth nothing, and sockets are finite.
const PATIENCE: Duration = Duration::from_secs(5);
/// What is sent of a budget that is over before the frame can be sent.
const LEAST_BUDGET: Duration = Duration::from_micros(1);
/// Connections rest for less than servers let them, so that none is closed while a frame goes out on it.
const REST: Duration = Duration::from_secs(4);

/// Sends frames to one server.
#[derive(Debug)]
pub(crate) struct Exchange {
    http: reqwest::Client,
    url: Url,
    pair: Bytes,
    heads: Vec<Bytes>,
}

impl Exchange {
    /// Sends `pair` (as [`crate::frames::Frames::pair`] makes it) to the server at `url` in the names of `cameras` cameras.
    ///
    /// # Errors
    /// If the address is none.
    pub(crate) fn new(url: &str, pair: Bytes, cameras: u16, preset: Preset) -> Result<Self> {
        let base = Url::parse(url).with_context(|| format!("`{url}` is no address"))?;
        ensure!(
            base.scheme() == "http",
            "the server's address must start with http://, got `{url}`"
        );
        let mut http = stereo_tests::http::builder()
            .pool_idle_timeout(REST)
            .connect_timeout(PATIENCE);
        if is_this_machine(&base) {
            // A proxy from the environment would look for the server on its own machine.
            http = http.no_proxy();
        }
        let head = |camera: u16| {
            let head = v1::StereoRequest {
                camera_id: format!("load-{camera}"),
                options: Some(v1::Options {
                    preset: preset.on_the_wire().into(),
                    ..v1::Options::default()
                }),
                ..v1::StereoRequest::default()
            };
            head.encode_to_vec().into()
        };
        Ok(Self {
            http: http.build().context("can't make an HTTP client")?,
            url: base.join("/v1/stereo").context("the address takes no path")?,
            pair,
            heads: (0..cameras).map(head).collect(),
        })
    }

    /// Sends a frame and waits for what becomes of it; the run began at `start`.
    pub(crate) async fn send(&self, shot: Shot, start: Instant) -> Record {
        let sent = Instant::now();
        let due = start + shot.at;
        let lag = sent.saturating_duration_since(due);
        let (decided, whole, outcome) = match self.answer(shot, lag).await {
            Ok(answered) => answered,
            Err(why) => {
                let now = Instant::now();
                (now, now, Outcome::Broken(root(&why)))
            }
        };
        Record {
            shot,
            lag,
            latency: whole.saturating_duration_since(due),
            decided: decided - sent,
            outcome,
        }
    }

    /// When the answer began, when it was whole, and what it was.
    async fn answer(&self, shot: Shot, lag: Duration) -> reqwest::Result<(Instant, Instant, Outcome)> {
        // What is left of it: the answer is due so long after the frame was, not after it could be sent.
        let left = shot.budget.saturating_sub(lag).max(LEAST_BUDGET);
        let body = PairBody {
            pieces: [self.heads[usize::from(shot.camera)].clone(), self.pair.clone()],
        };
        let request = self
            .http
            .post(self.url.clone())
            .header(CONTENT_TYPE, PROTOBUF)
            .header(ACCEPT, PROTOBUF)
            // In the head, so that the server knows it before the body is there.
            .header("x-latency-budget-ms", format!("{:.3}", left.as_secs_f64() * 1e3))
            .timeout(shot.budget + PATIENCE)
            .body(reqwest::Body::wrap(body));
        let mut answer = request.send().await?;
        let decided = Instant::now();
        let code = answer.status();
        let is_protobuf = is_protobuf(&answer);
        let mut pieces = Vec::new();
        while let Some(piece) = answer.chunk().await? {
            pieces.push(piece);
        }
        let whole = Instant::now();
        // What follows is this program's own business, and off the clock.
        let bytes: Bytes = pieces.concat().into();
        let outcome = if !is_protobuf {
            Outcome::Broken(format!("HTTP {code} without a protobuf answer"))
        } else if code.is_success() {
            answered(bytes)
        } else {
            refused(bytes)
        };
        Ok((decided, whole, outcome))
    }
}

fn answered(bytes: Bytes) -> Outcome {
    match v1::StereoResult::decode(bytes) {
        Ok(v1::StereoResult {
            report: Some(report), ..
        }) => Outcome::Answered(Box::new(Digest::of(&report))),
        Ok(_) => Outcome::Broken("a result without a report".to_owned()),
        Err(why) => Outcome::Broken(format!("a result that can't be read: {why}")),
    }
}

fn refused(bytes: Bytes) -> Outcome {
    match v1::Status::decode(bytes) {
        // These are faults of the request or the server, not answers to load.
        Ok(status)
            if matches!(
                status.reason(),
                v1::Reason::Invalid
                    | v1::Reason::TooLarge
                    | v1::Reason::Internal
                    | v1::Reason::Unauthenticated
                    | v1::Reason::Forbidden
                    | v1::Reason::Unspecified
            ) =>
        {
            Outcome::Broken(format!("HTTP {}: {}", status.code, status.message))
        }
        Ok(status) => Outcome::Refused {
            reason: status.reason(),
            says_when: status.earliest_feasible.is_some(),
        },
        Err(why) => Outcome::Broken(format!("a refusal that can't be read: {why}")),
    }
}

fn is_protobuf(answer: &Response) -> bool {
    answer
        .headers()
        .get(CONTENT_TYPE)
        .is_some_and(|kind| kind == PROTOBUF)
}

fn is_this_machine(url: &Url) -> bool {
    let host = url.host_str().unwrap_or_default().trim_matches(['[', ']']);
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

/// The innermost cause, which is the same for all frames that it happens to.
fn root(error: &dyn std::error::Error) -> String {
    let mut cause = error;
    while let Some(inner) = cause.source() {
        cause = inner;
    }
    cause.to_string()
}

/// A request in two pieces, of which the large one is shared and not copied.
struct PairBody {
    pieces: [Bytes; 2],
}

impl Body for PairBody {
    type Data = Bytes;
    type Error = std::convert::Infallible;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        _: &mut TaskContext<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Self::Error>>> {
        let piece = self.pieces.iter_mut().find(|piece| !piece.is_empty());
        Poll::Ready(piece.map(|piece| Ok(Frame::data(std::mem::take(piece)))))
    }

    fn is_end_stream(&self) -> bool {
        self.pieces.iter().all(Bytes::is_empty)
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::with_exact(self.pieces.iter().map(|piece| piece.len() as u64).sum())
    }
}
