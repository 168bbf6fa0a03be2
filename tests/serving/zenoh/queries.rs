//! Requests with an answer.

use prost::Message;
use stereo_proto::v1;
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::query::ConsolidationMode;

use super::network::{Network, REQUEST, assert_is_of_the_pair};
use crate::conversation::message;

pub(super) type Answer = Result<v1::StereoResult, v1::Status>;

/// Everything that is replied to a query.
pub(super) async fn ask(
    session: &Session,
    selector: &str,
    encoding: &str,
    payload: Option<Vec<u8>>,
) -> Vec<Answer> {
    let mut query = session
        .get(selector)
        .consolidation(ConsolidationMode::None)
        .timeout(std::time::Duration::from_secs(120));
    if let Some(payload) = payload {
        query = query.payload(payload).encoding(Encoding::from(encoding));
    }
    let replies = query.await.expect("an open session");
    let mut answers = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        answers.push(match reply.result() {
            Ok(sample) => {
                let result = v1::StereoResult::decode(&*sample.payload().to_bytes());
                Ok(result.expect("a StereoResult"))
            }
            Err(error) => {
                assert_eq!(
                    error.encoding().to_string(),
                    "application/protobuf;stereo.v1.Status"
                );
                Err(v1::Status::decode(&*error.payload().to_bytes()).expect("a Status"))
            }
        });
    }
    answers
}

/// The only answer to a request.
pub(super) async fn compute(session: &Session, selector: &str, request: &v1::StereoRequest) -> Answer {
    let mut answers = ask(session, selector, REQUEST, Some(request.encode_to_vec())).await;
    assert_eq!(answers.len(), 1, "{answers:?}");
    answers.remove(0)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_is_answered_under_the_shared_key_and_under_the_servers_own() {
    let network = Network::start(&[]).await;
    let expected = network.server.good().await;
    for key in ["stereo/v1/compute", "stereo/v1/compute/stereod"] {
        let request = v1::StereoRequest {
            request_id: key.to_owned(),
            ..message()
        };
        let result = compute(&network.session, key, &request).await.expect("a result");
        assert_eq!(result.request_id, key);
        assert_is_of_the_pair(&result, &expected);
    }
    let nobody = ask(
        &network.session,
        "stereo/v1/compute/another",
        REQUEST,
        Some(message().encode_to_vec()),
    )
    .await;
    assert!(nobody.is_empty(), "{nobody:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_smallest_budget_counts_and_one_that_cannot_be_met_is_refused() {
    let network = Network::start(&[]).await;
    let selector = "stereo/v1/compute?budget_ms=45000";
    let result = compute(&network.session, selector, &message())
        .await
        .expect("a result");
    let budget = result.report.and_then(|report| report.budget);
    assert_eq!(budget.map(|budget| budget.seconds), Some(45));
    let selector = "stereo/v1/compute?budget_ms=0.001";
    let request = v1::StereoRequest {
        request_id: "late".to_owned(),
        ..message()
    };
    let refused = compute(&network.session, selector, &request)
        .await
        .expect_err("no time at all");
    assert_eq!(refused.code, 504, "{}", refused.message);
    assert_eq!(refused.request_id, "late");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_a_request_is_refused_with_a_status() {
    let network = Network::start(&["--max-body-bytes", "500000"]).await;
    let huge = vec![0; 500_001];
    for (selector, encoding, payload, code, word) in [
        (
            "stereo/v1/compute",
            REQUEST,
            Some(vec![0xff; 100]),
            400,
            "StereoRequest",
        ),
        ("stereo/v1/compute", REQUEST, None, 400, "payload"),
        (
            "stereo/v1/compute",
            "image/png",
            Some(message().encode_to_vec()),
            415,
            "image/png",
        ),
        (
            "stereo/v1/compute",
            REQUEST,
            Some(v1::StereoRequest::default().encode_to_vec()),
            400,
            "image",
        ),
        ("stereo/v1/compute", REQUEST, Some(huge), 413, "500000"),
        (
            "stereo/v1/compute?preset=fast",
            REQUEST,
            Some(message().encode_to_vec()),
            400,
            "preset=fast",
        ),
    ] {
        let answers = ask(&network.session, selector, encoding, payload).await;
        let [Err(status)] = answers.as_slice() else {
            panic!("{word}: {answers:?}")
        };
        assert_eq!(status.code, code, "{}", status.message);
        assert!(status.message.contains(word), "{word}: {}", status.message);
    }
    compute(&network.session, "stereo/v1/compute", &message())
        .await
        .expect("the server goes on");
}

#[tokio::test(flavor = "multi_thread")]
async fn partial_results_come_before_the_whole_one_and_do_not_change_it() {
    let network = Network::start(&[]).await;
    let selector = "stereo/v1/compute?partial=true";
    let answers = ask(
        &network.session,
        selector,
        REQUEST,
        Some(message().encode_to_vec()),
    )
    .await;
    let results: Vec<_> = answers
        .into_iter()
        .map(|answer| answer.expect("a result"))
        .collect();
    let rungs: Vec<u32> = results
        .iter()
        .map(|result| result.report.as_ref().map_or(0, |report| report.iterations_run))
        .collect();
    assert!(rungs.len() > 1 && rungs.is_sorted(), "{rungs:?}");
    assert_eq!(rungs[0], 1, "base comes first");
    assert_eq!(rungs.last(), Some(&3));
    let whole = compute(&network.session, "stereo/v1/compute", &message())
        .await
        .expect("a result");
    let last = results.last().expect("more than one");
    assert!(last.disparity == whole.disparity && last.mesh == whole.mesh);
    assert!(results[0].disparity != whole.disparity);
}
