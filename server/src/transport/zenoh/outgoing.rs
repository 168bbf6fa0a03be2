//! Payloads on their way out: in memory that this server shares with whoever is on its host, as ordinary bytes for everybody else.
//!
//! The memory is a pool of fixed size, which is made when the first one on the same host is there to read it. Nothing ever waits for
//! room in it, and nothing that somebody still reads is taken back: what doesn't fit goes out as ordinary bytes, which always works.
//! (Zenoh's own way of putting large messages into shared memory takes back what a reader holds when the machine has stalled, so
//! it is switched off.)

use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use bytes::Bytes;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::shm::{PosixShmProviderBackend, ShmProvider, ShmProviderBuilder};

use super::payload::Way;

/// The pool: some twenty VGA results, or two of 4 megapixels. Containers have 64 MiB for all of their shared memory.
const POOL_BYTES: usize = 16 << 20;
/// Below that, a copy through the socket costs less than what it takes to share.
const WORTH_SHARING_BYTES: usize = 4 << 10;

/// Where payloads are made ready to be sent.
pub(super) struct Outgoing {
    pool_bytes: usize,
    /// `None` if there is no shared memory here.
    pool: OnceLock<Option<ShmProvider<PosixShmProviderBackend>>>,
    /// Connections whose other end can read our shared memory.
    neighbours: AtomicUsize,
}

impl Default for Outgoing {
    fn default() -> Self {
        Self::new(POOL_BYTES)
    }
}

impl Outgoing {
    fn new(pool_bytes: usize) -> Self {
        Self {
            pool_bytes,
            pool: OnceLock::new(),
            neighbours: AtomicUsize::new(0),
        }
    }

    /// So many connections are to somebody who can read our shared memory.
    pub(super) fn set_neighbours(&self, count: usize) {
        self.neighbours.store(count, Ordering::Relaxed);
    }

    /// A payload for everybody who listens.
    pub(super) fn for_all(&self, body: &Bytes) -> (ZBytes, Way) {
        match self.neighbours.load(Ordering::Relaxed) {
            0 => (ZBytes::from(body.clone()), Way::Network),
            _ => self.shared(body),
        }
    }

    /// A payload for somebody whose own came by `way`.
    pub(super) fn by(&self, way: Way, body: Bytes) -> (ZBytes, Way) {
        match way {
            Way::SharedMemory => self.shared(&body),
            Way::Network | Way::NoRoom => (ZBytes::from(body), Way::Network),
        }
    }

    /// In shared memory if there is room.
    fn shared(&self, body: &Bytes) -> (ZBytes, Way) {
        if body.len() < WORTH_SHARING_BYTES {
            return (ZBytes::from(body.clone()), Way::Network);
        }
        let pool = self.pool.get_or_init(|| {
            let pool = ShmProviderBuilder::default_backend(self.pool_bytes).wait();
            pool.inspect_err(|why| tracing::warn!(%why, "no shared memory: results are sent through sockets"))
                .ok()
        });
        // What nobody reads any more comes back first: the same few pieces are used again and again, and are in the caches.
        let buffer = pool.as_ref().and_then(|pool| {
            pool.garbage_collect();
            pool.alloc(body.len()).wait().ok()
        });
        match buffer {
            Some(mut buffer) => {
                buffer.copy_from_slice(body);
                (ZBytes::from(buffer), Way::SharedMemory)
            }
            None => (ZBytes::from(body.clone()), Way::NoRoom),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_pool_is_waited_for_by_nobody_and_used_again_when_it_has_room() {
        let outgoing = Outgoing::new(1 << 20);
        outgoing.set_neighbours(1);
        let body = Bytes::from(vec![7; 300 << 10]);
        let held: Vec<(ZBytes, Way)> = (0..5).map(|_| outgoing.for_all(&body)).collect();
        let ways: Vec<Way> = held.iter().map(|(_, way)| *way).collect();
        assert_eq!(ways[..3], [Way::SharedMemory; 3]);
        assert_eq!(ways[4], Way::NoRoom);
        for (payload, way) in &held {
            assert_eq!(payload.as_shm().is_some(), *way == Way::SharedMemory);
            assert_eq!(*payload.to_bytes(), body);
        }
        drop(held);
        for _ in 0..100 {
            assert_eq!(outgoing.for_all(&body).1, Way::SharedMemory);
        }
    }

    #[test]
    fn nothing_is_shared_with_those_who_cannot_read_it_or_need_not() {
        let outgoing = Outgoing::default();
        let body = Bytes::from(vec![7; 100_000]);
        assert_eq!(outgoing.for_all(&body).1, Way::Network);
        assert_eq!(outgoing.by(Way::Network, body.clone()).1, Way::Network);
        assert!(outgoing.pool.get().is_none(), "no memory is taken for nothing");
        let small = Bytes::from_static(b"report");
        assert_eq!(outgoing.by(Way::SharedMemory, small).1, Way::Network);
        assert_eq!(outgoing.by(Way::SharedMemory, body).1, Way::SharedMemory);
    }
}
