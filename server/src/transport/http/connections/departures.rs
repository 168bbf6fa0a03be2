//! Telling when what was handed to a connection has left.

use std::sync::{Arc, Mutex, PoisonError};

/// Called once.
type Notice = Box<dyn FnOnce() + Send>;

/// Who wants to know, of one connection. An extension of each request.
#[derive(Clone, Default)]
pub(in crate::transport::http) struct Departures(Arc<Mutex<Vec<Notice>>>);

impl Departures {
    /// Calls `notice` when everything that has been handed to the connection by now is with the system.
    pub(in crate::transport::http) fn notify(&self, notice: impl FnOnce() + Send + 'static) {
        self.waiting().push(Box::new(notice));
    }

    /// Nothing waits in this process any more.
    pub(super) fn flushed(&self) {
        let waiting = std::mem::take(&mut *self.waiting());
        for notice in waiting {
            notice();
        }
    }

    fn waiting(&self) -> std::sync::MutexGuard<'_, Vec<Notice>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    #[test]
    fn everybody_is_told_once() {
        let departures = Departures::default();
        let told = Arc::new(AtomicUsize::new(0));
        for _ in 0..2 {
            let told = Arc::clone(&told);
            departures.notify(move || {
                told.fetch_add(1, Ordering::Relaxed);
            });
        }
        departures.flushed();
        departures.flushed();
        assert_eq!(told.load(Ordering::Relaxed), 2);
    }
}
