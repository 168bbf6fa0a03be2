//! AVX2: two pixels a vector.

use std::arch::x86_64::{
    __m256i, _mm_add_epi32, _mm_cvtsi128_si32, _mm_cvtsi128_si64, _mm_loadu_si128, _mm_min_epu16,
    _mm_minpos_epu16, _mm_packus_epi32, _mm_storel_epi64, _mm_storeu_si128, _mm_unpackhi_epi64,
    _mm256_abs_epi16, _mm256_add_epi8, _mm256_add_epi16, _mm256_add_epi32, _mm256_adds_epu8,
    _mm256_and_si256, _mm256_avg_epu8, _mm256_blendv_epi8, _mm256_broadcastsi128_si256, _mm256_bslli_epi128,
    _mm256_bsrli_epi128, _mm256_castsi256_si128, _mm256_cmpeq_epi8, _mm256_cmpeq_epi16, _mm256_cmpgt_epi16,
    _mm256_cvtepu8_epi16, _mm256_extracti128_si256, _mm256_loadu_si256, _mm256_max_epi32, _mm256_max_epu8,
    _mm256_max_epu16, _mm256_min_epi32, _mm256_min_epu8, _mm256_min_epu16, _mm256_movemask_epi8,
    _mm256_mullo_epi32, _mm256_or_si256, _mm256_permute2x128_si256, _mm256_sad_epu8, _mm256_set_m128i,
    _mm256_set1_epi8, _mm256_set1_epi16, _mm256_set1_epi32, _mm256_setr_epi8, _mm256_setr_epi16,
    _mm256_setr_epi32, _mm256_setzero_si256, _mm256_shuffle_epi8, _mm256_shuffle_epi32, _mm256_slli_epi16,
    _mm256_srli_epi16, _mm256_srli_epi32, _mm256_storeu_si256, _mm256_sub_epi8, _mm256_sub_epi16,
    _mm256_subs_epu8, _mm256_unpackhi_epi8, _mm256_unpacklo_epi8, _mm256_xor_si256,
};

use super::Kernel;
use super::lanes::{LABELS, Lanes, MOST_PIXELS};

/// Whether this machine has the instructions `run` is compiled for.
pub(super) fn is_available() -> bool {
    is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("bmi1")
        && is_x86_feature_detected!("bmi2")
        && is_x86_feature_detected!("popcnt")
        && is_x86_feature_detected!("lzcnt")
        && is_x86_feature_detected!("fma")
}

/// Compiles and runs `kernel` with AVX2.
#[target_feature(enable = "avx2,bmi1,bmi2,popcnt,lzcnt,fma")]
pub(super) fn run<K: Kernel>(kernel: K) -> K::Output {
    kernel.run(Avx2(()))
}

/// Made in `run` only, so that it exists only where its instructions do.
#[derive(Debug, Clone, Copy)]
pub(super) struct Avx2(());

/// 0..=15 twice.
const ASCENDING: [u8; 32] = {
    let mut bytes = [0; 32];
    let mut k = 0;
    while k < 32 {
        #[expect(clippy::cast_possible_truncation, reason = "below 16")]
        {
            bytes[k] = (k % LABELS) as u8;
        }
        k += 1;
    }
    bytes
};

macro_rules! intrinsic {
    ($name:ident, $intrinsic:ident) => {
        #[inline(always)]
        fn $name(self, a: __m256i, b: __m256i) -> __m256i {
            // SAFETY: `self` proves that AVX2 is there.
            unsafe { $intrinsic(a, b) }
        }
    };
}

impl Lanes for Avx2 {
    type V = __m256i;
    const PIXELS: usize = 2;

    #[inline(always)]
    fn load(self, from: &[u8]) -> __m256i {
        let from = &from[..Self::BYTES];
        // SAFETY: `self` proves that AVX2 is there; the slice has as many bytes as are read.
        unsafe { _mm256_loadu_si256(from.as_ptr().cast()) }
    }

    #[inline(always)]
    fn store(self, v: __m256i, to: &mut [u8]) {
        let to = &mut to[..Self::BYTES];
        // SAFETY: `self` proves that AVX2 is there; the slice has as many bytes as are written.
        unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), v) }
    }

    #[inline(always)]
    fn load_each(self, from: &[u8], at: impl Fn(usize) -> usize) -> __m256i {
        let (low, high) = (&from[at(0)..][..LABELS], &from[at(1)..][..LABELS]);
        // SAFETY: `self` proves that AVX2 is there; both slices have as many bytes as are read.
        unsafe {
            _mm256_set_m128i(
                _mm_loadu_si128(high.as_ptr().cast()),
                _mm_loadu_si128(low.as_ptr().cast()),
            )
        }
    }

    #[inline(always)]
    fn load_pixels(self, from: [&[[u8; LABELS]]; MOST_PIXELS], at: usize) -> __m256i {
        let (low, high) = (&from[0][at], &from[1][at]);
        // SAFETY: `self` proves that AVX2 is there; both arrays have as many bytes as are read.
        unsafe {
            _mm256_set_m128i(
                _mm_loadu_si128(high.as_ptr().cast()),
                _mm_loadu_si128(low.as_ptr().cast()),
            )
        }
    }

    #[inline(always)]
    fn store_pixels(self, v: __m256i, to: &mut [&mut [[u8; LABELS]]; MOST_PIXELS], at: usize) {
        let low = &mut to[0][at];
        // SAFETY: `self` proves that AVX2 is there; the array has as many bytes as are written.
        unsafe { _mm_storeu_si128(low.as_mut_ptr().cast(), _mm256_castsi256_si128(v)) };
        let high = &mut to[1][at];
        // SAFETY: as above.
        unsafe { _mm_storeu_si128(high.as_mut_ptr().cast(), _mm256_extracti128_si256::<1>(v)) };
    }

    #[inline(always)]
    fn splat(self, byte: u8) -> __m256i {
        // SAFETY: `self` proves that AVX2 is there.
        unsafe { _mm256_set1_epi8(byte.cast_signed()) }
    }

    #[inline(always)]
    fn spread(self, from: &[u8]) -> __m256i {
        let both = i16::from_le_bytes([from[0], from[1]]);
        // SAFETY: `self` proves that AVX2 is there.
        unsafe {
            let which = _mm256_setr_epi8(
                0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1,
                1,
            );
            _mm256_shuffle_epi8(_mm256_set1_epi16(both), which)
        }
    }

    intrinsic!(add, _mm256_add_epi8);
    intrinsic!(sub, _mm256_sub_epi8);
    intrinsic!(add_saturating, _mm256_adds_epu8);
    intrinsic!(sub_saturating, _mm256_subs_epu8);
    intrinsic!(max, _mm256_max_epu8);
    intrinsic!(min, _mm256_min_epu8);
    intrinsic!(average, _mm256_avg_epu8);
    intrinsic!(equal, _mm256_cmpeq_epi8);
    intrinsic!(and, _mm256_and_si256);
    intrinsic!(xor, _mm256_xor_si256);

    #[inline(always)]
    fn select(self, mask: __m256i, then: __m256i, otherwise: __m256i) -> __m256i {
        // SAFETY: `self` proves that AVX2 is there.
        unsafe { _mm256_blendv_epi8(otherwise, then, mask) }
    }

    #[inline(always)]
    fn reverse(self, v: __m256i) -> __m256i {
        // SAFETY: `self` proves that AVX2 is there.
        unsafe {
            let backwards = _mm256_setr_epi8(
                15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0, 15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5,
                4, 3, 2, 1, 0,
            );
            let lanes = _mm256_shuffle_epi8(v, backwards);
            _mm256_permute2x128_si256::<0x01>(lanes, lanes)
        }
    }

    #[inline(always)]
    fn halve(self, v: __m256i) -> __m256i {
        // SAFETY: `self` proves that AVX2 is there.
        unsafe { _mm256_and_si256(_mm256_srli_epi16::<1>(v), _mm256_set1_epi8(0x7F)) }
    }

    #[inline(always)]
    fn count_ones(self, v: __m256i) -> __m256i {
        // SAFETY: `self` proves that AVX2 is there.
        unsafe {
            let ones = _mm256_setr_epi8(
                0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4, 0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3,
                4,
            );
            let nibble = _mm256_set1_epi8(0x0F);
            let low = _mm256_shuffle_epi8(ones, _mm256_and_si256(v, nibble));
            let high = _mm256_shuffle_epi8(ones, _mm256_and_si256(_mm256_srli_epi16::<4>(v), nibble));
            _mm256_add_epi8(low, high)
        }
    }

    #[inline(always)]
    fn interleave(self, a: __m256i, b: __m256i) -> (__m256i, __m256i) {
        // SAFETY: `self` proves that AVX2 is there.
        unsafe { (_mm256_unpacklo_epi8(a, b), _mm256_unpackhi_epi8(a, b)) }
    }

    #[inline(always)]
    fn shift(self, v: __m256i, by: __m256i) -> __m256i {
        let from = self.add(self.load(&ASCENDING), by);
        // SAFETY: `self` proves that AVX2 is there.
        unsafe {
            let exists = _mm256_cmpeq_epi8(_mm256_min_epu8(from, _mm256_set1_epi8(15)), from);
            _mm256_and_si256(_mm256_shuffle_epi8(v, from), exists)
        }
    }

    #[inline(always)]
    fn label_below(self, v: __m256i) -> __m256i {
        // SAFETY: `self` proves that AVX2 is there.
        unsafe { _mm256_bslli_epi128::<1>(v) }
    }

    #[inline(always)]
    fn label_above(self, v: __m256i) -> __m256i {
        // SAFETY: `self` proves that AVX2 is there.
        unsafe { _mm256_bsrli_epi128::<1>(v) }
    }

    #[inline(always)]
    fn lookup(self, table: &[u8], which: __m256i) -> __m256i {
        let table = &table[..Self::TABLE];
        let mut found = self.splat(0);
        for (part, sixteen) in (0u8..).zip(table.as_chunks::<LABELS>().0) {
            // Indices within this part stay 0x70..=0x7F, all others get the high bit, for which a shuffle gives 0.
            let within = self.sub(which, self.splat(part * 16));
            let within = self.add_saturating(within, self.splat(0x70));
            // SAFETY: `self` proves that AVX2 is there; the part has as many bytes as are read.
            unsafe {
                let sixteen = _mm256_broadcastsi128_si256(_mm_loadu_si128(sixteen.as_ptr().cast()));
                found = _mm256_or_si256(found, _mm256_shuffle_epi8(sixteen, within));
            }
        }
        found
    }

    #[inline(always)]
    fn widen(self, v: __m256i, to: &mut [u16]) {
        let to = &mut to[..Self::BYTES];
        // SAFETY: `self` proves that AVX2 is there; the slice has as many words as are written.
        unsafe {
            let (low, high) = (_mm256_castsi256_si128(v), _mm256_extracti128_si256::<1>(v));
            _mm256_storeu_si256(to.as_mut_ptr().cast(), _mm256_cvtepu8_epi16(low));
            _mm256_storeu_si256(to[16..].as_mut_ptr().cast(), _mm256_cvtepu8_epi16(high));
        }
    }

    #[inline(always)]
    fn total(self, v: __m256i) -> u32 {
        // SAFETY: `self` proves that AVX2 is there.
        unsafe {
            let eights = _mm256_sad_epu8(v, _mm256_setzero_si256());
            let (low, high) = (
                _mm256_castsi256_si128(eights),
                _mm256_extracti128_si256::<1>(eights),
            );
            let twos = _mm_add_epi32(low, high);
            let one = _mm_add_epi32(twos, _mm_unpackhi_epi64(twos, twos));
            _mm_cvtsi128_si32(one).cast_unsigned()
        }
    }

    #[inline(always)]
    fn largest(self, v: __m256i) -> __m256i {
        // SAFETY: `self` proves that AVX2 is there.
        unsafe {
            let v = _mm256_max_epu8(v, _mm256_shuffle_epi32::<0b01_00_11_10>(v));
            let v = _mm256_max_epu8(v, _mm256_shuffle_epi32::<0b10_11_00_01>(v));
            // Now every four bytes have the same maximum: rotate them by two, then by one.
            let by_two = _mm256_setr_epi8(
                2, 3, 0, 1, 6, 7, 4, 5, 10, 11, 8, 9, 14, 15, 12, 13, 2, 3, 0, 1, 6, 7, 4, 5, 10, 11, 8, 9,
                14, 15, 12, 13,
            );
            let v = _mm256_max_epu8(v, _mm256_shuffle_epi8(v, by_two));
            let by_one = _mm256_setr_epi8(
                1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 13, 12, 15, 14, 1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10,
                13, 12, 15, 14,
            );
            _mm256_max_epu8(v, _mm256_shuffle_epi8(v, by_one))
        }
    }

    #[inline(always)]
    fn keep_least(self, keys: &mut [u16; LABELS], sums: &[u8; LABELS], first: u16) {
        // SAFETY: `self` proves that AVX2 is there; both arrays have as many bytes as are read and written.
        unsafe {
            let ascending = _mm256_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
            let labels = _mm256_add_epi16(ascending, _mm256_set1_epi16(first.cast_signed()));
            let sums = _mm256_cvtepu8_epi16(_mm_loadu_si128(sums.as_ptr().cast()));
            let new = _mm256_or_si256(_mm256_slli_epi16::<8>(sums), labels);
            let old = _mm256_loadu_si256(keys.as_ptr().cast());
            _mm256_storeu_si256(keys.as_mut_ptr().cast(), _mm256_min_epu16(old, new));
        }
    }

    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "rows are short")]
    #[expect(clippy::cast_possible_wrap, reason = "rows are short")]
    fn ramp(self, to: &mut [u16], first: i32, step: i32, most: i32) {
        let n = to.len();
        let value = |at: usize| first.wrapping_add(step.wrapping_mul(at as i32));
        // SAFETY: `self` proves that AVX2 is there; every vector is stored to a chunk of its length.
        unsafe {
            let ascending = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
            let offsets = _mm256_mullo_epi32(ascending, _mm256_set1_epi32(step));
            let most = _mm256_set1_epi32(most);
            let eight = |at: usize| {
                let values = _mm256_add_epi32(_mm256_set1_epi32(value(at)), offsets);
                let kept = _mm256_min_epi32(_mm256_max_epi32(values, _mm256_setzero_si256()), most);
                let halves = _mm256_srli_epi32::<16>(kept);
                _mm_packus_epi32(
                    _mm256_castsi256_si128(halves),
                    _mm256_extracti128_si256::<1>(halves),
                )
            };
            // What whole vectors leave is in one that overlaps them, with the same values.
            if n >= 8 {
                for (k, chunk) in to.as_chunks_mut::<8>().0.iter_mut().enumerate() {
                    _mm_storeu_si128(chunk.as_mut_ptr().cast(), eight(8 * k));
                }
                _mm_storeu_si128(to[n - 8..].as_mut_ptr().cast(), eight(n - 8));
            } else if n >= 4 {
                for at in [0, n - 4] {
                    _mm_storel_epi64(to[at..at + 4].as_mut_ptr().cast(), eight(at));
                }
            } else {
                let words = _mm_cvtsi128_si64(eight(0));
                for (k, to) in to.iter_mut().enumerate() {
                    *to = (words.cast_unsigned() >> (16 * k)) as u16;
                }
            }
        }
    }

    #[inline(always)]
    fn least_and_most(self, values: &[u16]) -> (u16, u16) {
        let values = &values[..Self::BYTES];
        // SAFETY: `self` proves that AVX2 is there; the slice has as many values as are read.
        unsafe {
            let a = _mm256_loadu_si256(values.as_ptr().cast());
            let b = _mm256_loadu_si256(values[LABELS..].as_ptr().cast());
            (
                least_of_16(_mm256_min_epu16(a, b)),
                most_of_16(_mm256_max_epu16(a, b)),
            )
        }
    }

    #[inline(always)]
    fn first_least(self, values: &[u16]) -> (u16, usize) {
        let blocks = values.as_chunks::<LABELS>().0;
        // SAFETY: `self` proves that AVX2 is there; every block has as many values as are read.
        unsafe {
            let mut least = _mm256_set1_epi16(-1);
            for block in blocks {
                least = _mm256_min_epu16(least, _mm256_loadu_si256(block.as_ptr().cast()));
            }
            let least = least_of_16(least);
            let wanted = _mm256_set1_epi16(least.cast_signed());
            let mut first = 0;
            // From the last to the first, without a branch that would depend on the values.
            for (k, block) in blocks.iter().enumerate().rev() {
                let equal = _mm256_cmpeq_epi16(_mm256_loadu_si256(block.as_ptr().cast()), wanted);
                let bits = _mm256_movemask_epi8(equal);
                let here = k * LABELS + bits.trailing_zeros() as usize / 2;
                first = if bits == 0 { first } else { here };
            }
            (least, first)
        }
    }

    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "at most 256 values")]
    #[expect(clippy::cast_possible_wrap, reason = "at most 256 values")]
    fn first_least_and_else(self, values: &[u16], apart: usize) -> (u16, usize, u16) {
        let (least, first) = self.first_least(values);
        let blocks = values.as_chunks::<LABELS>().0;
        // SAFETY: `self` proves that AVX2 is there; every block has as many values as are read.
        unsafe {
            let beside = _mm256_set1_epi16(apart as i16 + 1);
            let ascending = _mm256_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
            let mut away = _mm256_sub_epi16(ascending, _mm256_set1_epi16(first as i16));
            let mut elsewhere = _mm256_set1_epi16(-1);
            for block in blocks {
                let near = _mm256_cmpgt_epi16(beside, _mm256_abs_epi16(away));
                let block = _mm256_loadu_si256(block.as_ptr().cast());
                elsewhere = _mm256_min_epu16(elsewhere, _mm256_or_si256(block, near));
                away = _mm256_add_epi16(away, _mm256_set1_epi16(16));
            }
            (least, first, least_of_16(elsewhere))
        }
    }
}

/// The least of the 16 values of a vector.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "16 bits of 32 hold the value")]
#[expect(clippy::cast_sign_loss, reason = "bits are kept as they are")]
pub(super) unsafe fn least_of_16(v: __m256i) -> u16 {
    // SAFETY: callers have AVX2.
    unsafe {
        let eight = _mm_min_epu16(_mm256_castsi256_si128(v), _mm256_extracti128_si256::<1>(v));
        _mm_cvtsi128_si32(_mm_minpos_epu16(eight)) as u16
    }
}

/// The largest of the 16 values of a vector.
#[inline(always)]
pub(super) unsafe fn most_of_16(v: __m256i) -> u16 {
    // SAFETY: callers have AVX2.
    unsafe { !least_of_16(_mm256_xor_si256(v, _mm256_set1_epi16(-1))) }
}
