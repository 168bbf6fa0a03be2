//! Bad images: each gets the right status and a sentence that says what to do, and the next request is served as if
//! nothing had happened.

use serde_json::json;
use stereo_proto::v1;
use stereo_tests::gray::GrayImage;
use stereo_tests::render::RenderedPair;
use stereo_tests::scene::Scene;

use crate::conversation::{PAIR, PROTOBUF, Reply, Server, message};
use crate::files::{jpeg, jpeg_that_claims, png_that_claims};

async fn post_files(server: &Server, left: &[u8], right: &[u8]) -> Reply {
    server
        .post_form(
            "",
            "image/png",
            &[("left", left), ("right", right)],
            Some(json!({})),
        )
        .await
}

#[tokio::test]
async fn truncated_image_files_are_400() {
    let server = Server::start(&[]);
    let good = server.good().await;
    let (left, right) = (jpeg(&PAIR.rendered.left), jpeg(&PAIR.rendered.right));
    for share in [3, 20, 100, 1000] {
        let cut = &PAIR.left[..PAIR.left.len() * share / 1001];
        post_files(&server, cut, &PAIR.right)
            .await
            .assert_refused(400, &["left"]);
        let cut = &PAIR.right[..PAIR.right.len() * share / 1001];
        post_files(&server, &PAIR.left, cut)
            .await
            .assert_refused(400, &["right"]);
        let cut = &left[..left.len() * share / 1100];
        post_files(&server, cut, &right)
            .await
            .assert_refused(400, &["left"]);
        server.assert_serves(&good).await;
    }
    post_files(&server, b"", &PAIR.right)
        .await
        .assert_refused(400, &["left", "PNG", "JPEG"]);
    post_files(&server, &PAIR.left, b"GIF89a and more")
        .await
        .assert_refused(400, &["right", "PNG", "JPEG"]);
    server.assert_serves(&good).await;
}

#[tokio::test]
async fn a_header_that_claims_more_than_can_be_is_413_before_decoding() {
    let server = Server::start(&[]);
    let good = server.good().await;
    let huge = png_that_claims(100_000, 100_000, b"no pixels");
    post_files(&server, &huge, &huge)
        .await
        .assert_refused(413, &["left", "100000 x 100000"]);
    let left = jpeg(&PAIR.rendered.left);
    let huge = jpeg_that_claims(65_500, 65_500, &left);
    post_files(&server, &huge, &huge)
        .await
        .assert_refused(413, &["left", "65500 x 65500"]);
    let mut raw = message();
    let image = raw.left.as_mut().expect("it has one");
    (image.width, image.height) = (100_000, 100_000);
    let reply = server
        .post_message("application/problem+json, image/png", &raw)
        .await;
    assert!([400, 413].contains(&reply.status), "{}", reply.text());
    server.assert_serves(&good).await;
}

#[tokio::test]
async fn a_size_that_can_never_be_matched_is_refused() {
    let server = Server::start(&[]);
    let good = server.good().await;
    for (width, height, status) in [(31, 200, 422), (8192, 64, 422), (0, 0, 400), (1 << 31, 1, 400)] {
        let file = png_that_claims(width, height, b"no pixels");
        let reply = post_files(&server, &file, &file).await;
        let is_refused = reply.status == status || (width > 1 << 20 && reply.status == 413);
        assert!(
            is_refused,
            "{width} x {height}: {} {}",
            reply.status,
            reply.text()
        );
    }
    server.assert_serves(&good).await;
}

#[tokio::test]
async fn a_file_whose_pixels_are_garbage_is_400() {
    let server = Server::start(&[]);
    let good = server.good().await;
    // As large as is accepted, with nothing behind it: must neither be filled up nor cost its size in time.
    let hollow = png_that_claims(4096, 4096, b"no pixels");
    post_files(&server, &hollow, &hollow)
        .await
        .assert_refused(400, &["left"]);
    // The header of a larger image on the pixels of a smaller one.
    let stretched = jpeg_that_claims(2048, 2048, &jpeg(&PAIR.rendered.left));
    let reply = post_files(&server, &stretched, &stretched).await;
    assert!(reply.status == 400 || reply.status == 200, "{}", reply.text());
    server.assert_serves(&good).await;
}

#[tokio::test]
async fn images_of_two_sizes_are_422() {
    let server = Server::start(&[]);
    let good = server.good().await;
    let small = GrayImage::new(64, 48, vec![9; 64 * 48])
        .expect("64 x 48")
        .to_png()
        .expect("a small image");
    post_files(&server, &PAIR.left, &small)
        .await
        .assert_refused(422, &["512 x 320", "64 x 48"]);
    let mut narrow = message();
    let right = narrow.right.as_mut().expect("it has one");
    right.width -= 2;
    right.data = right.data.slice(..(right.width * right.height) as usize);
    server
        .post_message("image/png, application/problem+json", &narrow)
        .await
        .assert_refused(422, &["510 x 320"]);
    server.assert_serves(&good).await;
}

#[tokio::test]
async fn a_missing_image_is_400() {
    let server = Server::start(&[]);
    let good = server.good().await;
    let options = || Some(json!({}));
    server
        .post_form("", "image/png", &[("left", &PAIR.left)], options())
        .await
        .assert_refused(400, &["right image"]);
    server
        .post_form("", "image/png", &[("right", &PAIR.right)], options())
        .await
        .assert_refused(400, &["left image"]);
    server
        .post_form("", "image/png", &[], options())
        .await
        .assert_refused(400, &["image"]);
    let lonely = v1::StereoRequest {
        right: None,
        ..message()
    };
    server
        .post_message("image/png, application/problem+json", &lonely)
        .await
        .assert_refused(400, &["right image"]);
    server.assert_serves(&good).await;
}

#[tokio::test]
async fn an_image_over_the_servers_own_limit_is_413() {
    let server = Server::start(&["--max-image-pixels", "100000"]);
    server.good().await.assert_refused(413, &["512 x 320", "100000"]);
}

#[tokio::test]
async fn a_textureless_pair_is_an_answer_with_zero_density() {
    let server = Server::start(&[]);
    let flat = RenderedPair::clean(&Scene::textureless());
    let (left, right) = (
        flat.left.to_png().expect("small"),
        flat.right.to_png().expect("small"),
    );
    let files: [(&str, &[u8]); 2] = [("left", &left), ("right", &right)];
    let reply = server
        .post_form("", "application/json", &files, Some(json!({})))
        .await;
    assert_eq!(reply.status, 200, "{}", reply.text());
    assert_eq!(reply.json()["report"]["density"], 0.0);
    assert_eq!(reply.json()["disparity"]["valid_pixels"], 0);
    let reply = server.post_form("", "image/png", &files, Some(json!({}))).await;
    assert!(reply.png16().iter().all(|&d| d == 0));
    // No triangle is left to show, so the other bodies must cope with an empty mesh.
    for accept in ["model/gltf-binary", "application/ply", PROTOBUF] {
        let reply = server.post_form("", accept, &files, Some(json!({}))).await;
        assert_eq!(
            (reply.status, reply.content_type.as_str()),
            (200, accept),
            "{}",
            reply.text()
        );
    }
}
