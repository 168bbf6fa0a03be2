//! One admitted request, from its admission to its answer.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use tokio::sync::{oneshot, watch};

use crate::encode::memory::{Encoded, Memory};
use crate::job::{FrameReply, FrameRequest};
use crate::status::ServiceError;

/// What a job ends with.
pub(crate) type Outcome = Result<FrameReply, ServiceError>;

/// Called on the worker after each finished rung.
pub type OnRung = Box<dyn Fn(stereo::Quality) + Send + Sync>;

/// Called on the worker with the body of what there is after a rung that is not the last.
pub type OnPartial = Box<dyn Fn(Encoded) + Send + Sync>;

/// How whoever sent a request wants to get what comes of it, besides the reply.
#[derive(Default)]
pub struct Delivery {
    /// Wants to know of every rung.
    pub on_rung: Option<OnRung>,
    /// Wants what there is before everything is done.
    pub on_partial: Option<OnPartial>,
    /// Where the results are to lie.
    pub memory: Option<Arc<dyn Memory>>,
}

/// One request on its way through a worker. Shared by the worker, which computes, and its slot, which answers if the worker doesn't.
pub(crate) struct Job {
    pub(crate) request: FrameRequest,
    pub(crate) enqueued_at: Instant,
    /// Whether workers that have nothing to do may help with it.
    pub(crate) is_split: bool,
    delivery: Delivery,
    /// Taken by whoever answers.
    reply: Mutex<Option<(oneshot::Sender<Outcome>, Admitted)>>,
}

impl Job {
    /// The job, and the end its outcome arrives at.
    pub(super) fn new(
        request: FrameRequest,
        delivery: Delivery,
        admitted: Admitted,
    ) -> (Self, oneshot::Receiver<Outcome>) {
        let (reply, outcome) = oneshot::channel();
        (
            Self {
                request,
                enqueued_at: Instant::now(),
                is_split: false,
                delivery,
                reply: Mutex::new(Some((reply, admitted))),
            },
            outcome,
        )
    }

    /// A job outside any queue, for which nobody waits.
    pub(crate) fn detached(request: FrameRequest) -> Self {
        Self::new(
            request,
            Delivery::default(),
            Admitted::new(&watch::Sender::new(0)),
        )
        .0
    }

    /// Tells whoever watches that a rung is finished.
    pub(crate) fn report_rung(&self, quality: stereo::Quality) {
        if let Some(on_rung) = &self.delivery.on_rung {
            on_rung(quality);
        }
    }

    /// Who gets what there is before everything is done, if somebody does.
    pub(crate) fn on_partial(&self) -> Option<&OnPartial> {
        self.delivery.on_partial.as_ref()
    }

    /// Where its results are to lie, if that matters.
    pub(crate) fn memory(&self) -> Option<&dyn Memory> {
        self.delivery.memory.as_deref()
    }

    /// Ends the job; only the first answer counts. The request and the place among the admitted ones are given up first, so that
    /// whoever gets the outcome finds them free.
    pub(crate) fn answer(self: Arc<Self>, outcome: Outcome) {
        let reply = self.reply.lock().unwrap_or_else(PoisonError::into_inner).take();
        drop(self);
        if let Some((reply, admitted)) = reply {
            drop(admitted);
            // An error means that the client has gone: its outcome interests nobody.
            drop(reply.send(outcome));
        }
    }
}

/// One of the admitted jobs, counted while this lives.
pub(super) struct Admitted(watch::Sender<usize>);

impl Admitted {
    pub(super) fn new(count: &watch::Sender<usize>) -> Self {
        count.send_modify(|n| *n += 1);
        Self(count.clone())
    }
}

impl Drop for Admitted {
    fn drop(&mut self) {
        self.0.send_modify(|n| *n -= 1);
    }
}
