//! The fault that a server was told to have.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::Process;
use super::worker::Worker;
use crate::config::Fault;

/// What workers do with frames, with the fault in it if there is to be one.
#[expect(clippy::panic, reason = "the fault that was asked for")]
pub(super) fn process(fault: Option<Fault>) -> Arc<Process> {
    let Some(fault) = fault else {
        return Arc::new(Worker::process);
    };
    tracing::error!(%fault, "this server was told to fail (--fault), which is for tests alone");
    let frames = AtomicU64::new(0);
    Arc::new(move |worker, run, seat| {
        let frame = 1 + frames.fetch_add(1, Ordering::Relaxed);
        match fault {
            Fault::Panic { at } if at == frame => panic!("told to: --fault {fault}"),
            Fault::Stuck { at } if at == frame => loop {
                std::thread::park();
            },
            Fault::Panic { .. } | Fault::Stuck { .. } => worker.process(run, seat),
        }
    })
}
