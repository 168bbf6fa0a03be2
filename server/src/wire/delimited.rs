//! Messages one after another, each with its length before it as a varint: how a batch is written, both ways.

use bytes::{Buf, BufMut, Bytes, BytesMut};
use prost::Message;
use prost::encoding::{WireType, encode_key, encode_varint, encoded_len_varint};
use stereo_proto::v1;

use crate::status::ServiceError;

/// Number of `BatchReply.result`.
const RESULT_FIELD: u32 = 2;
/// A varint of 64 bits has at most this many bytes.
const LONGEST_VARINT: usize = 10;

/// Takes messages out of bytes that arrive in any pieces.
#[derive(Debug)]
pub struct Delimited {
    arrived: BytesMut,
    max_len: u64,
    /// Length of the message that is arriving, once it is known.
    len: Option<usize>,
}

impl Delimited {
    /// For messages of up to `max_len` bytes.
    #[must_use]
    pub fn new(max_len: u64) -> Self {
        Self {
            arrived: BytesMut::new(),
            max_len,
            len: None,
        }
    }

    /// The next piece.
    pub fn push(&mut self, piece: &[u8]) {
        if let Some(len) = self.len {
            // One allocation a message, whatever pieces it comes in.
            self.arrived
                .reserve(len.saturating_sub(self.arrived.len()).max(piece.len()));
        }
        self.arrived.extend_from_slice(piece);
    }

    /// Length in bytes of the message that comes next, as soon as that much has arrived.
    ///
    /// # Errors
    /// [`ServiceError::Invalid`] if this can't be a length or is 0, [`ServiceError::TooLarge`] if it is above the limit. What follows
    /// can't be read then.
    pub fn next_len(&mut self) -> Result<Option<usize>, ServiceError> {
        if self.len.is_none() {
            self.len = self.read_len()?;
        }
        Ok(self.len)
    }

    /// The next message, if all of it has arrived.
    ///
    /// # Errors
    /// As [`next_len`](Self::next_len).
    pub fn next_message(&mut self) -> Result<Option<Bytes>, ServiceError> {
        match self.next_len()? {
            Some(len) if self.arrived.len() >= len => {
                self.len = None;
                Ok(Some(self.arrived.split_to(len).freeze()))
            }
            _ => Ok(None),
        }
    }

    /// Whether the bytes end between two messages.
    #[must_use]
    pub fn is_between(&self) -> bool {
        self.arrived.is_empty() && self.len.is_none()
    }

    fn read_len(&mut self) -> Result<Option<usize>, ServiceError> {
        let start = &self.arrived[..self.arrived.len().min(LONGEST_VARINT)];
        let Some(end) = start.iter().position(|byte| byte & 0x80 == 0) else {
            return match start.len() {
                LONGEST_VARINT => Err(malformed()),
                _ => Ok(None),
            };
        };
        let mut varint = &start[..=end];
        let len = prost::encoding::decode_varint(&mut varint).map_err(|_| malformed())?;
        if len == 0 {
            // Every byte of a run of zeros would be a request, and get a refusal much longer than itself.
            return Err(ServiceError::Invalid(
                "a request of a batch has 0 bytes: the batch ends here, send the rest again".to_owned(),
            ));
        }
        if len > self.max_len {
            return Err(ServiceError::TooLarge(format!(
                "a request of a batch can have up to {} bytes, got {len}: send a smaller image or a tighter encoding",
                self.max_len
            )));
        }
        self.arrived.advance(end + 1);
        usize::try_from(len).map(Some).map_err(|_| malformed())
    }
}

/// `message` with its length before it.
#[must_use]
pub fn delimited(message: &impl Message) -> Bytes {
    let len = message.encoded_len();
    let mut bytes = BytesMut::with_capacity(len + encoded_len_varint(len as u64));
    encode_varint(len as u64, &mut bytes);
    bytes.put(message.encode_to_vec().as_slice());
    bytes.freeze()
}

/// What comes before the bytes of a `StereoResult` to make them a `BatchReply` with its length before it.
#[must_use]
pub fn delimited_result_head(request_id: &str, result: &[u8]) -> Bytes {
    let id = v1::BatchReply {
        request_id: request_id.to_owned(),
        outcome: None,
    };
    // The field `result` of the oneof: a key, a length, and the message's own bytes.
    let mut key = BytesMut::new();
    encode_key(RESULT_FIELD, WireType::LengthDelimited, &mut key);
    encode_varint(result.len() as u64, &mut key);
    let len = id.encoded_len() + key.len() + result.len();
    let mut head = BytesMut::with_capacity(LONGEST_VARINT + id.encoded_len() + key.len());
    encode_varint(len as u64, &mut head);
    head.put(id.encode_to_vec().as_slice());
    head.put(key);
    head.freeze()
}

fn malformed() -> ServiceError {
    ServiceError::Invalid(
        "the batch is malformed: write each stereo.v1.StereoRequest with its length before it as a varint"
            .to_owned(),
    )
}

#[cfg(test)]
mod tests {
    use stereo_proto::v1::Status;

    use super::*;

    fn status(text: &str) -> Status {
        Status {
            message: text.to_owned(),
            ..Status::default()
        }
    }

    #[test]
    fn messages_are_found_in_pieces_of_any_size() {
        let sent = [status("a"), status("short"), status(&"long ".repeat(100))];
        let stream: Vec<u8> = sent.iter().flat_map(delimited).collect();
        for size in [1, 2, 7, stream.len()] {
            let mut reader = Delimited::new(1 << 10);
            let mut read = Vec::new();
            for piece in stream.chunks(size) {
                reader.push(piece);
                while let Some(message) = reader.next_message().unwrap() {
                    read.push(Status::decode(message).unwrap());
                }
            }
            assert_eq!(read, sent, "in pieces of {size}");
            assert!(reader.is_between());
        }
    }

    #[test]
    fn a_result_with_its_head_is_a_batch_reply() {
        let result = v1::StereoResult {
            camera_id: "front".into(),
            ..v1::StereoResult::default()
        };
        let expected = v1::BatchReply {
            request_id: "a/1".into(),
            outcome: Some(v1::batch_reply::Outcome::Result(Box::new(result.clone()))),
        };
        let body = result.encode_to_vec();
        let head = delimited_result_head("a/1", &body);
        assert_eq!([head.as_ref(), &body].concat(), delimited(&expected));
    }

    #[test]
    fn a_message_that_is_not_whole_is_waited_for() {
        let stream = delimited(&status("hello"));
        let mut reader = Delimited::new(1 << 10);
        reader.push(&stream[..3]);
        assert_eq!(reader.next_message(), Ok(None));
        assert!(!reader.is_between());
        assert_eq!(reader.next_len(), Ok(Some(stream.len() - 1)));
    }

    #[test]
    fn lengths_over_the_limit_and_no_lengths_are_refused() {
        let mut reader = Delimited::new(100);
        reader.push(&[0x80, 0x10]);
        assert!(matches!(reader.next_message(), Err(ServiceError::TooLarge(_))));
        let mut reader = Delimited::new(100);
        reader.push(&[0xff; 10]);
        assert!(matches!(reader.next_message(), Err(ServiceError::Invalid(_))));
        let mut reader = Delimited::new(100);
        reader.push(&[0, 0]);
        assert!(matches!(reader.next_message(), Err(ServiceError::Invalid(_))));
    }
}
