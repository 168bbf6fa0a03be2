//! Good input to start from: the files of `fuzz/corpus`, and how the first of them were made.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use image::{DynamicImage, GrayImage, ImageFormat, Rgb, RgbImage};
use prost::Message;
use stereo_proto::v1;

use crate::targets::form::BOUNDARY;

const WIDTH: u32 = 48;
const HEIGHT: u32 = 32;

/// Where the files are.
#[must_use]
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus")
}

/// The files of a target by their names, in order.
///
/// # Errors
/// If they can't be read.
pub fn files(target: &str) -> Result<Vec<(String, Vec<u8>)>> {
    let folder = folder().join(target);
    let entries = fs::read_dir(&folder).with_context(|| format!("can't read {}", folder.display()))?;
    let mut files = Vec::new();
    for entry in entries {
        let path = entry?.path();
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        files.push((name, fs::read(&path)?));
    }
    files.sort();
    Ok(files)
}

/// Writes the first files of every target. Those that were found later, each for a fault, stay.
///
/// # Errors
/// If they can't be written.
pub fn write() -> Result<()> {
    for (target, name, bytes) in seeds() {
        let folder = folder().join(target);
        fs::create_dir_all(&folder)?;
        fs::write(folder.join(name), bytes)?;
    }
    Ok(())
}

type Seed = (&'static str, &'static str, Vec<u8>);

fn seeds() -> Vec<Seed> {
    let raw = raw_request();
    let files = file_request();
    let delimited = |pieces: u8| {
        let messages = [&raw, &files].map(Message::encode_length_delimited_to_vec);
        [vec![pieces], messages.concat()].concat()
    };
    let mut seeds = vec![
        ("request", "raw", raw.encode_to_vec()),
        ("request", "files", files.encode_to_vec()),
        (
            "form",
            "whole",
            form_body(r#"{"latency_budget_ms": 80, "density": "dense"}"#),
        ),
        (
            "form",
            "focus",
            form_body(r#"{"focus": [{"x": 1, "y": 2, "width": 8, "height": 8, "weight": 2}]}"#),
        ),
        ("batch", "bytes", delimited(1)),
        ("batch", "pieces", delimited(200)),
        ("png", "gray", gray_png()),
        (
            "png",
            "gray16",
            encoded(&gray().to_luma16().into(), ImageFormat::Png),
        ),
        ("png", "rgb", encoded(&rgb(), ImageFormat::Png)),
        ("png", "rgba", encoded(&rgb().to_rgba8().into(), ImageFormat::Png)),
        ("jpeg", "gray", encoded(&gray(), ImageFormat::Jpeg)),
        ("jpeg", "rgb", encoded(&rgb(), ImageFormat::Jpeg)),
    ];
    seeds.extend(pixels());
    seeds.extend(words());
    seeds.extend(zenoh());
    seeds.extend(http());
    seeds
}

fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    // Memory doesn't run full here, and these formats hold these pixels.
    drop(image.write_to(&mut file, format));
    file.into_inner()
}

fn texture(x: u32, y: u32) -> u8 {
    (x.wrapping_mul(0x9e37_79b9) ^ y.wrapping_mul(0x85eb_ca6b)).to_be_bytes()[0] & 0xf0
}

fn gray() -> DynamicImage {
    GrayImage::from_fn(WIDTH, HEIGHT, |x, y| [texture(x, y)].into()).into()
}

fn rgb() -> DynamicImage {
    RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
        Rgb([texture(x, y), texture(y, x), texture(x + y, 1)])
    })
    .into()
}

/// A file that options can be tried with.
pub(crate) fn gray_png() -> Vec<u8> {
    encoded(&gray(), ImageFormat::Png)
}

fn calibration() -> v1::Calibration {
    v1::Calibration {
        focal_px: 40.0,
        cx_px: 24.0,
        cy_px: 16.0,
        baseline_m: 0.1,
        doffs_px: 0.0,
    }
}

fn raw_image() -> v1::Image {
    v1::Image {
        width: WIDTH,
        height: HEIGHT,
        encoding: v1::ImageEncoding::Mono8.into(),
        step: WIDTH,
        data: gray().into_bytes().into(),
        ..v1::Image::default()
    }
}

fn raw_request() -> v1::StereoRequest {
    v1::StereoRequest {
        request_id: "frame-1".to_owned(),
        camera_id: "front".to_owned(),
        sequence: Some(1),
        left: Some(raw_image()),
        right: Some(raw_image()),
        calibration: Some(calibration()),
        options: Some(options()),
        ..v1::StereoRequest::default()
    }
}

fn options() -> v1::Options {
    v1::Options {
        // What is tried here is whether the bytes are taken: that must not hang on how fast a machine is.
        latency_budget: Some(prost_types::Duration {
            seconds: 60,
            nanos: 0,
        }),
        max_iterations: Some(2),
        num_disparities: Some(16),
        min_confidence: Some(0.5),
        roi: Some(v1::Region {
            x: 2,
            y: 2,
            width: 40,
            height: 24,
        }),
        outputs: vec![v1::Output::Disparity.into(), v1::Output::Mesh.into()],
        ..v1::Options::default()
    }
}

fn file_request() -> v1::StereoRequest {
    let image = |format, encoding: v1::ImageEncoding| v1::Image {
        encoding: encoding.into(),
        data: encoded(&gray(), format).into(),
        ..v1::Image::default()
    };
    v1::StereoRequest {
        left: Some(image(ImageFormat::Png, v1::ImageEncoding::Png)),
        right: Some(image(ImageFormat::Jpeg, v1::ImageEncoding::Jpeg)),
        ..v1::StereoRequest::default()
    }
}

fn form_body(options: &str) -> Vec<u8> {
    let part = |name: &str, value: &[u8]| {
        let head = format!(
            "--{BOUNDARY}\r\nContent-Disposition: form-data; name=\"{name}\"; filename=\"{name}.png\"\r\n\r\n"
        );
        [head.as_bytes(), value, b"\r\n"].concat()
    };
    let file = gray_png();
    let end = format!("--{BOUNDARY}--\r\n");
    [
        part("left", &file),
        part("right", &file),
        part("options", options.as_bytes()),
        end.into_bytes(),
    ]
    .concat()
}

fn pixels() -> Vec<Seed> {
    let seed = |name, encoding: v1::ImageEncoding, bytes_per_px: u8| {
        let step = u16::from(bytes_per_px) * 32;
        let head = [&[encoding as u8, 32, 32], step.to_le_bytes().as_slice()].concat();
        ("pixels", name, [head, vec![90; usize::from(step) * 32]].concat())
    };
    vec![
        seed("mono8", v1::ImageEncoding::Mono8, 1),
        seed("mono16", v1::ImageEncoding::Mono16, 2),
        seed("bgr8", v1::ImageEncoding::Bgr8, 3),
        seed("rgba8", v1::ImageEncoding::Rgba8, 4),
        seed("yuyv", v1::ImageEncoding::Yuyv, 2),
    ]
}

fn words() -> Vec<Seed> {
    let json = [
        (
            "most",
            r#"{"latency_budget_ms": 80, "max_iterations": 3, "preset": "fast", "num_disparities": 64, "min_disparity": 0, "density": "dense", "min_confidence": 0.5, "roi": {"x": 0, "y": 0, "width": 32, "height": 32}, "outputs": ["disparity", "mesh"], "disparity_encoding": "png16", "mesh": {"tolerance_px": 2, "max_triangles": 1000, "keep_rejected": true}, "compression": "zstd", "allow_downscale": true, "priority_class": "best_effort"}"#,
        ),
        (
            "settings",
            r#"{"latency_budget_ms": 50, "calibration": {"focal_px": 500, "cx_px": 320, "cy_px": 240, "baseline_m": 0.1, "doffs_px": 1}, "pairing": {"key": "time", "tolerance_ms": 5, "patience_ms": 100}}"#,
        ),
        (
            "names",
            r#"{"request_id": "a/1", "camera_id": "front", "sequence": 9, "capture_time": "2026-01-02T03:04:05Z"}"#,
        ),
    ];
    let selectors = [
        ("both", "budget_ms=80;partial=true"),
        ("own", "_anyke;_time=[now(-1h)..now()];budget_ms=1"),
        ("number", "12.5"),
        ("grpc", "80m"),
        ("encoding", "application/protobuf;stereo.v1.StereoRequest"),
    ];
    let toml = "instance = \"front\"\n[http]\nlisten = \"127.0.0.1:8080\"\nconnections = 64\nheader_timeout_ms = 1000\n\
        [workers]\ncount = 2\nsimd = \"auto\"\npolicy = \"edf\"\n[limits]\nbody_bytes = 1048576\n[zenoh]\nenabled = true\n\
        connect = [\"tcp/router:7447\"]\n[zenoh.cameras.front]\npreset = \"fast\"\npairing = { tolerance_ms = 4 }\n";
    let json5 = "// Zenoh's\n{ mode: 'client', connect: { endpoints: [\"tls/router:7447\",] }, transport: { link: { tls: { \
        root_ca_certificate: '/ca.pem' } }, unicast: { max_links: 0x10, lease: 1e3 } } }\n";
    let bytes = |text: &str| text.as_bytes().to_vec();
    let mut seeds = Vec::from_iter(json.map(|(name, text)| ("options", name, bytes(text))));
    seeds.extend(selectors.map(|(name, text)| ("selector", name, bytes(text))));
    seeds.extend([("config", "toml", bytes(toml)), ("config", "json5", bytes(json5))]);
    seeds
}

fn zenoh() -> Vec<Seed> {
    let stamp = v1::ImageStamp {
        sequence: Some(7),
        timestamp: Some(prost_types::Timestamp { seconds: 1, nanos: 2 }),
    };
    let stamp = stamp.encode_to_vec();
    let seed = |name, kind: u8, attachment: &[u8], payload: Vec<u8>| {
        let attached = u8::try_from(attachment.len()).unwrap_or(u8::MAX);
        ("zenoh", name, [&[kind, attached], attachment, &payload].concat())
    };
    let settings = v1::CameraSettings {
        options: Some(options()),
        calibration: Some(calibration()),
        pairing: Some(v1::Pairing {
            key: v1::PairingKey::Time.into(),
            tolerance: Some(prost_types::Duration {
                seconds: 0,
                nanos: 5_000_000,
            }),
            patience: None,
        }),
        revision: 3,
    };
    vec![
        seed("image", 0, &stamp, raw_image().encode_to_vec()),
        seed("png", 1, &stamp, gray_png()),
        seed("jpeg", 2, &[], encoded(&gray(), ImageFormat::Jpeg)),
        seed("settings", 4, &[], settings.encode_to_vec()),
    ]
}

fn http() -> Vec<Seed> {
    let seed = |name, head: &str, body: Vec<u8>| ("http", name, [head.as_bytes(), b"\n\n", &body].concat());
    let form = format!("content-type: multipart/form-data; boundary={BOUNDARY}");
    let delimited = [raw_request(), file_request()].map(|message| message.encode_length_delimited_to_vec());
    vec![
        seed(
            "form",
            &format!("POST /v1/stereo?view=color\naccept: image/png\n{form}"),
            form_body("{}"),
        ),
        seed(
            "glb",
            &format!(
                "POST /v1/stereo\naccept: model/gltf-binary, */*;q=0.1\nx-latency-budget-ms: 60000\n{form}"
            ),
            form_body("{}"),
        ),
        seed(
            "protobuf",
            "POST /v1/stereo\ncontent-type: application/x-protobuf\ngrpc-timeout: 60S\nx-request-id: 7\ntraceparent: 00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01",
            raw_request().encode_to_vec(),
        ),
        seed(
            "batch",
            "POST /v1/stereo/batch\ncontent-type: application/x-protobuf; delimited=true",
            delimited.concat(),
        ),
        seed("info", "GET /v1/info\naccept: application/json", Vec::new()),
        seed(
            "absent-camera",
            "GET /v1/streams/front/latest?view=disparity",
            Vec::new(),
        ),
        seed("absent-events", "GET /v1/streams/front/events", Vec::new()),
        seed("metrics", "GET /metrics\naccept-encoding: gzip", Vec::new()),
        seed("description", "GET /openapi.json", Vec::new()),
    ]
}
