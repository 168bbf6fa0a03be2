//! What the scheduler says of a job, in the service's words.

use std::sync::Arc;
use std::time::{Duration, Instant};

use stereo_scheduler::{DropReason, Dropped, Reason, Refusal};

use super::{Dispatch, Job};
use crate::job::PriorityClass;
use crate::status::ServiceError;

impl Dispatch {
    pub(super) fn answer_dropped(&self, dropped: Vec<Dropped<Arc<Job>>>) {
        for Dropped { job, reason, .. } in dropped {
            let error = match reason {
                DropReason::Expired => ServiceError::Expired {
                    budget: job.request.options.latency_budget,
                    earliest_feasible: None,
                },
                DropReason::Superseded => ServiceError::Superseded,
                DropReason::Displaced => ServiceError::Displaced,
            };
            self.metrics.dropped(error.reason_name());
            job.answer(Err(error));
        }
    }

    pub(super) fn refused(&self, refusal: Refusal, budget: Duration, received_at: Instant) -> ServiceError {
        // A new request would have to arrive first, as this one did.
        let arrival = received_at.elapsed();
        let earliest_feasible = refusal.earliest_feasible.map(|wait| wait + arrival);
        match refusal.reason {
            Reason::Expired => ServiceError::Expired {
                budget,
                earliest_feasible,
            },
            Reason::DeadlineInfeasible => ServiceError::DeadlineInfeasible {
                budget,
                earliest_feasible,
            },
            Reason::Quota => ServiceError::Quota { earliest_feasible },
            Reason::QueueFull => ServiceError::QueueFull {
                limit: self.setting.capacity,
                earliest_feasible,
            },
        }
    }
}

/// The scheduler's name for the classes with a deadline.
pub(super) fn priority(class: PriorityClass) -> stereo_scheduler::Priority {
    match class {
        PriorityClass::BestEffort => stereo_scheduler::Priority::BestEffort,
        PriorityClass::Deadline | PriorityClass::Background => stereo_scheduler::Priority::Normal,
    }
}
