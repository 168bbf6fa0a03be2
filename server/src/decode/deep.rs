//! 16-bit gray of cameras that use fewer bits: which, is known only when the whole image has been seen.
//!
//! Cameras of 10, 12 or 14 bits send them at the lower end of 16-bit words, where the upper byte alone would be nearly
//! black. Words are moved up until the highest bit that any of them uses is the word's highest; values below 256 are
//! taken for 8 bits. The two images of a pair may differ by a bit: matching compares neighbours within an image, never
//! values between the images.

use super::pixels::Layout;
use crate::job::PixelFormat;

/// The pixels of a mono16 image, and the bits any of them uses.
pub(super) struct Deep<'a> {
    /// Little-endian words, row by row.
    words: &'a mut Vec<u8>,
    used: u16,
}

impl<'a> Deep<'a> {
    pub(super) const LAYOUT: Layout = Layout::Raw(PixelFormat::Mono16);

    /// No pixels yet; they are kept in `words`, whose content is lost.
    pub(super) fn in_memory(words: &'a mut Vec<u8>) -> Self {
        words.clear();
        Self { words, used: 0 }
    }

    /// Takes in a row of little-endian words.
    pub(super) fn push(&mut self, row: &[u8]) {
        for word in row.as_chunks::<2>().0 {
            self.used |= u16::from_le_bytes(*word);
        }
        self.words.extend_from_slice(row);
    }

    /// All words, row by row without padding, moved up as far as the image's largest value allows, by at most a byte.
    pub(super) fn into_full_range(self) -> &'a [u8] {
        let unused = self.used.leading_zeros().min(u8::BITS);
        for word in self.words.as_chunks_mut::<2>().0 {
            *word = (u16::from_le_bytes(*word) << unused).to_le_bytes();
        }
        self.words
    }
}
