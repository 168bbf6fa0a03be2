//! The operations that plain loops don't express: several pixels' labels side by side, moved and compared within a pixel.

/// Labels (disparities) of a pixel: one byte each, one 128-bit lane together.
pub(crate) const LABELS: usize = 16;
/// Bytes of the widest vector there is.
pub(crate) const MOST_BYTES: usize = 64;

/// Bytes of a table for `lookup_or_zero`.
pub(crate) const TABLE: usize = 128;

/// Pixels of the widest vector.
pub(crate) const MOST_PIXELS: usize = 4;

/// Vectors of [`LABELS`] bytes for each of `PIXELS` pixels. An implementor's value is the proof that its instructions exist.
pub(crate) trait Lanes: Copy {
    /// A vector.
    type V: Copy;
    /// Pixels of a vector.
    const PIXELS: usize;
    /// Bytes of a vector.
    const BYTES: usize = Self::PIXELS * LABELS;
    /// Bytes of a table for `lookup`.
    const TABLE: usize = 2 * Self::BYTES;

    /// The first `BYTES` of `from`.
    fn load(self, from: &[u8]) -> Self::V;
    /// Writes the first `BYTES` of `to`.
    fn store(self, v: Self::V, to: &mut [u8]);
    /// Pixel i's labels from `from[at(i)..]`.
    fn load_each(self, from: &[u8], at: impl Fn(usize) -> usize) -> Self::V;
    /// Pixel i's labels from `from[i][at]`.
    fn load_pixels(self, from: [&[[u8; LABELS]]; MOST_PIXELS], at: usize) -> Self::V;
    /// Pixel i's labels to `to[i][at]`.
    fn store_pixels(self, v: Self::V, to: &mut [&mut [[u8; LABELS]]; MOST_PIXELS], at: usize);
    /// The same byte everywhere.
    fn splat(self, byte: u8) -> Self::V;
    /// Byte i of the first `PIXELS` of `from` for all labels of pixel i.
    fn spread(self, from: &[u8]) -> Self::V;

    /// Wrapping sum.
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    /// Wrapping difference.
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    /// Sum, at most 255.
    fn add_saturating(self, a: Self::V, b: Self::V) -> Self::V;
    /// Difference, at least 0.
    fn sub_saturating(self, a: Self::V, b: Self::V) -> Self::V;
    /// The larger of each two.
    fn max(self, a: Self::V, b: Self::V) -> Self::V;
    /// The smaller of each two.
    fn min(self, a: Self::V, b: Self::V) -> Self::V;
    /// Mean of each two, halves rounded up.
    fn average(self, a: Self::V, b: Self::V) -> Self::V;
    /// All ones where two bytes are equal, else 0.
    fn equal(self, a: Self::V, b: Self::V) -> Self::V;
    /// Bitwise and.
    fn and(self, a: Self::V, b: Self::V) -> Self::V;
    /// Bytes of `then` where `mask` is all ones, of `otherwise` where it is 0.
    fn select(self, mask: Self::V, then: Self::V, otherwise: Self::V) -> Self::V;
    /// Half of every byte, rounded down.
    fn halve(self, v: Self::V) -> Self::V;
    /// Exclusive or.
    fn xor(self, a: Self::V, b: Self::V) -> Self::V;
    /// Ones of every byte.
    fn count_ones(self, v: Self::V) -> Self::V;
    /// All bits inverted.
    #[inline(always)]
    fn not(self, v: Self::V) -> Self::V {
        self.xor(v, self.splat(u8::MAX))
    }

    /// Within each pixel: bytes 0 to 7 of `a` and `b` by turns (a0, b0, a1, b1, ..), and bytes 8 to 15.
    fn interleave(self, a: Self::V, b: Self::V) -> (Self::V, Self::V);
    /// Label k becomes what label `k + by` was, 0 where there is no such label; `by` is a wrapping byte.
    fn shift(self, v: Self::V, by: Self::V) -> Self::V;
    /// Label k becomes what label k - 1 was, label 0 becomes 0.
    fn label_below(self, v: Self::V) -> Self::V;
    /// Label k becomes what label k + 1 was, the last becomes 0.
    fn label_above(self, v: Self::V) -> Self::V;
    /// Byte i becomes `table[which[i]]`; `table` has at least `TABLE` bytes, and every index is below `TABLE`.
    fn lookup(self, table: &[u8], which: Self::V) -> Self::V;
    /// Byte i becomes `table[which[i]]`, 0 beyond the table.
    #[inline(always)]
    fn lookup_or_zero(self, table: &[u8; TABLE], which: Self::V) -> Self::V {
        let mut found = self.splat(0);
        for (part, first) in table.chunks_exact(Self::TABLE).zip((0u8..).step_by(Self::TABLE)) {
            let within = self.sub(which, self.splat(first));
            #[expect(clippy::cast_possible_truncation, reason = "a table has 128 bytes at most")]
            let is_here = self.equal(self.min(within, self.splat((Self::TABLE - 1) as u8)), within);
            let here = self.lookup(part, self.and(within, is_here));
            found = self.select(is_here, here, found);
        }
        found
    }

    /// Writes every byte as a word to the first `BYTES` of `to`.
    #[inline(always)]
    fn widen(self, v: Self::V, to: &mut [u16]) {
        let mut bytes = [0; MOST_BYTES];
        self.store(v, &mut bytes);
        for (to, byte) in to[..Self::BYTES].iter_mut().zip(bytes) {
            *to = byte.into();
        }
    }
    /// Sum of all bytes.
    fn total(self, v: Self::V) -> u32;
    /// The largest label of each pixel, for all its labels.
    fn largest(self, v: Self::V) -> Self::V;

    /// Fills `to` with the upper halves of `first`, `first + step`, `first + 2 step`, .. (wrapping), each kept within
    /// 0..=`most`.
    #[inline(always)]
    #[expect(clippy::cast_sign_loss, reason = "kept within 0 and more")]
    fn ramp(self, to: &mut [u16], first: i32, step: i32, most: i32) {
        let mut value = first;
        for to in to {
            *to = (value.clamp(0, most) >> 16) as u16;
            value = value.wrapping_add(step);
        }
    }

    /// For each of the [`LABELS`]: `keys[k] = min(keys[k], sums[k] << 8 | first + k)`; `first + k` stays below 256.
    #[inline(always)]
    fn keep_least(self, keys: &mut [u16; LABELS], sums: &[u8; LABELS], first: u16) {
        for ((key, sum), label) in keys.iter_mut().zip(sums).zip(first..) {
            *key = (*key).min(u16::from(*sum) << 8 | label);
        }
    }

    /// `v` with its bytes in the opposite order.
    fn reverse(self, v: Self::V) -> Self::V;
    /// `v`, and `bit` added where `a` is more than `b`.
    #[inline(always)]
    fn add_where_more(self, v: Self::V, bit: u8, a: Self::V, b: Self::V) -> Self::V {
        let more = self.not(self.equal(self.max(a, b), b));
        self.add(v, self.and(more, self.splat(bit)))
    }

    /// The least and the largest of the first `BYTES` values.
    #[inline(always)]
    fn least_and_most(self, values: &[u16]) -> (u16, u16) {
        let (mut least, mut most) = (u16::MAX, 0);
        for &value in &values[..Self::BYTES] {
            least = least.min(value);
            most = most.max(value);
        }
        (least, most)
    }

    /// The least value and where it is first; `values` are a multiple of 32.
    #[inline(always)]
    fn first_least(self, values: &[u16]) -> (u16, usize) {
        let mut least = (u16::MAX, 0);
        for (at, &value) in values.iter().enumerate() {
            if value < least.0 {
                least = (value, at);
            }
        }
        least
    }

    /// The same, and the least of the values more than `apart` away from there (`u16::MAX` without any).
    #[inline(always)]
    fn first_least_and_else(self, values: &[u16], apart: usize) -> (u16, usize, u16) {
        let (least, best) = self.first_least(values);
        let mut elsewhere = u16::MAX;
        for (at, &value) in values.iter().enumerate() {
            if at.abs_diff(best) > apart {
                elsewhere = elsewhere.min(value);
            }
        }
        (least, best, elsewhere)
    }
}
