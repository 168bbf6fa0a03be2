//! What waits between Zenoh's receive threads and a camera's task: never a queue of frames, and only a few images.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use tokio::sync::{Notify, OwnedSemaphorePermit};
use zenoh::bytes::{Encoding, ZBytes};

use crate::decode::Side;

/// Single images that wait at one time. They wait only for the task to be scheduled, so more than a few mean that the machine is
/// overloaded.
const MOST_IMAGES: usize = 16;

/// A message of a camera.
pub(super) struct Arrival {
    /// `None` = a whole frame.
    pub(super) side: Option<Side>,
    pub(super) payload: ZBytes,
    pub(super) encoding: Encoding,
    pub(super) attachment: Option<ZBytes>,
    pub(super) received_at: Instant,
    /// The place of its bytes among all that are held.
    pub(super) share: OwnedSemaphorePermit,
}

/// At most one whole frame, the newest, and a few single images.
#[derive(Default)]
pub(super) struct Inbox {
    waiting: Mutex<VecDeque<Arrival>>,
    ready: Notify,
}

impl Inbox {
    /// Puts a message in; what it takes the place of comes back.
    pub(super) fn push(&self, arrival: Arrival) -> Option<Arrival> {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let displaced = match arrival.side {
            None => waiting
                .iter()
                .position(|other| other.side.is_none())
                .and_then(|index| waiting.remove(index)),
            Some(_) if waiting.len() >= MOST_IMAGES => waiting.pop_front(),
            Some(_) => None,
        };
        waiting.push_back(arrival);
        drop(waiting);
        self.ready.notify_one();
        displaced
    }

    /// Everything that waits.
    pub(super) fn drain(&self) -> VecDeque<Arrival> {
        std::mem::take(&mut *self.waiting.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// The next message. Nothing is lost if this is dropped before it is done.
    pub(super) async fn next(&self) -> Arrival {
        loop {
            let next = self
                .waiting
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .pop_front();
            if let Some(arrival) = next {
                return arrival;
            }
            self.ready.notified().await;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use tokio::sync::Semaphore;

    use super::*;

    fn arrival(side: Option<Side>, name: u8) -> Arrival {
        Arrival {
            side,
            payload: ZBytes::from(vec![name]),
            encoding: Encoding::default(),
            attachment: None,
            received_at: Instant::now(),
            share: Arc::new(Semaphore::new(1)).try_acquire_owned().unwrap(),
        }
    }

    fn name(arrival: &Arrival) -> u8 {
        arrival.payload.to_bytes()[0]
    }

    #[tokio::test]
    async fn a_newer_frame_takes_the_place_of_the_one_that_waits() {
        let inbox = Inbox::default();
        assert!(inbox.push(arrival(None, 1)).is_none());
        assert!(inbox.push(arrival(Some(Side::Left), 2)).is_none());
        assert_eq!(name(&inbox.push(arrival(None, 3)).unwrap()), 1);
        assert_eq!(name(&inbox.next().await), 2, "images stay where they are");
        assert_eq!(name(&inbox.next().await), 3);
    }

    #[test]
    fn no_more_than_a_few_images_wait() {
        let inbox = Inbox::default();
        let displaced = (0..100)
            .filter_map(|i| inbox.push(arrival(Some(Side::Right), i)))
            .count();
        assert_eq!(displaced, 100 - MOST_IMAGES);
    }
}
