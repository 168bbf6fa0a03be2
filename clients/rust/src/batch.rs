//! The replies of a batch as they come.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll, ready};

use bytes::{Buf, Bytes, BytesMut};
use futures_util::Stream;
use futures_util::stream::BoxStream;
use prost::Message;
use stereo_proto::v1::BatchReply;
use stereo_proto::v1::batch_reply::Outcome;
use tokio::sync::oneshot;

use crate::ClientError;
use crate::client::root_cause;
use crate::compression::decompress;

/// A varint of 64 bits has at most this many bytes.
const LONGEST_VARINT: usize = 10;

/// A stream of [`BatchReply`]; payloads are decompressed. A status without a request id is about the batch as a whole, and its last.
/// Dropping it cancels what is not answered yet.
pub struct BatchReplies {
    url: String,
    pieces: BoxStream<'static, reqwest::Result<Bytes>>,
    arrived: BytesMut,
    sent: Arc<AtomicU64>,
    answered: u64,
    is_over: bool,
    /// Held for its drop, which ends the stream of requests.
    _wanted: oneshot::Sender<()>,
}

impl BatchReplies {
    pub(crate) fn new(
        url: String,
        answer: reqwest::Response,
        sent: Arc<AtomicU64>,
        wanted: oneshot::Sender<()>,
    ) -> Self {
        Self {
            url,
            pieces: Box::pin(answer.bytes_stream()),
            arrived: BytesMut::new(),
            sent,
            answered: 0,
            is_over: false,
            _wanted: wanted,
        }
    }

    /// Requests taken from the stream of requests so far.
    #[must_use]
    pub fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }

    /// Replies that have come so far.
    #[must_use]
    pub fn answered(&self) -> u64 {
        self.answered
    }

    /// The next reply, if all of it has arrived.
    fn take(&mut self) -> Result<Option<BatchReply>, ClientError> {
        let malformed = |why: &dyn std::fmt::Display| ClientError::Malformed(why.to_string());
        let start = &self.arrived[..self.arrived.len().min(LONGEST_VARINT)];
        if !start.iter().any(|byte| byte & 0x80 == 0) && start.len() < LONGEST_VARINT {
            return Ok(None);
        }
        let mut varint = start;
        let len = prost::decode_length_delimiter(&mut varint).map_err(|why| malformed(&why))?;
        let head = start.len() - varint.len();
        if self.arrived.len() - head < len {
            return Ok(None);
        }
        self.arrived.advance(head);
        let message = self.arrived.split_to(len).freeze();
        let mut reply = BatchReply::decode(message).map_err(|why| malformed(&why))?;
        if let Some(Outcome::Result(result)) = &mut reply.outcome {
            decompress(result)?;
        }
        self.answered += 1;
        Ok(Some(reply))
    }

    fn interrupted(&self, why: String) -> ClientError {
        ClientError::Interrupted {
            url: self.url.clone(),
            why,
        }
    }
}

impl Stream for BatchReplies {
    type Item = Result<BatchReply, ClientError>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        if self.is_over {
            return Poll::Ready(None);
        }
        loop {
            match self.take() {
                Ok(None) => {}
                Ok(Some(reply)) => return Poll::Ready(Some(Ok(reply))),
                Err(error) => {
                    self.is_over = true;
                    return Poll::Ready(Some(Err(error)));
                }
            }
            match ready!(self.pieces.as_mut().poll_next(context)) {
                Some(Ok(piece)) => self.arrived.extend_from_slice(&piece),
                Some(Err(error)) => {
                    self.is_over = true;
                    return Poll::Ready(Some(Err(self.interrupted(root_cause(&error)))));
                }
                None => {
                    self.is_over = true;
                    return Poll::Ready(match self.arrived.is_empty() {
                        true => None,
                        false => Some(Err(self.interrupted("in the middle of a reply".to_owned()))),
                    });
                }
            }
        }
    }
}

impl std::fmt::Debug for BatchReplies {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("BatchReplies")
            .field("url", &self.url)
            .field("sent", &self.sent())
            .field("answered", &self.answered)
            .finish_non_exhaustive()
    }
}
