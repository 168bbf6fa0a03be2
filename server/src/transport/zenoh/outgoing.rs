//! Results on their way out: written into memory that this server shares with whoever is on its host, or ordinary bytes.
//!
//! The memory is a pool of fixed size, which is made when the first one on the same host is there to read it. Nothing ever waits for
//! room in it, and nothing that somebody still reads is taken back: what doesn't fit goes out as ordinary bytes, which always works.
//! (Zenoh's own way of putting large messages into shared memory takes back what a reader holds when the machine has stalled, so
//! it is switched off.)

use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use bytes::Bytes;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::shm::{OwnedShmBuf, PosixShmProviderBackend, ShmProvider, ShmProviderBuilder, ZShm};

use super::payload::Way;
use crate::encode::memory::{Encoded, Memory};

/// The pool: some twelve VGA results. Containers have 64 MiB for all of their shared memory.
const POOL_BYTES: usize = 16 << 20;
/// Below that, a copy through the socket costs less than what it takes to share.
const WORTH_SHARING_BYTES: usize = 4 << 10;

/// Where results are made ready to be sent.
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

    /// Makes the pool if it isn't there yet, which takes some 20 ms: before the worker that has the first result for a neighbour must.
    pub(super) fn prepare(&self) {
        self.pool();
    }

    fn pool(&self) -> Option<&ShmProvider<PosixShmProviderBackend>> {
        let pool = self.pool.get_or_init(|| {
            let pool = ShmProviderBuilder::default_backend(self.pool_bytes).wait();
            pool.inspect_err(|why| tracing::warn!(%why, "no shared memory: results are sent through sockets"))
                .ok()
        });
        pool.as_ref()
    }

    /// How results for everybody who listens leave.
    pub(super) fn way_for_all(&self) -> Way {
        match self.neighbours.load(Ordering::Relaxed) {
            0 => Way::Network,
            _ => Way::SharedMemory,
        }
    }

    /// Where results are to be written that leave by `way`.
    pub(super) fn memory(self: &Arc<Self>, way: Way) -> Option<Arc<dyn Memory>> {
        (way == Way::SharedMemory).then(|| Arc::clone(self) as Arc<dyn Memory>)
    }
}

impl Memory for Outgoing {
    fn hold(&self, most: usize, write: &mut dyn FnMut(&mut [u8]) -> Option<usize>) -> Option<Encoded> {
        if most < WORTH_SHARING_BYTES {
            return None;
        }
        let pool = self.pool()?;
        // What nobody reads any more comes back first: the same few pieces are used again and again, and are in the caches.
        pool.garbage_collect();
        let mut piece = pool.alloc(most).wait().ok()?;
        let used = write(&mut piece)?;
        piece.try_resize(NonZeroUsize::new(used)?)?;
        let piece = Arc::new(Piece(ZShm::from(piece)));
        let bytes = Bytes::from_owner(Whole(Arc::clone(&piece)));
        Some(Encoded::in_memory_of(piece, bytes))
    }
}

/// A result in the pool.
struct Piece(ZShm);

/// Its bytes.
struct Whole(Arc<Piece>);

impl AsRef<[u8]> for Whole {
    fn as_ref(&self) -> &[u8] {
        &self.0.0
    }
}

/// `body` as Zenoh sends it, and how it leaves.
pub(super) fn payload(body: &Encoded) -> (ZBytes, Way) {
    if let Some(piece) = body.origin::<Piece>() {
        return (ZBytes::from(piece.0.clone()), Way::SharedMemory);
    }
    let is_missing = body.had_no_room() && body.len() >= WORTH_SHARING_BYTES;
    let way = if is_missing { Way::NoRoom } else { Way::Network };
    (ZBytes::from(body.clone().into_bytes()), way)
}

#[cfg(test)]
mod tests {

    use super::*;
    use crate::encode::memory::encoded;

    /// A result of `len` bytes, each `value`.
    fn result(outgoing: &Arc<Outgoing>, way: Way, len: usize, value: u8) -> Encoded {
        let memory = outgoing.memory(way);
        encoded(memory.as_deref(), len, |to| {
            to.put_bytes(value, len);
            Ok(())
        })
        .unwrap()
    }

    #[test]
    fn a_full_pool_is_waited_for_by_nobody_and_used_again_when_it_has_room() {
        let outgoing = Arc::new(Outgoing::new(1 << 20));
        outgoing.set_neighbours(1);
        let sent = |value| {
            let way = outgoing.way_for_all();
            payload(&result(&outgoing, way, 300 << 10, value))
        };
        let held: Vec<(ZBytes, Way)> = (0..5).map(sent).collect();
        let ways: Vec<Way> = held.iter().map(|(_, way)| *way).collect();
        assert_eq!(ways[..3], [Way::SharedMemory; 3]);
        assert_eq!(ways[4], Way::NoRoom);
        for ((payload, way), value) in held.iter().zip(0..) {
            assert_eq!(payload.as_shm().is_some(), *way == Way::SharedMemory);
            assert_eq!(*payload.to_bytes(), vec![value; 300 << 10]);
        }
        drop(held);
        for value in 0..100 {
            assert_eq!(sent(value).1, Way::SharedMemory);
        }
    }

    #[test]
    fn a_piece_is_as_long_as_what_was_written_and_lives_as_long_as_anybody_needs_it() {
        let outgoing = Arc::new(Outgoing::default());
        let written = outgoing.hold(10_000, &mut |piece| {
            piece[..5000].fill(7);
            Some(5000)
        });
        let written = written.unwrap();
        assert_eq!(**written, [7; 5000]);
        let (sent, _) = payload(&written);
        let bytes = written.into_bytes();
        for value in 0..100 {
            drop(result(&outgoing, Way::SharedMemory, 5000, value));
        }
        assert_eq!(bytes, [7; 5000].as_slice());
        assert_eq!(*sent.to_bytes(), [7; 5000]);
        assert!(outgoing.hold(10_000, &mut |_| None).is_none());
    }

    #[test]
    fn nothing_is_shared_with_those_who_cannot_read_it_or_need_not() {
        let outgoing = Arc::new(Outgoing::default());
        assert_eq!(outgoing.way_for_all(), Way::Network);
        assert!(outgoing.memory(Way::Network).is_none());
        let by = |way, len| payload(&result(&outgoing, way, len, 7)).1;
        assert_eq!(by(Way::Network, 100_000), Way::Network);
        assert_eq!(by(Way::SharedMemory, 1000), Way::Network);
        assert!(outgoing.pool.get().is_none(), "no memory is taken for nothing");
        outgoing.prepare();
        assert!(
            outgoing.pool.get().is_some(),
            "it is there before the first result"
        );
        assert_eq!(by(Way::SharedMemory, 100_000), Way::SharedMemory);
        // Made for others, and sent to a neighbour who has come meanwhile.
        assert_eq!(by(Way::Network, 100_000), Way::Network);
    }
}
