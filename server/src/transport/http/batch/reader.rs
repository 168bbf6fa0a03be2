//! The requests of a batch, taken from its body one by one.

use std::error::Error;
use std::io;
use std::sync::Arc;
use std::time::Instant;

use axum::body::Body;
use bytes::Bytes;
use http_body_util::BodyExt;
use tokio::time::timeout_at;

use crate::clients::Caller;
use crate::status::ServiceError;
use crate::transport::http::Http;
use crate::transport::http::body::Share;
use crate::wire::Delimited;

/// One request as it came.
pub(super) struct Message {
    pub(super) bytes: Bytes,
    /// Its place in the batch, from 0.
    pub(super) index: u64,
    /// Its bytes count as in flight while this lives.
    pub(super) share: Share,
}

/// Why the requests end before the body does.
#[derive(Debug)]
pub(super) enum Broken {
    /// By what the client sent, or didn't.
    Off(ServiceError),
    /// Its connection, or its stream of one, is gone; the text says how.
    Lost(String),
}

impl From<ServiceError> for Broken {
    fn from(error: ServiceError) -> Self {
        Self::Off(error)
    }
}

/// Reads on where it left off, even if [`next`](Self::next) is dropped half-way.
pub(super) struct Reader {
    http: Arc<Http>,
    caller: Caller,
    body: Body,
    arrived: Delimited,
    /// Room for the message that is arriving.
    share: Option<Share>,
    index: u64,
    waiting_since: Instant,
}

impl Reader {
    pub(super) fn new(http: Arc<Http>, caller: Caller, body: Body) -> Self {
        Self {
            arrived: Delimited::new(http.bodies.body_bytes()),
            http,
            caller,
            body,
            share: None,
            index: 0,
            waiting_since: Instant::now(),
        }
    }

    /// What was not read because others were under way does not count against the sender.
    pub(super) fn wait_anew(&mut self) {
        self.waiting_since = Instant::now();
    }

    /// The next request; `None` at the end. A sender may rest between two requests while it waits for replies (not `is_idle`).
    pub(super) async fn next(&mut self, is_idle: bool) -> Result<Option<Message>, Broken> {
        loop {
            if let Some(len) = self.arrived.next_len()? {
                if self.share.is_none() {
                    self.share = Some(self.http.bodies.batch_share(&self.caller, len).await);
                    self.wait_anew();
                }
                if let Some(bytes) = self.arrived.next_message()? {
                    let index = self.index;
                    self.index += 1;
                    self.wait_anew();
                    return Ok(Some(Message {
                        bytes,
                        index,
                        share: self.share.take().unwrap_or_default(),
                    }));
                }
            }
            if !self.read_piece(is_idle).await? {
                return match self.arrived.is_between() {
                    true => Ok(None),
                    false => Err(broken_off("its last request is not whole").into()),
                };
            }
        }
    }

    /// One more piece of the body; false at its end.
    async fn read_piece(&mut self, is_idle: bool) -> Result<bool, Broken> {
        let limit = self.http.bodies.timeout();
        let due = self.waiting_since + limit;
        let piece = match timeout_at(due.into(), self.body.frame()).await {
            Ok(piece) => piece,
            Err(_) if !is_idle && self.arrived.is_between() => {
                self.wait_anew();
                return Ok(true);
            }
            Err(_) => return Err(ServiceError::ReadTimeout { limit }.into()),
        };
        match piece {
            None => Ok(false),
            Some(Ok(frame)) => {
                if let Some(data) = frame.data_ref() {
                    self.arrived.push(data);
                }
                Ok(true)
            }
            Some(Err(error)) => match is_malformed(&error) {
                true => Err(broken_off(&error.to_string()).into()),
                false => Err(Broken::Lost(error.to_string())),
            },
        }
    }
}

/// Whether a body failed by what is in it: broken chunks, which hyper reports as input that is wrong. Everything else is the network.
fn is_malformed(error: &(dyn Error + 'static)) -> bool {
    let mut cause = Some(error);
    while let Some(error) = cause {
        if let Some(error) = error.downcast_ref::<io::Error>() {
            return matches!(
                error.kind(),
                io::ErrorKind::InvalidInput | io::ErrorKind::InvalidData
            );
        }
        cause = error.source();
    }
    false
}

pub(super) fn broken_off(why: &str) -> ServiceError {
    ServiceError::Invalid(format!(
        "the batch broke off ({why}): what was whole before has been answered, send the rest again"
    ))
}
