//! One request on a connection of its own, over a plain socket: nothing of a client's library is measured, and nothing is refused by it.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use bytes::Bytes;

/// A server that says nothing for so long hangs.
const HANGS: Duration = Duration::from_secs(10);

/// The first line's code, and the time until the answer was whole.
pub(super) struct Answer {
    pub(super) code: u16,
    pub(super) took: Duration,
}

/// Sends `request`, reads its answer.
///
/// # Errors
/// If there is none.
pub(super) fn exchange(address: &str, request: &[u8]) -> Result<Answer> {
    let started = Instant::now();
    let mut stream = TcpStream::connect(address)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(HANGS))?;
    stream.set_write_timeout(Some(HANGS))?;
    // The server may have answered, and read no further, before all of it is sent.
    match stream.write_all(request) {
        Err(error) if !matches!(error.kind(), ErrorKind::BrokenPipe | ErrorKind::ConnectionReset) => {
            return Err(error).context("can't send");
        }
        _ => {}
    }
    let mut answer = Vec::new();
    let mut piece = [0; 16 << 10];
    loop {
        if let Some(end) = whole(&answer)? {
            answer.truncate(end);
            break;
        }
        match stream.read(&mut piece).context("can't read")? {
            0 => break,
            count => answer.extend_from_slice(&piece[..count]),
        }
    }
    let took = started.elapsed();
    // Neither waits for the other.
    let _ = stream.shutdown(Shutdown::Both);
    Ok(Answer {
        code: code(&answer)?,
        took,
    })
}

fn code(answer: &[u8]) -> Result<u16> {
    let line = answer.strip_prefix(b"HTTP/1.1 ").and_then(|rest| rest.get(..3));
    let line = line.context("the answer is no HTTP")?;
    Ok(std::str::from_utf8(line)?.parse()?)
}

/// Where the answer ends, once all of it is there; `None` if it isn't or only the connection's end will say.
fn whole(answer: &[u8]) -> Result<Option<usize>> {
    let Some(head) = answer.windows(4).position(|four| four == b"\r\n\r\n") else {
        return Ok(None);
    };
    let text = std::str::from_utf8(&answer[..head])?.to_ascii_lowercase();
    let Some((_, rest)) = text.split_once("\r\ncontent-length:") else {
        if text.contains("\r\ntransfer-encoding:") {
            bail!("an answer of unknown length: {text}");
        }
        return Ok(None);
    };
    let length: usize = rest.lines().next().unwrap_or_default().trim().parse()?;
    let end = head + 4 + length;
    Ok((answer.len() >= end).then_some(end))
}

/// A request for a match.
pub(super) fn post(token: &str, content_type: &str, body: &[u8]) -> Bytes {
    let head = format!(
        "POST /v1/stereo HTTP/1.1\r\nHost: stereod\r\nAuthorization: Bearer {token}\r\nContent-Type: {content_type}\r\n\
         Content-Length: {}\r\n\r\n",
        body.len()
    );
    [head.as_bytes(), body].concat().into()
}
