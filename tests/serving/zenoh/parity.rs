//! The same frame gets the same answer, whatever way it comes.

use stereo_proto::v1;

use super::network::{Network, numbered};
use super::queries::compute;
use crate::conversation::PROTOBUF;

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_has_byte_equal_results_over_http_and_over_zenoh() {
    let network = Network::start(&[]).await;
    let camera = network.camera("front").await;
    let mut sequence = 0;
    for preset in [v1::Preset::Default, v1::Preset::Fast, v1::Preset::Paper] {
        for iterations in [1, 2, 4] {
            sequence += 1;
            let mut request = numbered(sequence);
            let options = request.options.as_mut().expect("test options");
            options.set_preset(preset);
            options.max_iterations = Some(iterations);
            let over_http = network.server.post_message(PROTOBUF, &request).await.result();
            let asked = compute(&network.session, "stereo/v1/compute", &request)
                .await
                .expect("a result");
            camera.put(&request).await;
            let streamed = camera.result().await;
            let name = format!("{preset:?}, {iterations} iterations");
            for other in [asked, streamed] {
                assert!(
                    over_http.disparity == other.disparity,
                    "{name}: another disparity"
                );
                assert!(over_http.mesh == other.mesh, "{name}: another mesh");
            }
        }
    }
}
