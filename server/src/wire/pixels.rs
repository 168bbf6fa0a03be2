//! The disparities of a map as the wire has them, written once, where they are to lie: they are most of a result's bytes.

use bytes::BufMut;
use prost::{EncodeError, encode_length_delimiter, length_delimiter_len};

use super::result::px_from_fixed;
use crate::encode::disparity_png::kitti_from_fixed;
use crate::job::DisparityEncoding;

/// Pixels that are converted at one time.
const BLOCK_PX: usize = 1024;
/// The wire type of a field whose length precedes it.
const LENGTH_DELIMITED: usize = 2;

/// The field numbers that lead from a message to `Disparity.data`.
#[derive(Clone, Copy)]
pub(super) enum Field {
    /// From a `Disparity`: 7.
    OfPart,
    /// From a `StereoResult`: 5, 7.
    OfResult,
}

/// Disparities in one of the encodings without a file format.
#[derive(Clone, Copy)]
pub(super) struct Pixels<'a> {
    fixed: &'a [u16],
    encoding: Raw,
}

#[derive(Clone, Copy)]
enum Raw {
    F32,
    U16,
}

impl<'a> Pixels<'a> {
    /// The disparities of the core's map, if `encoding` is one of those.
    pub(super) fn new(fixed: &'a [u16], encoding: DisparityEncoding) -> Option<Self> {
        let encoding = match encoding {
            DisparityEncoding::F32 => Raw::F32,
            DisparityEncoding::U16 => Raw::U16,
            DisparityEncoding::Png16 => return None,
        };
        Some(Self { fixed, encoding })
    }

    /// Bytes of all of them.
    pub(super) fn len(&self) -> usize {
        let bytes_a_pixel = match self.encoding {
            Raw::F32 => size_of::<f32>(),
            Raw::U16 => size_of::<u16>(),
        };
        self.fixed.len() * bytes_a_pixel
    }

    /// Bytes of all of them as a field.
    pub(super) fn field_len(&self, field: Field) -> usize {
        // A key takes one byte for the numbers there are.
        let data = 1 + length_delimiter_len(self.len()) + self.len();
        match field {
            Field::OfPart => data,
            Field::OfResult => 1 + length_delimiter_len(data) + data,
        }
    }

    /// Appends them to a message that was encoded without them: of a message that comes in several pieces, a reader puts the pieces
    /// together (protobuf's rule for fields that are messages). `body` has room.
    pub(super) fn put_field(&self, field: Field, body: &mut dyn BufMut) -> Result<(), EncodeError> {
        if matches!(field, Field::OfResult) {
            put_head(5, self.field_len(Field::OfPart), body)?;
        }
        put_head(7, self.len(), body)?;
        self.put(body);
        Ok(())
    }

    /// Appends the bytes alone.
    pub(super) fn put(&self, body: &mut dyn BufMut) {
        match self.encoding {
            Raw::F32 => put_each(self.fixed, body, |fixed| {
                let px = if fixed > 0 { px_from_fixed(fixed) } else { f32::NAN };
                px.to_le_bytes()
            }),
            Raw::U16 => put_each(self.fixed, body, |fixed| kitti_from_fixed(fixed).to_le_bytes()),
        }
    }
}

/// The key of a field and its length, which are numbers of the same form.
fn put_head(number: usize, len: usize, mut body: &mut dyn BufMut) -> Result<(), EncodeError> {
    encode_length_delimiter(number << 3 | LENGTH_DELIMITED, &mut body)?;
    encode_length_delimiter(len, &mut body)
}

fn put_each<const N: usize>(fixed: &[u16], body: &mut dyn BufMut, bytes: impl Fn(u16) -> [u8; N]) {
    let mut block = [[0; N]; BLOCK_PX];
    for fixed in fixed.chunks(BLOCK_PX) {
        for (bytes_of, &fixed) in block.iter_mut().zip(fixed) {
            *bytes_of = bytes(fixed);
        }
        body.put_slice(block[..fixed.len()].as_flattened());
    }
}
