//! Deadline policy for stereo frames, pure: generic over the job, with time as an argument.
//!
//! ```text
//! submit --push--> DeadlineQueue --pop--> worker: decode, base rung, then while may_start(..) another rung, mesh, encode
//!                      |                                   ^
//!                      +--take_expired(now)--> refused     +-- Costs: what each stage took so far, as a tail estimate
//! ```
//!
//! Every moment is a [`Duration`](std::time::Duration) since one epoch that the caller chose (a server: its start; a simulation: zero), so
//! that a test can hand out any moment it likes. Nothing here reads a clock, blocks, or knows what a frame is.
#![forbid(unsafe_code)]

mod budget;
mod estimate;
mod queue;

pub use budget::Budget;
pub use estimate::{Costs, TailEstimate};
pub use queue::{DeadlineQueue, QueueFull, Ticket};
