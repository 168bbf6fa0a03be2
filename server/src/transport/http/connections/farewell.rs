//! What a client is told that is not served at all: one answer of HTTP/1.1, and the connection ends.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

use crate::status::{ServiceError, title};

/// How long it may take to read why.
const PATIENCE: Duration = Duration::from_secs(1);

/// Says `error` and ends the connection.
pub(super) async fn say(mut stream: TcpStream, error: ServiceError) {
    let body = error.to_problem_json("");
    let mut head = format!(
        "HTTP/1.1 {} {}\r\nContent-Type: application/problem+json\r\nContent-Length: {}\r\nConnection: close\r\n",
        error.http_code(),
        title(error.http_code()),
        body.len(),
    );
    if let Some(seconds) = error.retry_after_s() {
        head += &format!("Retry-After: {seconds}\r\n");
    }
    head += "\r\n";
    let told = async {
        stream.write_all(&[head.as_bytes(), &body].concat()).await?;
        stream.shutdown().await?;
        // A socket that is closed with something unread in it takes back what was sent.
        let mut unread = [0; 4096];
        while stream.read(&mut unread).await? > 0 {}
        std::io::Result::Ok(())
    };
    drop(timeout(PATIENCE, told).await);
}
