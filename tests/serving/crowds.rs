//! Many connections at once.

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use crate::conversation::{PROTOBUF, Server, message};

async fn connect(server: &Server) -> TcpStream {
    let address = server.process.url().trim_start_matches("http://").to_owned();
    TcpStream::connect(address).await.expect("a listening server")
}

#[tokio::test]
async fn connections_that_say_nothing_make_room_for_those_that_do() {
    let server = Server::start(&["--max-connections", "20"]);
    let good = server.good().await;
    let mut crowd = Vec::new();
    // More than this process may have open are not needed to be at the limit 500 times over.
    for count in 0..10_000 {
        crowd.push(connect(&server).await);
        if crowd.len() == 100 {
            crowd.clear();
        }
        if count % 500 == 250 {
            let answer = server.post_message(PROTOBUF, &message()).await;
            assert!(answer.result().report.expect("always").deadline_met);
        }
    }
    server.assert_serves(&good).await;
    let missed = server.metric("stereod_deadlines_total{outcome=\"missed\"}").await;
    assert_eq!(missed, 0.0);
    assert!(server.metric("stereod_connections").await <= 20.0);
    assert!(
        server
            .metric("stereod_connections_ended_total{why=\"evicted\"}")
            .await
            > 0.0
    );
    // Each of them has a counted end.
    drop(crowd);
    let ended = async {
        while server.metric_sum("stereod_connections_ended_total").await < 10_000.0 {
            tokio::task::yield_now().await;
        }
    };
    let ended = tokio::time::timeout(std::time::Duration::from_secs(60), ended).await;
    assert!(ended.is_ok(), "connections ended uncounted");
}

#[tokio::test]
async fn a_connection_over_the_limit_is_told_so() {
    let server = Server::start(&["--max-connections", "1"]);
    let mut only = connect(&server).await;
    only.write_all(b"GET /livez HTTP/1.1\r\nHost: x\r\n\r\n")
        .await
        .expect("room");
    let mut start = [0; 12];
    only.read_exact(&mut start).await.expect("an answer");
    assert_eq!(&start, b"HTTP/1.1 200");
    let mut second = connect(&server).await;
    let mut answer = String::new();
    second.read_to_string(&mut answer).await.expect("an answer");
    assert!(
        answer.starts_with("HTTP/1.1 503") && answer.contains("QUEUE_FULL"),
        "{answer}"
    );
    drop(only);
}
