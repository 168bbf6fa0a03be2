//! What holds for any message and any bytes.

use bytes::Bytes;
use proptest::prelude::{Just, Strategy, any, prop_oneof, proptest};
use proptest::{collection, option};
use prost::Message;
use stereo_proto::v1::{
    BatchReply, Calibration, Image, MeshOptions, Options, Region, Status, StereoRequest, StereoResult,
};

fn bytes() -> impl Strategy<Value = Bytes> {
    collection::vec(any::<u8>(), 0..200).prop_map(Bytes::from)
}

fn image() -> impl Strategy<Value = Image> {
    (any::<(u32, u32, i32, u32)>(), ".{0,20}", bytes()).prop_map(
        |((width, height, encoding, step), frame_id, data)| Image {
            timestamp: None,
            frame_id,
            width,
            height,
            encoding,
            step,
            data,
        },
    )
}

/// A number that equals itself.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![Just(0.0), Just(f64::INFINITY), proptest::num::f64::NORMAL]
}

fn options() -> impl Strategy<Value = Options> {
    let enums = (any::<[i32; 4]>(), collection::vec(any::<i32>(), 0..6));
    let numbers = (
        any::<(Option<u32>, Option<u32>, Option<i32>)>(),
        option::of(number()),
        any::<Option<(u32, u32, u32, u32)>>(),
    );
    let rest = any::<(Option<(i64, i32)>, Option<bool>, Option<bool>, i32)>();
    (enums, numbers, rest).prop_map(
        |(([a, b, c, d], outputs), (ints, confidence, roi), rest)| Options {
            latency_budget: rest
                .0
                .map(|(seconds, nanos)| prost_types::Duration { seconds, nanos }),
            max_iterations: ints.0,
            preset: a,
            #[expect(clippy::cast_possible_truncation, reason = "any number will do")]
            min_confidence: confidence.map(|number| number as f32),
            num_disparities: ints.1,
            min_disparity: ints.2,
            density: b,
            roi: roi.map(|(x, y, width, height)| Region { x, y, width, height }),
            priority_class: c,
            outputs,
            disparity_encoding: d,
            compression: rest.3,
            allow_downscale: rest.1,
            mesh: rest.2.map(|keep| MeshOptions {
                keep_rejected: Some(keep),
                ..MeshOptions::default()
            }),
            colors: rest.2,
            mesh_is_optional: None,
            focus: Vec::new(),
        },
    )
}

fn request() -> impl Strategy<Value = StereoRequest> {
    let ids = (".{0,20}", ".{0,20}", any::<Option<u64>>());
    let calibration = option::of([number(), number(), number(), number(), number()]);
    (
        ids,
        option::of(image()),
        option::of(image()),
        calibration,
        option::of(options()),
    )
        .prop_map(
            |((request_id, camera_id, sequence), left, right, calibration, options)| StereoRequest {
                request_id,
                camera_id,
                sequence,
                capture_time: None,
                left,
                right,
                calibration: calibration.map(|[focal_px, cx_px, cy_px, baseline_m, doffs_px]| Calibration {
                    focal_px,
                    cx_px,
                    cy_px,
                    baseline_m,
                    doffs_px,
                }),
                options,
            },
        )
}

proptest! {
    #[test]
    fn any_request_survives_the_wire(request in request()) {
        let decoded = StereoRequest::decode(Bytes::from(request.encode_to_vec()));
        assert_eq!(decoded.ok(), Some(request));
    }

    #[test]
    fn truncated_request_is_an_error_or_a_shorter_request_but_never_a_panic(request in request(), share in 0.0..1.0f64) {
        let mut bytes = request.encode_to_vec();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to the message's length")]
        bytes.truncate((bytes.len() as f64 * share) as usize);
        let _ = StereoRequest::decode(Bytes::from(bytes));
    }

    #[test]
    fn random_bytes_never_panic(bytes in bytes()) {
        let _ = StereoRequest::decode(bytes.clone());
        let _ = StereoResult::decode(bytes.clone());
        let _ = BatchReply::decode(bytes.clone());
        let _ = Status::decode(bytes);
    }
}
