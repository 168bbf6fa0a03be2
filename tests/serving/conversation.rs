//! A server of its own for a test, and what is said to it.

use std::sync::LazyLock;
use std::time::Duration;

use image::{DynamicImage, ImageFormat};
use prost::Message;
use reqwest::header::{ACCEPT, CONTENT_TYPE};
use reqwest::multipart::{Form, Part};
use serde_json::{Value, json};
use stereo_proto::v1;
use stereo_tests::process::Stereod;
use stereo_tests::render::RenderedPair;
use stereo_tests::scene::Scene;
use tokio::task::JoinHandle;

pub(crate) const PROTOBUF: &str = "application/x-protobuf";
/// After this long nothing will happen any more, on the slowest machine.
const NEVER: Duration = Duration::from_secs(300);

/// A rendered pair as PNG files.
pub(crate) struct PngPair {
    pub(crate) rendered: RenderedPair,
    pub(crate) left: Vec<u8>,
    pub(crate) right: Vec<u8>,
}

/// The pair that all tests send: a ball in front of a wall, 512 x 320 px.
pub(crate) static PAIR: LazyLock<PngPair> = LazyLock::new(|| {
    let rendered = RenderedPair::clean(&Scene::sphere());
    let png = |image: &stereo_tests::gray::GrayImage| image.to_png().expect("a small image");
    PngPair {
        left: png(&rendered.left),
        right: png(&rendered.right),
        rendered,
    }
});

pub(crate) struct Server {
    pub(crate) process: Stereod,
    http: reqwest::Client,
}

impl Server {
    /// With one worker.
    pub(crate) fn start(args: &[&str]) -> Self {
        Self::with_workers("1", args)
    }

    pub(crate) fn with_workers(count: &str, args: &[&str]) -> Self {
        let args = [&["--workers", count], args].concat();
        // A proxy of the environment would not find a server on this machine.
        let http = stereo_tests::http::builder()
            .no_proxy()
            .build()
            .expect("a client without any setting");
        Self {
            process: Stereod::start(&args).expect("a server that starts"),
            http,
        }
    }

    pub(crate) async fn get(&self, path: &str) -> Reply {
        let request = self.http.get(format!("{}{path}", self.process.url()));
        Reply::of(request).await
    }

    /// The test pair as a form.
    pub(crate) async fn post_pair(&self, accept: &str, options: Value) -> Reply {
        self.post_form(
            "",
            accept,
            &[("left", &PAIR.left), ("right", &PAIR.right)],
            Some(options),
        )
        .await
    }

    /// Any parts as a form; `query` begins with `?` or is empty.
    pub(crate) async fn post_form(
        &self,
        query: &str,
        accept: &str,
        files: &[(&'static str, &[u8])],
        options: Option<Value>,
    ) -> Reply {
        let mut form = Form::new();
        for &(name, file) in files {
            form = form.part(name, Part::bytes(file.to_vec()).file_name(name));
        }
        if let Some(options) = options {
            form = form.text("options", with_time(options).to_string());
        }
        let url = format!("{}/v1/stereo{query}", self.process.url());
        Reply::of(self.http.post(url).header(ACCEPT, accept).multipart(form)).await
    }

    /// A protobuf message.
    pub(crate) async fn post_message(&self, accept: &str, message: &v1::StereoRequest) -> Reply {
        self.post_bytes(PROTOBUF, accept, message.encode_to_vec()).await
    }

    /// Any body.
    pub(crate) async fn post_bytes(&self, content_type: &str, accept: &str, body: Vec<u8>) -> Reply {
        let url = format!("{}/v1/stereo", self.process.url());
        let request = self
            .http
            .post(url)
            .header(CONTENT_TYPE, content_type)
            .header(ACCEPT, accept)
            .body(body);
        Reply::of(request).await
    }

    /// Sends a message while the test goes on.
    pub(crate) fn start_posting(&self, message: &v1::StereoRequest) -> JoinHandle<Reply> {
        let url = format!("{}/v1/stereo", self.process.url());
        let request = self
            .http
            .post(url)
            .header(CONTENT_TYPE, PROTOBUF)
            .body(message.encode_to_vec());
        tokio::spawn(Reply::of(request))
    }

    /// Sends the test pair and asserts that it gets the disparity it always gets.
    pub(crate) async fn assert_serves(&self, expected: &Reply) {
        let again = self.good().await;
        assert_eq!(again.status, 200, "{}", again.text());
        assert!(again.body == expected.body, "the same pair got another answer");
    }

    /// The value of a series in the metrics.
    pub(crate) async fn metric(&self, series: &str) -> f64 {
        let reply = self.get("/metrics").await;
        let text = String::from_utf8(reply.body).expect("text");
        let value = text
            .lines()
            .find_map(|line| line.strip_prefix(series)?.strip_prefix(' '));
        value
            .unwrap_or_else(|| panic!("no series {series} in\n{text}"))
            .parse()
            .expect("a number")
    }

    /// The values of a name's series with all labels, together.
    pub(crate) async fn metric_sum(&self, name: &str) -> f64 {
        let reply = self.get("/metrics").await;
        let text = String::from_utf8(reply.body).expect("text");
        let of_name = text
            .lines()
            .filter_map(|line| line.strip_prefix(name)?.strip_prefix('{'));
        let values = of_name.filter_map(|rest| rest.rsplit_once(' '));
        values
            .map(|(_, value)| value.parse::<f64>().expect("a number"))
            .sum()
    }

    /// Waits until a series has this value; fails if that never happens.
    pub(crate) async fn until(&self, series: &str, value: f64) {
        let reached = async {
            while self.metric(series).await < value {
                tokio::task::yield_now().await;
            }
        };
        if tokio::time::timeout(NEVER, reached).await.is_err() {
            let all = String::from_utf8(self.get("/metrics").await.body).expect("text");
            panic!("{series} did not get to {value}:\n{all}");
        }
    }

    /// Waits until a gauge is back at zero; fails if that never happens.
    pub(crate) async fn until_zero(&self, series: &str) {
        let reached = async {
            while self.metric(series).await != 0.0 {
                tokio::task::yield_now().await;
            }
        };
        let reached = tokio::time::timeout(NEVER, reached).await;
        assert!(reached.is_ok(), "{series} did not get back to 0");
    }

    /// Waits until the workers are primed.
    pub(crate) async fn until_ready(&self) {
        while self.get("/readyz").await.status != 200 {
            tokio::task::yield_now().await;
        }
    }

    /// The test pair's answer with all defaults.
    pub(crate) async fn good(&self) -> Reply {
        self.post_pair("image/png", json!({})).await
    }
}

/// The options with a budget that the slowest machine can keep, unless they have one.
fn with_time(mut options: Value) -> Value {
    if let Some(object) = options.as_object_mut() {
        object.entry("latency_budget_ms").or_insert(json!(60_000));
    }
    options
}

/// A message with the test pair as raw mono8, and as much time as there is.
pub(crate) fn message() -> v1::StereoRequest {
    let image = |image: &stereo_tests::gray::GrayImage| v1::Image {
        width: u32::try_from(image.width_px()).expect("small"),
        height: u32::try_from(image.height_px()).expect("small"),
        encoding: v1::ImageEncoding::Mono8.into(),
        data: image.pixels().to_vec().into(),
        ..v1::Image::default()
    };
    v1::StereoRequest {
        left: Some(image(&PAIR.rendered.left)),
        right: Some(image(&PAIR.rendered.right)),
        options: Some(v1::Options {
            latency_budget: Some(prost_types::Duration {
                seconds: 60,
                nanos: 0,
            }),
            ..v1::Options::default()
        }),
        ..v1::StereoRequest::default()
    }
}

/// The true geometry of the rendered pair.
pub(crate) fn calibration() -> v1::Calibration {
    let rig = stereo_tests::scene::Rig::STANDARD;
    let (cx_px, cy_px) = rig.principal_px();
    v1::Calibration {
        focal_px: rig.focal_px,
        cx_px,
        cy_px,
        baseline_m: rig.baseline_m,
        doffs_px: 0.0,
    }
}

pub(crate) struct Reply {
    pub(crate) status: u16,
    pub(crate) content_type: String,
    pub(crate) server_timing: String,
    pub(crate) body: Vec<u8>,
}

impl Reply {
    pub(crate) async fn of(request: reqwest::RequestBuilder) -> Self {
        Self::of_response(request.send().await.expect("an answer")).await
    }

    pub(crate) async fn of_response(response: reqwest::Response) -> Self {
        let header = |name: &str| {
            let value = response.headers().get(name);
            value
                .map(|v| v.to_str().expect("ASCII").to_owned())
                .unwrap_or_default()
        };
        Self {
            status: response.status().as_u16(),
            content_type: header("content-type"),
            server_timing: header("server-timing"),
            body: response.bytes().await.expect("a whole body").to_vec(),
        }
    }

    pub(crate) fn text(&self) -> String {
        String::from_utf8_lossy(&self.body[..self.body.len().min(500)]).into_owned()
    }

    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|why| panic!("{why} in {}", self.text()))
    }

    pub(crate) fn result(&self) -> v1::StereoResult {
        assert_eq!(self.status, 200, "{}", self.text());
        v1::StereoResult::decode(self.body.as_slice()).expect("a StereoResult")
    }

    /// The values of a 16-bit PNG.
    pub(crate) fn png16(&self) -> Vec<u16> {
        assert_eq!(self.status, 200, "{}", self.text());
        png16(&self.body)
    }

    /// Asserts a refusal as RFC 9457 has it, with a sentence that contains all of `words`.
    pub(crate) fn assert_refused(&self, status: u16, words: &[&str]) {
        assert_eq!(self.status, status, "{}", self.text());
        assert_eq!(self.content_type, "application/problem+json");
        let problem = self.json();
        assert_eq!(problem["status"], status);
        let detail = problem["detail"].as_str().expect("a sentence");
        assert!(detail.split_whitespace().count() >= 4, "no sentence: {detail}");
        for word in words {
            assert!(detail.contains(word), "{word:?} isn't in {detail:?}");
        }
    }
}

pub(crate) fn png16(file: &[u8]) -> Vec<u16> {
    match image::load_from_memory_with_format(file, ImageFormat::Png).expect("a PNG") {
        DynamicImage::ImageLuma16(gray) => gray.into_raw(),
        other => panic!("no 16-bit gray PNG: {:?}", other.color()),
    }
}
