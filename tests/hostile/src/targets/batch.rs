//! A body of length-delimited messages. The first byte is the size of the pieces it comes in.

use bytes::Bytes;
use stereod::status::ServiceError;
use stereod::wire::{Delimited, decode_request};

use super::request;
use crate::refusal::is_accepted;

const LARGEST_MESSAGE: u64 = 1 << 16;

pub(crate) fn batch(bytes: &[u8]) -> bool {
    let Some((&size, body)) = bytes.split_first() else {
        return false;
    };
    let (messages, end) = read(body, usize::from(size).max(1));
    assert_eq!(
        (&messages, &end),
        (&read(body, body.len().max(1)).0, &read(body, body.len().max(1)).1)
    );
    let all_good = messages.into_iter().all(|message| {
        let frame = decode_request(message).and_then(|message| request::frame(message, "batch"));
        is_accepted(&frame)
    });
    is_accepted(&end) && end == Ok(true) && all_good
}

/// The messages of a body that comes in pieces, and whether it ends after one.
fn read(body: &[u8], piece_bytes: usize) -> (Vec<Bytes>, Result<bool, ServiceError>) {
    let mut reader = Delimited::new(LARGEST_MESSAGE);
    let mut messages = Vec::new();
    for piece in body.chunks(piece_bytes) {
        reader.push(piece);
        loop {
            match reader.next_message() {
                Ok(Some(message)) => messages.push(message),
                Ok(None) => break,
                Err(error) => return (messages, Err(error)),
            }
        }
    }
    (messages, Ok(reader.is_between()))
}
