//! Callers that stop waiting.

use stereo_scheduler::Ticket;

use crate::job::PriorityClass;
use crate::metrics::CANCELLED;
use crate::pool::Shared;

/// Takes the job back, and counts it, when the caller stops waiting for it.
pub(super) struct Leaving<'a> {
    pub(super) shared: &'a Shared,
    pub(super) class: PriorityClass,
    pub(super) ticket: Option<Ticket>,
}

impl Leaving<'_> {
    /// The job has ended by itself.
    pub(super) fn stay(&mut self) {
        self.ticket = None;
    }
}

impl Drop for Leaving<'_> {
    fn drop(&mut self) {
        if let Some(ticket) = self.ticket.take() {
            self.shared.dispatch.cancel(ticket);
            self.shared.metrics.ended(Some(self.class), CANCELLED);
            self.shared.metrics.dropped(CANCELLED);
        }
    }
}
