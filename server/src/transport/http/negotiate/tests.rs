use super::*;

fn headers(accept: &str, content_type: &str) -> HeaderMap {
    let mut headers = HeaderMap::new();
    for (name, value) in [(ACCEPT, accept), (CONTENT_TYPE, content_type)] {
        if !value.is_empty() {
            headers.insert(name, value.parse().unwrap());
        }
    }
    headers
}

fn format(accept: &str) -> ReplyFormat {
    reply(&headers(accept, ""), None).unwrap().format
}

#[test]
fn protobuf_is_what_a_client_gets_that_has_no_wish() {
    assert_eq!(format(""), ReplyFormat::Protobuf);
    assert_eq!(format("*/*"), ReplyFormat::Protobuf);
    assert_eq!(format("text/html, */*;q=0.1"), ReplyFormat::Protobuf);
}

#[test]
fn the_highest_quality_wins_then_the_exactest_name_then_our_order() {
    assert_eq!(
        format("image/png;q=0.5, application/json;q=0.9"),
        ReplyFormat::Json
    );
    assert_eq!(format("*/*, image/png"), ReplyFormat::DisparityPng);
    assert_eq!(format("application/ply, model/gltf-binary"), ReplyFormat::Glb);
    assert_eq!(format("model/*"), ReplyFormat::Glb);
    assert_eq!(
        format("application/*, application/x-protobuf;q=0, application/protobuf;q=0"),
        ReplyFormat::Json
    );
    assert_eq!(format("Image/PNG; q=1.000"), ReplyFormat::DisparityPng);
}

#[test]
fn both_names_of_protobuf_are_answered_by_the_name_that_was_asked() {
    let reply = reply(&headers("application/protobuf", ""), None).unwrap();
    assert_eq!(
        reply,
        Reply {
            format: ReplyFormat::Protobuf,
            media_type: "application/protobuf"
        }
    );
}

#[test]
fn a_view_asks_for_a_picture() {
    let with = |accept: &str, view| reply(&headers(accept, ""), Some(view)).map(|reply| reply.format);
    assert_eq!(with("image/png", "color"), Ok(ReplyFormat::ColorPng));
    assert_eq!(with("*/*", "color"), Ok(ReplyFormat::ColorPng));
    assert_eq!(with("", "disparity"), Ok(ReplyFormat::DisparityPng));
    assert_eq!(with("application/json", "color").unwrap_err().http_code(), 406);
    assert_eq!(with("image/png", "sideways").unwrap_err().http_code(), 400);
}

#[test]
fn what_cannot_be_made_is_406_naming_what_can() {
    for accept in ["text/html", "image/png;q=0", "video/*"] {
        let error = reply(&headers(accept, ""), None).unwrap_err();
        assert_eq!(error.http_code(), 406);
        let text = error.to_string();
        assert!(
            text.contains(accept)
                && TYPES
                    .iter()
                    .all(|(name, _)| name == &TYPES[1].0 || text.contains(name))
        );
    }
}

#[test]
fn a_malformed_accept_is_refused() {
    for accept in [
        "image/png;q=2",
        "image/png;q=0.1234",
        "image/png;q=x",
        "png",
        "image/png;q=-1",
        "/",
        "*;q=1",
    ] {
        assert_eq!(
            reply(&headers(accept, ""), None).unwrap_err().http_code(),
            400,
            "{accept}"
        );
    }
}

#[test]
fn refusals_come_in_the_form_that_was_asked_for_else_in_the_requests_own() {
    let form = |accept, content_type| refusal_form(&headers(accept, content_type));
    let multipart = "multipart/form-data; boundary=x";
    assert_eq!(form("", multipart), RefusalForm::Problem);
    assert_eq!(form("*/*", multipart), RefusalForm::Problem);
    assert_eq!(form("image/png", multipart), RefusalForm::Problem);
    assert_eq!(form("application/x-protobuf", multipart), RefusalForm::Status);
    assert_eq!(
        form("application/x-protobuf, application/problem+json", multipart),
        RefusalForm::Problem
    );
    assert_eq!(
        form("application/x-protobuf, application/json", multipart),
        RefusalForm::Status
    );
    assert_eq!(form("", PROTOBUF), RefusalForm::Status);
    assert_eq!(form("*/*", "application/protobuf"), RefusalForm::Status);
    assert_eq!(form("application/json", PROTOBUF), RefusalForm::Problem);
    assert_eq!(form("image/png", PROTOBUF), RefusalForm::Status);
    assert_eq!(form("not a media type", multipart), RefusalForm::Problem);
}

#[test]
fn a_whole_frame_is_protobuf_or_nothing() {
    for accept in [
        "",
        "*/*",
        "application/x-protobuf;q=0.9, application/problem+json",
    ] {
        let reply = whole_frame(&headers(accept, "")).unwrap();
        assert_eq!(
            (reply.format, reply.media_type),
            (ReplyFormat::StreamView, PROTOBUF)
        );
    }
    let refused = whole_frame(&headers("image/png", ""));
    assert!(matches!(refused, Err(ServiceError::NotAcceptable { .. })));
}
