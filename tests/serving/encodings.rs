//! Every way to send an image and to get a disparity says the same.

use serde_json::json;
use stereo_proto::v1;
use stereo_tests::gray::GrayImage;

use crate::conversation::{PAIR, PROTOBUF, Server, calibration, message, png16};
use crate::files::jpeg;

type Encode = fn(u8) -> Vec<u8>;

/// Raw layouts of a gray value; colours that are gray have that luma exactly.
const RAW: [(v1::ImageEncoding, Encode); 6] = [
    (v1::ImageEncoding::Mono16, |g| vec![0x5a, g]),
    (v1::ImageEncoding::Rgb8, |g| vec![g; 3]),
    (v1::ImageEncoding::Bgr8, |g| vec![g; 3]),
    (v1::ImageEncoding::Rgba8, |g| vec![g, g, g, 3]),
    (v1::ImageEncoding::Bgra8, |g| vec![g, g, g, 200]),
    (v1::ImageEncoding::Yuyv, |g| vec![g, 128]),
];

fn with_images(make: impl Fn(&GrayImage, &mut v1::Image)) -> v1::StereoRequest {
    let mut request = message();
    make(&PAIR.rendered.left, request.left.as_mut().expect("it has one"));
    make(&PAIR.rendered.right, request.right.as_mut().expect("it has one"));
    request
}

#[tokio::test]
async fn all_lossless_encodings_give_the_same_disparity() {
    let server = Server::start(&[]);
    let expected = server.post_message("image/png", &message()).await.png16();
    assert!(expected.iter().filter(|&&d| d > 0).count() > 50_000);
    assert_eq!(server.good().await.png16(), expected, "PNG files in a form");
    for (encoding, encode) in RAW {
        let request = with_images(|gray, image| {
            image.encoding = encoding.into();
            image.data = gray
                .pixels()
                .iter()
                .flat_map(|&g| encode(g))
                .collect::<Vec<u8>>()
                .into();
        });
        assert_eq!(
            server.post_message("image/png", &request).await.png16(),
            expected,
            "{encoding:?}"
        );
    }
    let padded = with_images(|gray, image| {
        image.step = image.width + 13;
        let rows = gray.pixels().chunks(gray.width_px());
        image.data = rows
            .flat_map(|row| [row, &[255; 13]].concat())
            .collect::<Vec<u8>>()
            .into();
    });
    assert_eq!(
        server.post_message("image/png", &padded).await.png16(),
        expected,
        "rows with padding"
    );
    let files = with_images(|gray, image| {
        let data = gray.to_png().expect("small").into();
        *image = v1::Image {
            encoding: v1::ImageEncoding::Png.into(),
            data,
            ..v1::Image::default()
        };
    });
    assert_eq!(
        server.post_message("image/png", &files).await.png16(),
        expected,
        "PNG in a message"
    );
}

#[tokio::test]
async fn jpeg_gives_nearly_the_same_disparity() {
    let server = Server::start(&[]);
    let expected = server.good().await.png16();
    let (left, right) = (jpeg(&PAIR.rendered.left), jpeg(&PAIR.rendered.right));
    let files: [(&str, &[u8]); 2] = [("left", &left), ("right", &right)];
    let got = server
        .post_form("", "image/png", &files, Some(json!({})))
        .await
        .png16();
    let both: Vec<(u16, u16)> = got
        .into_iter()
        .zip(expected)
        .filter(|&(a, b)| a > 0 && b > 0)
        .collect();
    let near = both.iter().filter(|(a, b)| a.abs_diff(*b) <= 256).count();
    assert!(
        both.len() > 50_000 && near * 100 > both.len() * 95,
        "{near} of {}",
        both.len()
    );
}

#[tokio::test]
async fn all_output_encodings_say_the_same() {
    let server = Server::start(&[]);
    let mut request = message();
    request.calibration = Some(calibration());
    let expected = server.post_message("image/png", &request).await.png16();
    let mut ask = async |encoding: v1::DisparityEncoding| {
        let options = request.options.as_mut().expect("it has them");
        options.disparity_encoding = encoding.into();
        options.outputs = [v1::Output::Disparity, v1::Output::Depth, v1::Output::Points]
            .map(Into::into)
            .to_vec();
        server.post_message(PROTOBUF, &request).await.result()
    };
    let u16s = ask(v1::DisparityEncoding::U16)
        .await
        .disparity
        .expect("it was asked for")
        .data;
    let u16s: Vec<u16> = u16s
        .chunks_exact(2)
        .map(|b| u16::from_le_bytes([b[0], b[1]]))
        .collect();
    assert_eq!(u16s, expected);
    assert_eq!(
        png16(
            &ask(v1::DisparityEncoding::Png16)
                .await
                .disparity
                .expect("asked")
                .data
        ),
        expected
    );
    let result = ask(v1::DisparityEncoding::F32).await;
    let f32s = floats(&result.disparity.expect("it was asked for").data);
    let depths = floats(&result.depth.expect("it was asked for").data);
    assert_eq!((f32s.len(), depths.len()), (expected.len(), expected.len()));
    let calibration = calibration();
    for ((&fixed, px), depth_m) in expected.iter().zip(f32s).zip(depths) {
        assert_eq!(fixed == 0, px.is_nan());
        assert_eq!(fixed == 0, depth_m.is_nan());
        if fixed > 0 {
            assert!((px - f32::from(fixed) / 256.0).abs() < 1.0 / 256.0);
            let expected_m = calibration.focal_px * calibration.baseline_m / f64::from(px);
            assert!(
                (f64::from(depth_m) / expected_m - 1.0).abs() < 1e-4,
                "{depth_m} m for {px} px"
            );
        }
    }
    let points = floats(&result.points.expect("it was asked for").positions);
    assert_eq!(points.len(), 3 * expected.iter().filter(|&&d| d > 0).count());
    let is_inside = |p: &[f32]| p[2] > 1.0 && p[2] < 9.0 && p[0].abs() < p[2] && p[1].abs() < p[2];
    let inside = points.chunks_exact(3).filter(|p| is_inside(p)).count();
    assert!(
        inside * 300 > points.len() * 98,
        "{inside} of {} points are in the room",
        points.len() / 3
    );
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .collect()
}
