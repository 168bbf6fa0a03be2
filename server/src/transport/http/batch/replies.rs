//! The replies of a batch on their way out: a channel that holds one, and the body that takes from it as the client reads.

use std::convert::Infallible;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::body::HttpBody;
use bytes::Bytes;
use hyper::body::Frame;
use tokio::sync::mpsc;
use tokio::time::timeout;

use crate::status::ServiceError;
use crate::transport::http::body::Share;

/// Size of the pieces that a reply is sent in.
const PIECE: usize = 128 << 10;

/// One reply.
pub(super) struct Piece {
    head: Bytes,
    rest: Bytes,
    /// The request's share of the bytes in flight, held until the reply is taken.
    _share: Share,
}

impl Piece {
    pub(super) fn result(head: Bytes, rest: Bytes, share: Share) -> Self {
        Self {
            head,
            rest,
            _share: share,
        }
    }

    /// The next bytes to send; `None` when all is sent.
    fn split(&mut self) -> Option<Bytes> {
        if !self.head.is_empty() {
            return Some(std::mem::take(&mut self.head));
        }
        let count = self.rest.len().min(PIECE);
        (count > 0).then(|| self.rest.split_to(count))
    }
}

impl From<Bytes> for Piece {
    fn from(whole: Bytes) -> Self {
        Self::result(whole, Bytes::new(), Share::default())
    }
}

/// Where replies go in.
pub(super) struct Outlet {
    sender: mpsc::Sender<Piece>,
    last: Arc<Mutex<Option<Bytes>>>,
    patience: Duration,
}

/// Where they come out: the response's body.
pub(super) struct Replies {
    receiver: mpsc::Receiver<Piece>,
    current: Option<Piece>,
    last: Arc<Mutex<Option<Bytes>>>,
}

/// A client may let a reply wait for `patience`.
pub(super) fn channel(patience: Duration) -> (Outlet, Replies) {
    let (sender, receiver) = mpsc::channel(1);
    let last = Arc::new(Mutex::new(None));
    let outlet = Outlet {
        sender,
        last: Arc::clone(&last),
        patience,
    };
    let replies = Replies {
        receiver,
        current: None,
        last,
    };
    (outlet, replies)
}

impl Outlet {
    /// Returns when the client has gone.
    pub(super) async fn closed(&self) {
        self.sender.closed().await;
    }

    /// Sends a reply as soon as the one before is taken.
    ///
    /// # Errors
    /// [`ServiceError::SlowReader`] if it isn't; `None` if the client has gone.
    pub(super) async fn send(&mut self, piece: Piece) -> Result<(), Option<ServiceError>> {
        match timeout(self.patience, self.sender.send(piece)).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_)) => Err(None),
            Err(_) => Err(Some(ServiceError::SlowReader { limit: self.patience })),
        }
    }

    /// Leaves a last reply for the client to find when it has read the others.
    pub(super) fn leave_word(&mut self, reply: Bytes) {
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = Some(reply);
    }
}

impl HttpBody for Replies {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        loop {
            if let Some(bytes) = self.current.as_mut().and_then(Piece::split) {
                return Poll::Ready(Some(Ok(Frame::data(bytes))));
            }
            self.current = None;
            match ready!(self.receiver.poll_recv(context)) {
                Some(next) => self.current = Some(next),
                None => {
                    let last = self.last.lock().unwrap_or_else(PoisonError::into_inner).take();
                    return Poll::Ready(last.map(|bytes| Ok(Frame::data(bytes))));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use http_body_util::BodyExt;

    use super::*;

    #[tokio::test]
    async fn replies_come_out_as_they_went_in() {
        let (mut outlet, mut replies) = channel(Duration::from_secs(60));
        let long = Bytes::from(vec![7; 3 * PIECE]);
        outlet
            .send(Piece::result(
                Bytes::from_static(b"head"),
                long.clone(),
                Share::default(),
            ))
            .await
            .unwrap();
        let mut got = Vec::new();
        while got.len() < 4 + long.len() {
            got.extend_from_slice(replies.frame().await.unwrap().unwrap().data_ref().unwrap());
        }
        assert_eq!(got, [b"head".as_slice(), &long].concat());
        drop(outlet);
        assert!(replies.frame().await.is_none());
    }

    #[tokio::test]
    async fn a_client_that_does_not_read_is_given_up_and_finds_why() {
        let patience = Duration::from_millis(5);
        let (mut outlet, mut replies) = channel(patience);
        outlet.send(Bytes::from_static(b"first").into()).await.unwrap();
        let error = outlet
            .send(Bytes::from_static(b"second").into())
            .await
            .unwrap_err();
        assert_eq!(error, Some(ServiceError::SlowReader { limit: patience }));
        outlet.leave_word(Bytes::from_static(b"too slow"));
        drop(outlet);
        let mut got = Vec::new();
        while let Some(frame) = replies.frame().await {
            got.extend_from_slice(frame.unwrap().data_ref().unwrap());
        }
        assert_eq!(got, b"firsttoo slow");
    }

    #[tokio::test]
    async fn a_client_that_has_gone_is_noticed() {
        let (mut outlet, replies) = channel(Duration::from_secs(60));
        drop(replies);
        outlet.closed().await;
        assert_eq!(outlet.send(Bytes::new().into()).await, Err(None));
    }
}
