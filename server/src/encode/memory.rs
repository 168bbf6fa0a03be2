//! The memory that results are encoded into: this process's own, or what a transport shares with whoever reads them.

use std::any::Any;
use std::ops::Deref;
use std::sync::Arc;

use bytes::{BufMut, Bytes};
use prost::EncodeError;

/// An encoded result.
#[derive(Debug, Clone, Default)]
pub struct Encoded {
    bytes: Bytes,
    origin: Option<Arc<dyn Any + Send + Sync>>,
    had_no_room: bool,
}

/// Memory of a transport. Results that lie in it needn't be copied to be sent.
pub trait Memory: Send + Sync {
    /// Lets `write` fill a piece of `most` bytes and say how many of them it has used; `None` if there is no such piece or `write`
    /// used none. Nothing waits for room.
    fn hold(&self, most: usize, write: &mut dyn FnMut(&mut [u8]) -> Option<usize>) -> Option<Encoded>;
}

impl Encoded {
    /// Bytes that lie in a transport's memory, with what that transport knows them by.
    pub fn in_memory_of<T: Any + Send + Sync>(origin: Arc<T>, bytes: Bytes) -> Self {
        Self {
            bytes,
            origin: Some(origin),
            had_no_room: false,
        }
    }

    /// What the transport knows them by, if they lie in its memory.
    pub fn origin<T: Any>(&self) -> Option<&T> {
        self.origin.as_deref()?.downcast_ref()
    }

    /// Whether they lie in this process's own memory.
    #[must_use]
    pub fn is_own(&self) -> bool {
        self.origin.is_none()
    }

    /// Whether they were to lie in a transport's memory, and it had no piece for them.
    #[must_use]
    pub fn had_no_room(&self) -> bool {
        self.had_no_room
    }

    /// The bytes, wherever they lie.
    #[must_use]
    pub fn into_bytes(self) -> Bytes {
        self.bytes
    }
}

impl Deref for Encoded {
    type Target = Bytes;

    fn deref(&self) -> &Bytes {
        &self.bytes
    }
}

impl PartialEq for Encoded {
    /// What they say counts, not where they lie.
    fn eq(&self, other: &Self) -> bool {
        self.bytes == other.bytes
    }
}

impl<T: Into<Bytes>> From<T> for Encoded {
    fn from(bytes: T) -> Self {
        Self {
            bytes: bytes.into(),
            ..Self::default()
        }
    }
}

/// What `write` writes, in `memory` if that has room for `expected` bytes and they are enough, otherwise in this process's own.
///
/// # Errors
/// What `write` fails with for other reasons than room.
pub(crate) fn encoded(
    memory: Option<&dyn Memory>,
    expected: usize,
    mut write: impl FnMut(&mut dyn BufMut) -> Result<(), EncodeError>,
) -> Result<Encoded, EncodeError> {
    let mut fill = |piece: &mut [u8]| {
        let size = piece.len();
        let mut rest = piece;
        let is_whole = size >= expected && write(&mut rest).is_ok();
        is_whole.then_some(size - rest.len())
    };
    if let Some(held) = memory.and_then(|memory| memory.hold(expected, &mut fill)) {
        return Ok(held);
    }
    let mut own = Vec::with_capacity(expected);
    write(&mut own)?;
    Ok(Encoded {
        had_no_room: memory.is_some(),
        ..own.into()
    })
}

#[cfg(test)]
mod tests {
    use prost::Message;

    use super::*;

    /// Pieces of at most so many bytes.
    struct Pieces(usize);

    impl Memory for Pieces {
        fn hold(&self, most: usize, write: &mut dyn FnMut(&mut [u8]) -> Option<usize>) -> Option<Encoded> {
            let mut piece = vec![0; most.min(self.0)];
            let used = write(&mut piece)?;
            piece.truncate(used);
            Some(Encoded::in_memory_of(Arc::new(self.0), piece.into()))
        }
    }

    #[test]
    fn results_lie_in_a_transports_memory_if_they_fit_and_in_our_own_otherwise() {
        let message = "a message".to_owned();
        let expected = message.encode_to_vec();
        let len = expected.len();
        for (size, asked, lies_there) in [
            (100, 100, true),
            (100, len, true),
            (100, len - 1, false),
            (len, 100, false),
        ] {
            let memory = Pieces(size);
            let held = encoded(Some(&memory), asked, |to| message.encode(&mut &mut *to)).unwrap();
            assert_eq!(**held, expected, "{size}");
            assert_eq!(held.origin::<usize>().is_some(), lies_there, "{size}");
            assert_eq!(held.had_no_room(), !lies_there, "{size}");
        }
        let own = encoded(None, 1, |to| message.encode(&mut &mut *to)).unwrap();
        assert_eq!(**own, expected);
        assert!(own.origin::<usize>().is_none() && !own.had_no_room());
    }
}
