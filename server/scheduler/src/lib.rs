//! Deadline policy for stereo frames, pure: generic over the job, with time as an argument.
//!
//! ```text
//!            admit        refused: too late, over its share, full       dropped: expired, superseded, displaced
//! submit --> does it and everybody promised fit? --> waits (earliest deadline first) --> next --> worker:
//!               |  |  |                                                                  decode, base,
//!         Cost -+  |  +- overload ladder: fewer rungs, half size, no mesh, ..            rungs while there is time, mesh, encode
//!        of stages |                                                                        |
//!            ^     +- shares of the clients                                                 |
//!            +------------------- what each stage took ------------------------------------+
//! ```
//! Three ideas carry it:
//! 1. **Only the mandatory part is promised** (decode, base, mesh, encode). It is admitted if, at what such work costs nearly always,
//!    it and everybody admitted before will be in time. The rungs after base spend what is left, and are cut first.
//! 2. **What is not promised leaves room.** Rungs, clients beyond their share and best-effort frames are let in only where a part of
//!    the time until each deadline stays free: as much as those who come next are going to need, judged by those who came lately.
//! 3. **Everything is decided at the last moment**: the plan at dispatch, each rung when it would start, each step when it ends.
//!
//! Every moment is a [`Duration`](std::time::Duration) since one epoch that the caller chose (a server: its start; a simulation: zero).
//! Nothing here reads a clock, blocks, or knows what a frame is. Memory is bounded by [`Config`] alone.
#![forbid(unsafe_code)]

mod answer;
mod cost;
mod ladder;
mod nanos;
mod pace;
mod rate;
mod running;
mod scheduler;
mod shares;
mod spec;
mod timeline;

pub use answer::{
    Cancelled, Dispatch, DropReason, Dropped, Finished, Next, Plan, Reason, Refusal, Refused, Snapshot,
    StopReason, Submission, Verdict,
};
pub use cost::{Cost, CostModel};
pub use ladder::{Ladder, Level};
pub use scheduler::Scheduler;
pub use spec::{ClientId, Config, JobSpec, Kind, Policy, Priority, Stage, StreamId, Ticket, Urgency, Work};
