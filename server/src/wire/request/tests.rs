use stereo_proto::v1::{Image, ImageEncoding, Options};

use super::*;

fn gray() -> Option<Image> {
    let data = Bytes::from(vec![9; 64 * 32]);
    let encoding = ImageEncoding::Mono8.into();
    Some(Image {
        width: 64,
        height: 32,
        encoding,
        data,
        ..Image::default()
    })
}

fn message() -> StereoRequest {
    StereoRequest {
        left: gray(),
        right: gray(),
        ..StereoRequest::default()
    }
}

fn intake() -> Intake {
    Intake {
        received_at: Instant::now(),
        latency_budget: None,
        request_id: String::new(),
        formats: vec![ReplyFormat::Protobuf],
        max_image_px: 1 << 24,
        caller: Caller::Stranger(String::new()),
        priority: PriorityClass::default(),
    }
}

fn refusal(message: StereoRequest) -> String {
    let error = frame_request(message, intake()).unwrap_err();
    assert_eq!(error.http_code(), 400, "{error}");
    error.to_string()
}

#[test]
fn what_is_echoed_arrives_and_pixels_are_not_copied() {
    let sent = StereoRequest {
        request_id: "frame 17/a".into(),
        camera_id: "rig-1.left_2".into(),
        sequence: Some(0),
        capture_time: Some(Timestamp {
            seconds: 1_700_000_000,
            nanos: 5,
        }),
        ..message()
    };
    let body = Bytes::from(sent.encode_to_vec());
    let request = frame_request(decode_request(body.clone()).unwrap(), intake()).unwrap();
    assert_eq!(request.ids.request_id, "frame 17/a");
    assert_eq!(request.ids.camera_id, "rig-1.left_2");
    assert_eq!(request.ids.sequence, Some(0));
    assert_eq!(
        request.ids.capture_time,
        Some(SystemTime::UNIX_EPOCH + Duration::new(1_700_000_000, 5))
    );
    assert_eq!(request.formats, [ReplyFormat::Protobuf]);
    assert!(
        body.as_ptr_range().contains(&request.left.data.as_ptr()),
        "the pixels were copied"
    );
    assert_eq!(
        request.deadline().unwrap() - request.received_at,
        Duration::from_millis(100)
    );
}

#[test]
fn left_images_timestamp_stands_in_for_the_capture_time() {
    let mut sent = message();
    let taken = Timestamp { seconds: 7, nanos: 0 };
    sent.left.as_mut().unwrap().timestamp = Some(taken);
    let request = frame_request(sent.clone(), intake()).unwrap();
    assert_eq!(
        request.ids.capture_time,
        Some(SystemTime::UNIX_EPOCH + Duration::from_secs(7))
    );
    sent.capture_time = Some(Timestamp { seconds: 8, nanos: 0 });
    let request = frame_request(sent, intake()).unwrap();
    assert_eq!(
        request.ids.capture_time,
        Some(SystemTime::UNIX_EPOCH + Duration::from_secs(8))
    );
}

#[test]
fn id_from_outside_counts_only_if_the_body_has_none() {
    let outside = Intake {
        request_id: "from-header".into(),
        ..intake()
    };
    let request = frame_request(message(), outside.clone()).unwrap();
    assert_eq!(request.ids.request_id, "from-header");
    let sent = StereoRequest {
        request_id: "from-body".into(),
        ..message()
    };
    assert_eq!(frame_request(sent, outside).unwrap().ids.request_id, "from-body");
}

#[test]
fn ids_of_other_characters_or_lengths_are_refused() {
    for id in ["x".repeat(129), "line\nbreak".into(), "größe".into()] {
        let text = refusal(StereoRequest {
            request_id: id,
            ..message()
        });
        assert!(text.contains("request_id must be at most 128"), "{text}");
        assert!(!text.contains('\n') && text.len() < 200, "{text}");
    }
    for id in ["x".repeat(65), "a/b".into(), "a b".into(), "é".into(), "*".into()] {
        let text = refusal(StereoRequest {
            camera_id: id,
            ..message()
        });
        assert!(text.contains("camera_id must be at most 64"), "{text}");
    }
}

#[test]
fn times_no_calendar_knows_are_refused() {
    for (seconds, nanos) in [
        (i64::MAX, 0),
        (i64::MIN, 0),
        (0, -1),
        (0, 1_000_000_000),
        (253_402_300_800, 0),
    ] {
        let text = refusal(StereoRequest {
            capture_time: Some(Timestamp { seconds, nanos }),
            ..message()
        });
        assert!(text.contains("capture_time"), "{text}");
    }
    let ancient = Some(Timestamp {
        seconds: -62_135_596_800,
        nanos: 0,
    });
    assert!(
        frame_request(
            StereoRequest {
                capture_time: ancient,
                ..message()
            },
            intake()
        )
        .is_ok()
    );
}

#[test]
fn bytes_that_are_no_message_are_refused_saying_where_the_schema_is() {
    let mut bytes = message().encode_to_vec();
    bytes.truncate(100);
    for body in [
        Bytes::from(bytes),
        Bytes::from_static(b"<html>"),
        Bytes::from_static(&[0xff; 20]),
    ] {
        let error = decode_request(body).unwrap_err();
        assert_eq!(error.http_code(), 400);
        assert!(error.to_string().contains("/v1/schema.binpb"), "{error}");
    }
    let text = refusal(decode_request(Bytes::new()).unwrap());
    assert!(text.contains("left image is missing"), "{text}");
}

#[test]
fn bad_calibration_and_bad_options_are_refused() {
    let calibration = Some(stereo_proto::v1::Calibration {
        focal_px: f64::NAN,
        ..Default::default()
    });
    assert!(
        refusal(StereoRequest {
            calibration,
            ..message()
        })
        .contains("calibration.focal_px")
    );
    let options = Some(Options {
        max_iterations: Some(0),
        ..Options::default()
    });
    assert!(refusal(StereoRequest { options, ..message() }).contains("max_iterations"));
}
