use super::*;

fn streams() -> Streams {
    Streams::new(&Arc::new(Metrics::new()))
}

fn reply() -> FrameReply {
    reply_that(true)
}

fn reply_that(deadline_met: bool) -> FrameReply {
    FrameReply {
        bodies: vec![b"body".as_slice().into()],
        report: Report {
            deadline_met,
            ..Report::default()
        },
        costs: None,
    }
}

#[test]
fn every_frame_is_answered_dropped_or_under_way() {
    let streams = streams();
    let stream = streams.open("front").unwrap();
    for _ in 0..5 {
        stream.received(false);
    }
    stream.answered(Some(1), &[ReplyFormat::Protobuf], reply());
    stream.dropped(Some(2), &ServiceError::Superseded);
    stream.dropped(Some(3), &ServiceError::Superseded);
    let view = serde_json::json!(StreamView::of(&stream));
    let frames = &view["frames"];
    assert_eq!(frames["received"], 5);
    assert_eq!(frames["answered"], 1);
    assert_eq!(frames["dropped"]["SUPERSEDED"], 2);
    assert_eq!(frames["under_way"], 2);
    assert_eq!(view["last_result"]["sequence"], 1);
}

#[test]
fn answers_after_the_budget_are_answers_and_late() {
    let streams = streams();
    let stream = streams.open("front").unwrap();
    for deadline_met in [true, false, true] {
        stream.received(false);
        stream.answered(None, &[ReplyFormat::Protobuf], reply_that(deadline_met));
    }
    let frames = &serde_json::json!(StreamView::of(&stream))["frames"];
    assert_eq!(
        (&frames["answered"], &frames["answered_late"]),
        (&3.into(), &1.into())
    );
}

#[test]
fn numbers_left_out_are_lost_frames_and_older_ones_are_late() {
    let streams = streams();
    let stream = streams.open("front").unwrap();
    assert!(stream.numbered(10));
    assert!(stream.numbered(13));
    assert!(!stream.numbered(13));
    assert!(!stream.numbered(12));
    assert_eq!(serde_json::json!(StreamView::of(&stream))["frames"]["lost"], 2);
    assert!(stream.numbered(14));
    let restarted = stream.numbered(1_000_000) && stream.numbered(0);
    assert!(restarted, "a camera that counts from the start again is followed");
}

#[test]
fn a_format_is_watched_as_long_as_somebody_waits_for_it() {
    let streams = streams();
    let stream = streams.open("front").unwrap();
    assert_eq!(stream.watched().count(), 0);
    let one = stream.watch(ReplyFormat::ColorPng);
    let two = stream.watch(ReplyFormat::ColorPng);
    drop(one);
    assert_eq!(stream.watched().collect::<Vec<_>>(), [ReplyFormat::ColorPng]);
    drop(two);
    assert_eq!(stream.watched().count(), 0);
    assert!(stream.watch(ReplyFormat::Ply).is_none());
}

#[test]
fn streams_of_cameras_that_have_gone_make_room() {
    let streams = streams();
    for camera in 0..MOST_STREAMS {
        assert!(streams.open(&camera.to_string()).is_some());
    }
    assert!(streams.open("one more").is_none());
    streams.close("7");
    assert!(streams.open("one more").is_some());
    assert!(streams.get("7").is_none());
    assert_eq!(streams.all().len(), MOST_STREAMS);
}

#[test]
fn who_listens_hears_what_happens() {
    let streams = streams();
    let stream = streams.open("front").unwrap();
    let mut events = stream.events();
    stream.answered(Some(1), &[ReplyFormat::Protobuf], reply());
    stream.dropped(None, &ServiceError::Superseded);
    let Event::Answered(seen) = events.try_recv().unwrap() else {
        panic!("a result came first")
    };
    assert_eq!(seen.bodies.get(ReplyFormat::Protobuf).unwrap(), &b"body"[..]);
    assert!(seen.bodies.get(ReplyFormat::Json).is_none());
    let (name, data) = event_json(&events.try_recv().unwrap());
    assert_eq!(
        (name, &data["reason"]),
        ("dropped", &serde_json::json!("SUPERSEDED"))
    );
}

#[test]
fn who_looks_slowly_keeps_no_memory_from_those_who_subscribe() {
    let streams = streams();
    let stream = streams.open("front").unwrap();
    let mut events = stream.events();
    let shared = Arc::new(());
    let answered = || {
        let body = Encoded::in_memory_of(Arc::clone(&shared), Bytes::from_static(b"shared"));
        let bodies = vec![body];
        stream.answered(
            Some(1),
            &[ReplyFormat::Protobuf],
            FrameReply { bodies, ..reply() },
        )
    };
    let mut seen = || match events.try_recv() {
        Ok(Event::Answered(seen)) => seen,
        _ => panic!("a result came"),
    };
    drop(answered());
    assert_eq!(
        Arc::strong_count(&shared),
        1,
        "neither events nor the last result hold it"
    );
    let unwatched = seen();
    assert!(unwatched.bodies.get(ReplyFormat::Protobuf).is_none());
    assert_eq!(unwatched.formats, [ReplyFormat::Protobuf]);
    let _watch = stream.watch(ReplyFormat::Protobuf).unwrap();
    drop(answered());
    assert_eq!(Arc::strong_count(&shared), 1);
    assert_eq!(seen().bodies.get(ReplyFormat::Protobuf).unwrap(), &b"shared"[..]);
}
