//! One frame on several workers.

use serde_json::json;

use crate::conversation::Server;

#[tokio::test]
async fn split_frames_are_the_same_to_the_last_bit() {
    let alone = Server::start(&[]);
    let together = Server::with_workers("4", &["--split-frames", "on"]);
    together.until_ready().await;
    for preset in ["default", "fast", "paper"] {
        let options = json!({"preset": preset, "density": "dense"});
        let expected = alone.post_pair("image/png", options.clone()).await;
        assert_eq!(expected.status, 200, "{}", expected.text());
        for _ in 0..3 {
            let split = together.post_pair("image/png", options.clone()).await;
            assert_eq!(split.status, 200, "{}", split.text());
            assert!(split.body == expected.body, "{preset}: other bits");
        }
    }
}
