//! AVX-512 with the byte extensions (Ice Lake, Zen 4 and later): four pixels a vector.

use std::arch::x86_64::{
    __m512i, _mm_loadu_si128, _mm_storeu_si128, _mm256_add_epi16, _mm256_cvtepu8_epi16, _mm256_loadu_si256,
    _mm256_max_epu16, _mm256_min_epu16, _mm256_or_si256, _mm256_set1_epi16, _mm256_setr_epi16,
    _mm256_slli_epi16, _mm256_storeu_si256, _mm512_abs_epi16, _mm512_add_epi8, _mm512_add_epi16,
    _mm512_add_epi32, _mm512_adds_epu8, _mm512_and_si512, _mm512_avg_epu8, _mm512_bslli_epi128,
    _mm512_bsrli_epi128, _mm512_castsi128_si512, _mm512_castsi512_si128, _mm512_castsi512_si256,
    _mm512_cmpeq_epi8_mask, _mm512_cmpeq_epi16_mask, _mm512_cmpgt_epi16_mask, _mm512_cmpgt_epu8_mask,
    _mm512_cmplt_epu8_mask, _mm512_cvtepu8_epi16, _mm512_extracti32x4_epi32, _mm512_extracti64x4_epi64,
    _mm512_inserti32x4, _mm512_loadu_si512, _mm512_mask_add_epi8, _mm512_mask_min_epu16,
    _mm512_mask_storeu_epi16, _mm512_maskz_shuffle_epi8, _mm512_max_epi32, _mm512_max_epu8, _mm512_max_epu16,
    _mm512_min_epi32, _mm512_min_epu8, _mm512_min_epu16, _mm512_movm_epi8, _mm512_mullo_epi32,
    _mm512_permutex2var_epi8, _mm512_permutex2var_epi16, _mm512_permutexvar_epi8, _mm512_popcnt_epi8,
    _mm512_reduce_add_epi32, _mm512_rol_epi32, _mm512_sad_epu8, _mm512_set1_epi8, _mm512_set1_epi16,
    _mm512_set1_epi32, _mm512_setr_epi32, _mm512_setzero_si512, _mm512_shuffle_epi8, _mm512_shuffle_epi32,
    _mm512_srli_epi16, _mm512_storeu_si512, _mm512_sub_epi8, _mm512_sub_epi16, _mm512_subs_epu8,
    _mm512_ternarylogic_epi64, _mm512_unpackhi_epi8, _mm512_unpacklo_epi8, _mm512_xor_si512,
};

use super::Kernel;
use super::avx2::{least_of_16, most_of_16};
use super::lanes::{LABELS, Lanes, MOST_PIXELS};

/// Whether this machine has the instructions `run` is compiled for.
pub(super) fn is_available() -> bool {
    super::avx2::is_available()
        && is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512bw")
        && is_x86_feature_detected!("avx512dq")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("avx512vbmi")
        && is_x86_feature_detected!("avx512bitalg")
        && is_x86_feature_detected!("avx512vpopcntdq")
}

/// Compiles and runs `kernel` with AVX-512.
#[target_feature(
    enable = "avx512f,avx512bw,avx512dq,avx512vl,avx512vbmi,avx512bitalg,avx512vpopcntdq,avx2,bmi1,bmi2,popcnt,lzcnt,fma"
)]
pub(super) fn run<K: Kernel>(kernel: K) -> K::Output {
    kernel.run(Avx512(()))
}

/// Made in `run` only, so that it exists only where its instructions do.
#[derive(Debug, Clone, Copy)]
pub(super) struct Avx512(());

/// Byte k of a lane: `k % 16`, and the lane of byte k: `k / 16`.
const ASCENDING: [u8; 64] = bytes(false);
const LANE: [u8; 64] = bytes(true);

/// Word k: `k`, and `2 k + 1`.
const ASCENDING_16: [u16; 32] = words(1, 0);
const ODD_16: [u16; 32] = words(2, 1);

const fn words(step: u16, first: u16) -> [u16; 32] {
    let mut words = [first; 32];
    let mut k = 1;
    while k < 32 {
        words[k] = words[k - 1] + step;
        k += 1;
    }
    words
}

/// Byte k: `63 - k`.
const DESCENDING: [u8; 64] = {
    let mut bytes = [0; 64];
    let mut k = 0;
    while k < 63 {
        bytes[62 - k] = bytes[63 - k] + 1;
        k += 1;
    }
    bytes
};

#[expect(clippy::cast_possible_truncation, reason = "below 16")]
const fn bytes(lane: bool) -> [u8; 64] {
    let mut bytes = [0; 64];
    let mut k = 0;
    while k < 64 {
        bytes[k] = if lane {
            (k / LABELS) as u8
        } else {
            (k % LABELS) as u8
        };
        k += 1;
    }
    bytes
}

macro_rules! intrinsic {
    ($name:ident, $intrinsic:ident) => {
        #[inline(always)]
        fn $name(self, a: __m512i, b: __m512i) -> __m512i {
            // SAFETY: `self` proves that AVX-512 is there.
            unsafe { $intrinsic(a, b) }
        }
    };
}

impl Lanes for Avx512 {
    type V = __m512i;
    const PIXELS: usize = 4;

    #[inline(always)]
    fn load(self, from: &[u8]) -> __m512i {
        let from = &from[..Self::BYTES];
        // SAFETY: `self` proves that AVX-512 is there; the slice has as many bytes as are read.
        unsafe { _mm512_loadu_si512(from.as_ptr().cast()) }
    }

    #[inline(always)]
    fn store(self, v: __m512i, to: &mut [u8]) {
        let to = &mut to[..Self::BYTES];
        // SAFETY: `self` proves that AVX-512 is there; the slice has as many bytes as are written.
        unsafe { _mm512_storeu_si512(to.as_mut_ptr().cast(), v) }
    }

    #[inline(always)]
    fn load_each(self, from: &[u8], at: impl Fn(usize) -> usize) -> __m512i {
        let (a, b) = (&from[at(0)..][..LABELS], &from[at(1)..][..LABELS]);
        let (c, d) = (&from[at(2)..][..LABELS], &from[at(3)..][..LABELS]);
        // SAFETY: `self` proves that AVX-512 is there; each slice has as many bytes as are read.
        unsafe {
            let v = _mm512_castsi128_si512(_mm_loadu_si128(a.as_ptr().cast()));
            let v = _mm512_inserti32x4::<1>(v, _mm_loadu_si128(b.as_ptr().cast()));
            let v = _mm512_inserti32x4::<2>(v, _mm_loadu_si128(c.as_ptr().cast()));
            _mm512_inserti32x4::<3>(v, _mm_loadu_si128(d.as_ptr().cast()))
        }
    }

    #[inline(always)]
    fn load_pixels(self, from: [&[[u8; LABELS]]; MOST_PIXELS], at: usize) -> __m512i {
        let (a, b, c, d) = (&from[0][at], &from[1][at], &from[2][at], &from[3][at]);
        // SAFETY: `self` proves that AVX-512 is there; each array has as many bytes as are read.
        unsafe {
            let v = _mm512_castsi128_si512(_mm_loadu_si128(a.as_ptr().cast()));
            let v = _mm512_inserti32x4::<1>(v, _mm_loadu_si128(b.as_ptr().cast()));
            let v = _mm512_inserti32x4::<2>(v, _mm_loadu_si128(c.as_ptr().cast()));
            _mm512_inserti32x4::<3>(v, _mm_loadu_si128(d.as_ptr().cast()))
        }
    }

    #[inline(always)]
    fn store_pixels(self, v: __m512i, to: &mut [&mut [[u8; LABELS]]; MOST_PIXELS], at: usize) {
        // SAFETY: `self` proves that AVX-512 is there.
        let lanes = unsafe {
            [
                _mm512_castsi512_si128(v),
                _mm512_extracti32x4_epi32::<1>(v),
                _mm512_extracti32x4_epi32::<2>(v),
                _mm512_extracti32x4_epi32::<3>(v),
            ]
        };
        for (to, lane) in to.iter_mut().zip(lanes) {
            let to = &mut to[at];
            // SAFETY: the array has as many bytes as are written.
            unsafe { _mm_storeu_si128(to.as_mut_ptr().cast(), lane) };
        }
    }

    #[inline(always)]
    fn splat(self, byte: u8) -> __m512i {
        // SAFETY: `self` proves that AVX-512 is there.
        unsafe { _mm512_set1_epi8(byte.cast_signed()) }
    }

    #[inline(always)]
    fn spread(self, from: &[u8]) -> __m512i {
        let from = &from[..4];
        let four = i32::from_le_bytes([from[0], from[1], from[2], from[3]]);
        // SAFETY: `self` proves that AVX-512 is there.
        unsafe { _mm512_shuffle_epi8(_mm512_set1_epi32(four), self.load(&LANE)) }
    }

    intrinsic!(add, _mm512_add_epi8);
    intrinsic!(sub, _mm512_sub_epi8);
    intrinsic!(add_saturating, _mm512_adds_epu8);
    intrinsic!(sub_saturating, _mm512_subs_epu8);
    intrinsic!(max, _mm512_max_epu8);
    intrinsic!(min, _mm512_min_epu8);
    intrinsic!(average, _mm512_avg_epu8);
    intrinsic!(and, _mm512_and_si512);
    intrinsic!(xor, _mm512_xor_si512);

    #[inline(always)]
    fn select(self, mask: __m512i, then: __m512i, otherwise: __m512i) -> __m512i {
        // SAFETY: `self` proves that AVX-512 is there. 0xCA: where the first bit is set the second, else the third.
        unsafe { _mm512_ternarylogic_epi64::<0xCA>(mask, then, otherwise) }
    }

    #[inline(always)]
    fn reverse(self, v: __m512i) -> __m512i {
        // SAFETY: `self` proves that AVX-512 is there.
        unsafe { _mm512_permutexvar_epi8(self.load(&DESCENDING), v) }
    }

    #[inline(always)]
    fn add_where_more(self, v: __m512i, bit: u8, a: __m512i, b: __m512i) -> __m512i {
        // SAFETY: `self` proves that AVX-512 is there.
        unsafe { _mm512_mask_add_epi8(v, _mm512_cmpgt_epu8_mask(a, b), v, self.splat(bit)) }
    }

    #[inline(always)]
    fn halve(self, v: __m512i) -> __m512i {
        // SAFETY: `self` proves that AVX-512 is there.
        unsafe { _mm512_and_si512(_mm512_srli_epi16::<1>(v), _mm512_set1_epi8(0x7F)) }
    }

    #[inline(always)]
    fn count_ones(self, v: __m512i) -> __m512i {
        // SAFETY: `self` proves that AVX-512 is there.
        unsafe { _mm512_popcnt_epi8(v) }
    }

    #[inline(always)]
    fn interleave(self, a: __m512i, b: __m512i) -> (__m512i, __m512i) {
        // SAFETY: `self` proves that AVX-512 is there.
        unsafe { (_mm512_unpacklo_epi8(a, b), _mm512_unpackhi_epi8(a, b)) }
    }

    #[inline(always)]
    fn shift(self, v: __m512i, by: __m512i) -> __m512i {
        let from = self.add(self.load(&ASCENDING), by);
        // SAFETY: `self` proves that AVX-512 is there.
        unsafe {
            let exists = _mm512_cmplt_epu8_mask(from, _mm512_set1_epi8(16));
            _mm512_maskz_shuffle_epi8(exists, v, from)
        }
    }

    #[inline(always)]
    fn label_below(self, v: __m512i) -> __m512i {
        // SAFETY: `self` proves that AVX-512 is there.
        unsafe { _mm512_bslli_epi128::<1>(v) }
    }

    #[inline(always)]
    fn label_above(self, v: __m512i) -> __m512i {
        // SAFETY: `self` proves that AVX-512 is there.
        unsafe { _mm512_bsrli_epi128::<1>(v) }
    }

    #[inline(always)]
    fn equal(self, a: __m512i, b: __m512i) -> __m512i {
        // SAFETY: `self` proves that AVX-512 is there.
        unsafe { _mm512_movm_epi8(_mm512_cmpeq_epi8_mask(a, b)) }
    }

    #[inline(always)]
    fn lookup(self, table: &[u8], which: __m512i) -> __m512i {
        let (low, high) = (self.load(table), self.load(&table[Self::BYTES..]));
        // SAFETY: `self` proves that AVX-512 is there.
        unsafe { _mm512_permutex2var_epi8(low, which, high) }
    }

    #[inline(always)]
    fn widen(self, v: __m512i, to: &mut [u16]) {
        let to = &mut to[..Self::BYTES];
        // SAFETY: `self` proves that AVX-512 is there; the slice has as many words as are written.
        unsafe {
            let (low, high) = (_mm512_castsi512_si256(v), _mm512_extracti64x4_epi64::<1>(v));
            _mm512_storeu_si512(to.as_mut_ptr().cast(), _mm512_cvtepu8_epi16(low));
            _mm512_storeu_si512(to[32..].as_mut_ptr().cast(), _mm512_cvtepu8_epi16(high));
        }
    }

    #[inline(always)]
    fn total(self, v: __m512i) -> u32 {
        // SAFETY: `self` proves that AVX-512 is there.
        unsafe {
            let eights = _mm512_sad_epu8(v, _mm512_setzero_si512());
            // Every eight bytes have a small sum, whose upper half is 0.
            _mm512_reduce_add_epi32(eights).cast_unsigned()
        }
    }

    #[inline(always)]
    fn largest(self, v: __m512i) -> __m512i {
        // SAFETY: `self` proves that AVX-512 is there.
        unsafe {
            let v = _mm512_max_epu8(v, _mm512_shuffle_epi32::<0b01_00_11_10>(v));
            let v = _mm512_max_epu8(v, _mm512_shuffle_epi32::<0b10_11_00_01>(v));
            // Now every four bytes have the same maximum: rotate them by two, then by one.
            let v = _mm512_max_epu8(v, _mm512_rol_epi32::<16>(v));
            _mm512_max_epu8(v, _mm512_rol_epi32::<8>(v))
        }
    }

    #[inline(always)]
    fn ramp(self, to: &mut [u16], first: i32, step: i32, most: i32) {
        // SAFETY: `self` proves that AVX-512 is there; the mask has as many bits as the chunk has elements.
        unsafe {
            let ascending = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
            let offsets = _mm512_mullo_epi32(ascending, _mm512_set1_epi32(step));
            let mut low = _mm512_add_epi32(_mm512_set1_epi32(first), offsets);
            let half = _mm512_set1_epi32(step.wrapping_mul(16));
            let upper_halves = _mm512_loadu_si512(ODD_16.as_ptr().cast());
            let most = _mm512_set1_epi32(most);
            for chunk in to.chunks_mut(32) {
                let high = _mm512_add_epi32(low, half);
                let kept_low = _mm512_min_epi32(_mm512_max_epi32(low, _mm512_setzero_si512()), most);
                let kept_high = _mm512_min_epi32(_mm512_max_epi32(high, _mm512_setzero_si512()), most);
                let words = _mm512_permutex2var_epi16(kept_low, upper_halves, kept_high);
                let mask = u32::MAX >> (32 - chunk.len());
                _mm512_mask_storeu_epi16(chunk.as_mut_ptr().cast(), mask, words);
                low = _mm512_add_epi32(high, half);
            }
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
    fn least_and_most(self, values: &[u16]) -> (u16, u16) {
        let values = &values[..Self::BYTES];
        // SAFETY: `self` proves that AVX-512 is there; the slice has as many values as are read.
        unsafe {
            let a = _mm512_loadu_si512(values.as_ptr().cast());
            let b = _mm512_loadu_si512(values[32..].as_ptr().cast());
            let (least, most) = (_mm512_min_epu16(a, b), _mm512_max_epu16(a, b));
            let (low, high) = (
                _mm512_castsi512_si256(least),
                _mm512_extracti64x4_epi64::<1>(least),
            );
            let least = least_of_16(_mm256_min_epu16(low, high));
            let (low, high) = (_mm512_castsi512_si256(most), _mm512_extracti64x4_epi64::<1>(most));
            (least, most_of_16(_mm256_max_epu16(low, high)))
        }
    }

    #[inline(always)]
    fn first_least(self, values: &[u16]) -> (u16, usize) {
        let blocks = values.as_chunks::<32>().0;
        // SAFETY: `self` proves that AVX-512 is there; every block has as many values as are read.
        unsafe {
            let mut least = _mm512_set1_epi16(-1);
            for block in blocks {
                least = _mm512_min_epu16(least, _mm512_loadu_si512(block.as_ptr().cast()));
            }
            let least = least_of_32(least);
            let wanted = _mm512_set1_epi16(least.cast_signed());
            let mut first = 0;
            // From the last to the first, without a branch that would depend on the values.
            for (k, block) in blocks.iter().enumerate().rev() {
                let equal = _mm512_cmpeq_epi16_mask(_mm512_loadu_si512(block.as_ptr().cast()), wanted);
                let here = k * 32 + equal.trailing_zeros() as usize;
                first = if equal == 0 { first } else { here };
            }
            (least, first)
        }
    }

    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "at most 256 values")]
    #[expect(clippy::cast_possible_wrap, reason = "at most 256 values")]
    fn first_least_and_else(self, values: &[u16], apart: usize) -> (u16, usize, u16) {
        let (least, first) = self.first_least(values);
        let blocks = values.as_chunks::<32>().0;
        // SAFETY: `self` proves that AVX-512 is there; every block has as many values as are read.
        unsafe {
            let apart = _mm512_set1_epi16(apart as i16);
            let mut away = _mm512_sub_epi16(
                _mm512_loadu_si512(ASCENDING_16.as_ptr().cast()),
                _mm512_set1_epi16(first as i16),
            );
            let mut elsewhere = _mm512_set1_epi16(-1);
            for block in blocks {
                let far = _mm512_cmpgt_epi16_mask(_mm512_abs_epi16(away), apart);
                let block = _mm512_loadu_si512(block.as_ptr().cast());
                elsewhere = _mm512_mask_min_epu16(elsewhere, far, elsewhere, block);
                away = _mm512_add_epi16(away, _mm512_set1_epi16(32));
            }
            (least, first, least_of_32(elsewhere))
        }
    }
}

/// The least of the 32 values of a vector.
#[inline(always)]
unsafe fn least_of_32(v: __m512i) -> u16 {
    // SAFETY: callers have AVX-512.
    unsafe {
        let (low, high) = (_mm512_castsi512_si256(v), _mm512_extracti64x4_epi64::<1>(v));
        least_of_16(_mm256_min_epu16(low, high))
    }
}
