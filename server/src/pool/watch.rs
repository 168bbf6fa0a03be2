//! The thread that looks after the workers: one that makes no progress is given up, its frame answered, and another takes its place.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use super::{Patience, Shared, Threads};
use crate::status::ServiceError;

/// Looks in the time after which a worker counts as stuck.
const LOOKS: u32 = 4;

/// Ends the watching.
#[derive(Default)]
pub(super) struct Closing {
    is_closing: Mutex<bool>,
    wake: Condvar,
}

impl Closing {
    pub(super) fn close(&self) {
        *self.is_closing.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.wake.notify_all();
    }

    /// Sleeps for `nap`, and says whether to end.
    fn is_over_after(&self, nap: Duration) -> bool {
        let is_closing = self.is_closing.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self
            .wake
            .wait_timeout_while(is_closing, nap, |is_closing| !*is_closing);
        *waited.unwrap_or_else(PoisonError::into_inner).0
    }
}

pub(super) fn start(
    shared: Arc<Shared>,
    threads: Arc<Threads>,
    patience: Patience,
) -> std::io::Result<JoinHandle<()>> {
    std::thread::Builder::new()
        .name("stereo-watch".to_owned())
        .spawn(move || watch(&shared, &threads, patience))
}

fn watch(shared: &Arc<Shared>, threads: &Threads, patience: Patience) {
    let error = ServiceError::Internal(format!(
        "no progress for {:?} while matching",
        patience.stuck_after
    ));
    let mut left = patience.replacements;
    while !threads.is_closing.is_over_after(patience.stuck_after / LOOKS) {
        for seat in shared.dispatch.replace_stuck(patience.stuck_after, &error) {
            let worker = seat.index();
            if let Some(helpers) = &shared.helpers {
                // It may be a helper that is stuck, and would be so for every frame that counts on it.
                helpers.retire();
            }
            if left == 0 {
                shared.metrics.workers.dec();
                tracing::error!(
                    worker,
                    "stuck, and no more workers are replaced: restart the server"
                );
                shared.is_crippled.store(true, Ordering::Relaxed);
                continue;
            }
            left -= 1;
            shared.metrics.workers_replaced.inc();
            tracing::error!(
                worker,
                left,
                "stuck: its frame is answered and another thread takes its place"
            );
            if let Err(error) = threads.spawn(shared, seat) {
                tracing::error!(worker, %error, "no thread for another worker: restart the server");
                shared.is_crippled.store(true, Ordering::Relaxed);
            }
        }
    }
}
