//! Marks in a row of bytes: few among many, so they are looked for eight at a time.

/// Bytes looked at together.
const WORD: usize = 8;

/// A row of `width` unmarked pixels, and room for a mark behind the last one.
pub(crate) fn clear(row: &mut Vec<u8>, width: usize) {
    row.clear();
    row.resize((width + 1).next_multiple_of(WORD), 0);
}

/// Positions of the ones in `row`, whose other bytes are zeros; its length is one that `clear` made.
pub(crate) fn positions(row: &[u8]) -> Positions<'_> {
    Positions {
        words: row.as_chunks().0.iter(),
        at: 0,
        word: 0,
    }
}

pub(crate) struct Positions<'a> {
    words: std::slice::Iter<'a, [u8; WORD]>,
    /// Position after the current word, and the marks left in it.
    at: usize,
    word: u64,
}

impl Iterator for Positions<'_> {
    type Item = usize;

    #[inline(always)]
    fn next(&mut self) -> Option<usize> {
        while self.word == 0 {
            self.word = u64::from_le_bytes(*self.words.next()?);
            self.at += WORD;
        }
        let within = self.word.trailing_zeros() / u8::BITS;
        self.word &= self.word - 1;
        Some(self.at - WORD + within as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::{clear, positions};

    #[test]
    fn every_mark_is_found_in_order() {
        let mut row = vec![7; 3];
        clear(&mut row, 30);
        assert_eq!((row.len(), positions(&row).next()), (32, None));
        let marked = [0, 1, 7, 8, 23, 30];
        for at in marked {
            row[at] = 1;
        }
        assert!(positions(&row).eq(marked));
    }
}
