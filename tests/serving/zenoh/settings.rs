//! Settings of cameras: read, changed while frames come, refused.

use prost::Message;
use stereo_proto::v1;
use zenoh::Session;
use zenoh::bytes::Encoding;

use super::network::{Network, numbered};
use crate::conversation::{calibration, message};

/// Asks for a camera's settings, or changes them.
async fn ask(
    session: &Session,
    camera: &str,
    payload: Option<(&str, Vec<u8>)>,
) -> Result<v1::CameraSettings, v1::Status> {
    let mut query = session.get(format!("stereo/v1/settings/{camera}"));
    if let Some((encoding, payload)) = payload {
        query = query.payload(payload).encoding(Encoding::from(encoding));
    }
    let replies = query.await.expect("an open session");
    let reply = replies.recv_async().await.expect("one answer");
    let answer = match reply.result() {
        Ok(sample) => {
            let settings = v1::CameraSettings::decode(&*sample.payload().to_bytes());
            Ok(settings.expect("CameraSettings"))
        }
        Err(error) => Err(v1::Status::decode(&*error.payload().to_bytes()).expect("a Status")),
    };
    assert!(replies.recv_async().await.is_err(), "more than one answer");
    answer
}

/// Changes the settings of a camera.
pub(super) async fn set(
    session: &Session,
    camera: &str,
    settings: &v1::CameraSettings,
) -> Result<v1::CameraSettings, v1::Status> {
    let encoding = "application/protobuf;stereo.v1.CameraSettings";
    ask(session, camera, Some((encoding, settings.encode_to_vec()))).await
}

#[tokio::test(flavor = "multi_thread")]
async fn settings_change_while_frames_come_and_the_answer_says_what_is_in_force() {
    let network = Network::start(&[]).await;
    let camera = network.camera("front").await;
    let bare = |sequence| v1::StereoRequest {
        options: None,
        ..numbered(sequence)
    };
    let before = ask(&network.session, "front", None).await.expect("settings");
    assert_eq!((before.revision, before.options), (0, None));
    let options = v1::Options {
        preset: v1::Preset::Fast.into(),
        max_iterations: Some(1),
        ..message().options.expect("test options")
    };
    let settings = v1::CameraSettings {
        options: Some(options.clone()),
        calibration: Some(calibration()),
        ..v1::CameraSettings::default()
    };
    let after = set(&network.session, "front", &settings)
        .await
        .expect("good settings");
    assert_eq!(
        (after.revision, after.options, after.calibration),
        (1, Some(options), Some(calibration()))
    );
    camera.put(&bare(1)).await;
    let result = camera.result().await;
    let report = result.report.expect("always present");
    assert_eq!((report.iterations_asked, report.rung.as_str()), (1, "mesh-16"));
    assert_eq!(
        result.mesh.expect("a default output").space(),
        v1::MeshSpace::Metres
    );

    // A frame's own options win, but never have more time than the camera.
    camera
        .put(&v1::StereoRequest {
            options: Some(v1::Options {
                latency_budget: Some(prost_types::Duration {
                    seconds: 50,
                    nanos: 0,
                }),
                max_iterations: Some(2),
                ..v1::Options::default()
            }),
            ..numbered(2)
        })
        .await;
    let report = camera.result().await.report.expect("always present");
    assert_eq!(report.iterations_asked, 2);
    assert_eq!(report.budget.map(|budget| budget.seconds), Some(50));
    assert_eq!(network.stream("front").await["settings_revision"], 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_settings_are_refused_by_name_and_change_nothing() {
    let network = Network::start(&[]).await;
    let refused = set(
        &network.session,
        "front",
        &v1::CameraSettings {
            options: Some(v1::Options {
                max_iterations: Some(0),
                ..v1::Options::default()
            }),
            ..v1::CameraSettings::default()
        },
    )
    .await
    .expect_err("no iteration at all");
    assert_eq!((refused.code, refused.reason()), (400, v1::Reason::Invalid));
    assert!(refused.message.contains("max_iterations"), "{}", refused.message);
    for (encoding, payload, code) in [
        (
            "application/protobuf;stereo.v1.CameraSettings",
            vec![0xff; 9],
            400,
        ),
        ("text/plain", b"hello".to_vec(), 415),
    ] {
        let refused = ask(&network.session, "front", Some((encoding, payload)))
            .await
            .expect_err("garbage");
        assert_eq!(refused.code, code, "{}", refused.message);
    }
    let unchanged = ask(&network.session, "front", None).await.expect("settings");
    assert_eq!(unchanged.revision, 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_of_the_configuration_needs_no_announcement() {
    let file = std::env::temp_dir().join(format!("stereod-cameras-{}.toml", std::process::id()));
    let text = "[zenoh.cameras.rear]\nlatency_budget_ms = 40000\nmax_iterations = 1\n";
    std::fs::write(&file, text).expect("a writable folder");
    let network = Network::start(&["--config", file.to_str().expect("ASCII")]).await;
    std::fs::remove_file(&file).expect("the test's own file");
    super::network::until_alive(&network.session, "stereo/v1/owner/rear/*").await;
    let settings = ask(&network.session, "rear", None).await.expect("settings");
    assert_eq!(
        settings.options.and_then(|options| options.max_iterations),
        Some(1)
    );
    let camera = network.camera("rear").await;
    camera
        .put(&v1::StereoRequest {
            options: None,
            ..numbered(1)
        })
        .await;
    let report = camera.result().await.report.expect("always present");
    assert_eq!(
        (report.iterations_run, report.budget.map(|budget| budget.seconds)),
        (1, Some(40))
    );
}
