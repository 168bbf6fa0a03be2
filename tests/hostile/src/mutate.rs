//! Good input, made bad at random.

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Nothing grows beyond this, in bytes.
const LONGEST: usize = 1 << 16;
/// Numbers at which decoders go wrong.
const EDGES: [u64; 12] = [
    0,
    1,
    0x7f,
    0x80,
    0xff,
    0x7fff,
    0xffff,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    i64::MAX as u64,
    u64::MAX,
];
/// The same where numbers are written in words, and what else may stand there.
const WORDS: [&str; 16] = [
    "-1",
    "0",
    "1e308",
    "1e999",
    "-0.0",
    "NaN",
    "inf",
    "null",
    "18446744073709551616",
    "0.000000001",
    "{}",
    "[]",
    "\"\"",
    "\u{0}",
    "\u{fffd}",
    "..",
];

/// Changes input, always in the same way for the same seed.
#[derive(Debug)]
pub struct Mutator {
    random: StdRng,
}

impl Mutator {
    /// One that makes other inputs for another `seed`.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self {
            random: StdRng::seed_from_u64(seed),
        }
    }

    /// One of `corpus`, changed in 1 to 8 places.
    ///
    /// # Panics
    /// If `corpus` is empty.
    pub fn changed(&mut self, corpus: &[Vec<u8>]) -> Vec<u8> {
        let mut bytes = corpus[self.random.random_range(0..corpus.len())].clone();
        for _ in 0..self.random.random_range(1..=8) {
            self.change(&mut bytes, corpus);
        }
        bytes.truncate(LONGEST);
        bytes
    }

    fn change(&mut self, bytes: &mut Vec<u8>, corpus: &[Vec<u8>]) {
        let at = self.random.random_range(0..=bytes.len());
        let len = self.random.random_range(1..=16_usize).min(bytes.len() - at);
        match self.random.random_range(0..10) {
            0 if at < bytes.len() => bytes[at] ^= 1 << self.random.random_range(0..8),
            1 if at < bytes.len() => bytes[at] = self.random.random(),
            2 => bytes.truncate(at),
            3 => drop(bytes.drain(at..at + len)),
            4 => {
                let copy = bytes[at..at + len].to_vec();
                drop(bytes.splice(at..at, copy));
            }
            5 => {
                // Deep, long, or both.
                let count = 1 << self.random.random_range(0..14);
                let byte = *b"[{(\"=;,:/-\0\xff\x80 a0"
                    .get(self.random.random_range(0..16))
                    .unwrap_or(&b'[');
                drop(bytes.splice(at..at, std::iter::repeat_n(byte, count)));
            }
            6 => {
                let other = &corpus[self.random.random_range(0..corpus.len())];
                let from = self.random.random_range(0..=other.len());
                bytes.truncate(at);
                bytes.extend_from_slice(&other[from..]);
            }
            7 => {
                let edge = EDGES[self.random.random_range(0..EDGES.len())];
                let width = 1 << self.random.random_range(0..4);
                let number = match self.random.random() {
                    true => edge.to_le_bytes()[..width].to_vec(),
                    false => edge.to_be_bytes()[8 - width..].to_vec(),
                };
                let end = (at + width).min(bytes.len());
                drop(bytes.splice(at..end, number));
            }
            8 => self.replace_number(bytes, at),
            _ => {
                let new: [u8; 8] = self.random.random();
                drop(bytes.splice(at..at, new[..len.min(8)].to_vec()));
            }
        }
    }

    /// Another word for the next number that is written out.
    fn replace_number(&mut self, bytes: &mut Vec<u8>, at: usize) {
        let is_number = |byte: &u8| byte.is_ascii_digit() || b"+-.".contains(byte);
        let Some(start) = bytes[at..].iter().position(is_number).map(|from| at + from) else {
            return;
        };
        let len = bytes[start..].iter().take_while(|byte| is_number(byte)).count();
        let word = WORDS[self.random.random_range(0..WORDS.len())];
        drop(bytes.splice(start..start + len, word.bytes()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_seed_makes_the_same_inputs_and_another_one_others() {
        let corpus = [b"{\"latency_budget_ms\": 80}".to_vec(), vec![7; 100]];
        let inputs = |seed| {
            let mut mutator = Mutator::new(seed);
            Vec::from_iter((0..200).map(|_| mutator.changed(&corpus)))
        };
        assert_eq!(inputs(1), inputs(1));
        assert_ne!(inputs(1), inputs(2));
        assert!(inputs(1).iter().all(|input| input.len() <= LONGEST));
        let changed = inputs(1).iter().filter(|input| !corpus.contains(input)).count();
        assert!(changed > 180, "{changed} of 200 are others than the corpus");
    }
}
