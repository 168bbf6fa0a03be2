//! NEON, which every 64-bit ARM has: one pixel a vector.

use std::arch::aarch64::{
    uint8x16_t, uint8x16x2_t, vaddlvq_u8, vaddq_u8, vandq_u8, vbslq_u8, vceqq_u8, vcntq_u8, vdupq_n_u8,
    veorq_u8, vextq_u8, vld1q_u8, vmaxq_u8, vmaxvq_u8, vminq_u8, vqaddq_u8, vqsubq_u8, vqtbl1q_u8,
    vqtbl2q_u8, vrev64q_u8, vrhaddq_u8, vshrq_n_u8, vst1q_u8, vsubq_u8, vzip1q_u8, vzip2q_u8,
};

use super::lanes::{LABELS, Lanes, MOST_PIXELS};

/// 64-bit ARM always has NEON, so this needs no detection.
#[derive(Debug, Clone, Copy)]
pub(super) struct Neon;

const ASCENDING: [u8; LABELS] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

macro_rules! intrinsic {
    ($name:ident, $intrinsic:ident) => {
        #[inline(always)]
        fn $name(self, a: uint8x16_t, b: uint8x16_t) -> uint8x16_t {
            // SAFETY: NEON is part of the target.
            unsafe { $intrinsic(a, b) }
        }
    };
}

impl Lanes for Neon {
    type V = uint8x16_t;
    const PIXELS: usize = 1;

    #[inline(always)]
    fn load(self, from: &[u8]) -> uint8x16_t {
        let from = &from[..LABELS];
        // SAFETY: NEON is part of the target; the slice has as many bytes as are read.
        unsafe { vld1q_u8(from.as_ptr()) }
    }

    #[inline(always)]
    fn store(self, v: uint8x16_t, to: &mut [u8]) {
        let to = &mut to[..LABELS];
        // SAFETY: NEON is part of the target; the slice has as many bytes as are written.
        unsafe { vst1q_u8(to.as_mut_ptr(), v) }
    }

    #[inline(always)]
    fn load_each(self, from: &[u8], at: impl Fn(usize) -> usize) -> uint8x16_t {
        self.load(&from[at(0)..])
    }

    #[inline(always)]
    fn load_pixels(self, from: [&[[u8; LABELS]]; MOST_PIXELS], at: usize) -> uint8x16_t {
        self.load(&from[0][at])
    }

    #[inline(always)]
    fn store_pixels(self, v: uint8x16_t, to: &mut [&mut [[u8; LABELS]]; MOST_PIXELS], at: usize) {
        self.store(v, &mut to[0][at]);
    }

    #[inline(always)]
    fn splat(self, byte: u8) -> uint8x16_t {
        // SAFETY: NEON is part of the target.
        unsafe { vdupq_n_u8(byte) }
    }

    #[inline(always)]
    fn spread(self, from: &[u8]) -> uint8x16_t {
        self.splat(from[0])
    }

    intrinsic!(add, vaddq_u8);
    intrinsic!(sub, vsubq_u8);
    intrinsic!(add_saturating, vqaddq_u8);
    intrinsic!(sub_saturating, vqsubq_u8);
    intrinsic!(max, vmaxq_u8);
    intrinsic!(min, vminq_u8);
    intrinsic!(average, vrhaddq_u8);
    intrinsic!(equal, vceqq_u8);
    intrinsic!(and, vandq_u8);
    intrinsic!(xor, veorq_u8);

    #[inline(always)]
    fn select(self, mask: uint8x16_t, then: uint8x16_t, otherwise: uint8x16_t) -> uint8x16_t {
        // SAFETY: NEON is part of the target.
        unsafe { vbslq_u8(mask, then, otherwise) }
    }

    #[inline(always)]
    fn reverse(self, v: uint8x16_t) -> uint8x16_t {
        // SAFETY: NEON is part of the target.
        unsafe {
            let halves = vrev64q_u8(v);
            vextq_u8::<8>(halves, halves)
        }
    }

    #[inline(always)]
    fn halve(self, v: uint8x16_t) -> uint8x16_t {
        // SAFETY: NEON is part of the target.
        unsafe { vshrq_n_u8::<1>(v) }
    }

    #[inline(always)]
    fn count_ones(self, v: uint8x16_t) -> uint8x16_t {
        // SAFETY: NEON is part of the target.
        unsafe { vcntq_u8(v) }
    }

    #[inline(always)]
    fn interleave(self, a: uint8x16_t, b: uint8x16_t) -> (uint8x16_t, uint8x16_t) {
        // SAFETY: NEON is part of the target.
        unsafe { (vzip1q_u8(a, b), vzip2q_u8(a, b)) }
    }

    #[inline(always)]
    fn shift(self, v: uint8x16_t, by: uint8x16_t) -> uint8x16_t {
        let from = self.add(self.load(&ASCENDING), by);
        // SAFETY: NEON is part of the target. Indices above 15 give 0.
        unsafe { vqtbl1q_u8(v, from) }
    }

    #[inline(always)]
    fn label_below(self, v: uint8x16_t) -> uint8x16_t {
        // SAFETY: NEON is part of the target.
        unsafe { vextq_u8::<15>(vdupq_n_u8(0), v) }
    }

    #[inline(always)]
    fn label_above(self, v: uint8x16_t) -> uint8x16_t {
        // SAFETY: NEON is part of the target.
        unsafe { vextq_u8::<1>(v, vdupq_n_u8(0)) }
    }

    #[inline(always)]
    fn lookup(self, table: &[u8], which: uint8x16_t) -> uint8x16_t {
        let table = uint8x16x2_t(self.load(table), self.load(&table[LABELS..]));
        // SAFETY: NEON is part of the target.
        unsafe { vqtbl2q_u8(table, which) }
    }

    #[inline(always)]
    fn total(self, v: uint8x16_t) -> u32 {
        // SAFETY: NEON is part of the target.
        unsafe { u32::from(vaddlvq_u8(v)) }
    }

    #[inline(always)]
    fn largest(self, v: uint8x16_t) -> uint8x16_t {
        // SAFETY: NEON is part of the target.
        unsafe { vdupq_n_u8(vmaxvq_u8(v)) }
    }
}
