//! One pixel at a time, reading like the definitions.

use super::lanes::{LABELS, Lanes, MOST_PIXELS, TABLE};

#[derive(Debug, Clone, Copy)]
pub(super) struct Scalar;

type Labels = [u8; LABELS];

#[inline(always)]
fn both(a: Labels, b: Labels, f: impl Fn(u8, u8) -> u8) -> Labels {
    std::array::from_fn(|k| f(a[k], b[k]))
}

impl Lanes for Scalar {
    type V = Labels;
    const PIXELS: usize = 1;

    #[inline(always)]
    fn load(self, from: &[u8]) -> Labels {
        let mut v = [0; LABELS];
        v.copy_from_slice(&from[..LABELS]);
        v
    }

    #[inline(always)]
    fn store(self, v: Labels, to: &mut [u8]) {
        to[..LABELS].copy_from_slice(&v);
    }

    #[inline(always)]
    fn load_each(self, from: &[u8], at: impl Fn(usize) -> usize) -> Labels {
        self.load(&from[at(0)..])
    }

    #[inline(always)]
    fn load_pixels(self, from: [&[[u8; LABELS]]; MOST_PIXELS], at: usize) -> Labels {
        from[0][at]
    }

    #[inline(always)]
    fn store_pixels(self, v: Labels, to: &mut [&mut [[u8; LABELS]]; MOST_PIXELS], at: usize) {
        to[0][at] = v;
    }

    #[inline(always)]
    fn splat(self, byte: u8) -> Labels {
        [byte; LABELS]
    }

    #[inline(always)]
    fn spread(self, from: &[u8]) -> Labels {
        [from[0]; LABELS]
    }

    #[inline(always)]
    fn add(self, a: Labels, b: Labels) -> Labels {
        both(a, b, u8::wrapping_add)
    }

    #[inline(always)]
    fn sub(self, a: Labels, b: Labels) -> Labels {
        both(a, b, u8::wrapping_sub)
    }

    #[inline(always)]
    fn add_saturating(self, a: Labels, b: Labels) -> Labels {
        both(a, b, u8::saturating_add)
    }

    #[inline(always)]
    fn sub_saturating(self, a: Labels, b: Labels) -> Labels {
        both(a, b, u8::saturating_sub)
    }

    #[inline(always)]
    fn max(self, a: Labels, b: Labels) -> Labels {
        both(a, b, u8::max)
    }

    #[inline(always)]
    fn min(self, a: Labels, b: Labels) -> Labels {
        both(a, b, u8::min)
    }

    #[inline(always)]
    fn select(self, mask: Labels, then: Labels, otherwise: Labels) -> Labels {
        std::array::from_fn(|k| (then[k] & mask[k]) | (otherwise[k] & !mask[k]))
    }

    #[inline(always)]
    fn reverse(self, mut v: Labels) -> Labels {
        v.reverse();
        v
    }

    #[inline(always)]
    fn halve(self, v: Labels) -> Labels {
        v.map(|x| x >> 1)
    }

    #[inline(always)]
    fn average(self, a: Labels, b: Labels) -> Labels {
        both(a, b, |a, b| (a | b) - ((a ^ b) >> 1))
    }

    #[inline(always)]
    fn xor(self, a: Labels, b: Labels) -> Labels {
        both(a, b, |a, b| a ^ b)
    }

    #[inline(always)]
    fn count_ones(self, v: Labels) -> Labels {
        // Written out, because the baseline instruction sets have no byte count and this form vectorises.
        v.map(|x| {
            let x = x - ((x >> 1) & 0x55);
            let x = (x & 0x33) + ((x >> 2) & 0x33);
            (x + (x >> 4)) & 0x0F
        })
    }

    #[inline(always)]
    fn interleave(self, a: Labels, b: Labels) -> (Labels, Labels) {
        let from = |first: usize| std::array::from_fn(|k| [a, b][k % 2][first + k / 2]);
        (from(0), from(LABELS / 2))
    }

    #[inline(always)]
    fn shift(self, v: Labels, by: Labels) -> Labels {
        // All labels of a pixel move alike.
        let by = usize::from(by[0]);
        let mut twice = [0; 3 * LABELS];
        twice[LABELS..2 * LABELS].copy_from_slice(&v);
        let from = if by < LABELS {
            LABELS + by
        } else if by > 256 - LABELS {
            LABELS + by - 256
        } else {
            0
        };
        self.load(&twice[from..])
    }

    #[inline(always)]
    fn label_below(self, v: Labels) -> Labels {
        std::array::from_fn(|k| if k > 0 { v[k - 1] } else { 0 })
    }

    #[inline(always)]
    fn label_above(self, v: Labels) -> Labels {
        std::array::from_fn(|k| if k + 1 < LABELS { v[k + 1] } else { 0 })
    }

    #[inline(always)]
    fn equal(self, a: Labels, b: Labels) -> Labels {
        both(a, b, |a, b| u8::from(a == b).wrapping_neg())
    }

    #[inline(always)]
    fn and(self, a: Labels, b: Labels) -> Labels {
        both(a, b, |a, b| a & b)
    }

    #[inline(always)]
    fn lookup(self, table: &[u8], which: Labels) -> Labels {
        let table = &table[..Self::TABLE];
        which.map(|at| table[usize::from(at)])
    }

    #[inline(always)]
    fn lookup_or_zero(self, table: &[u8; TABLE], which: Labels) -> Labels {
        which.map(|which| table.get(usize::from(which)).copied().unwrap_or(0))
    }

    #[inline(always)]
    fn total(self, v: Labels) -> u32 {
        v.into_iter().map(u32::from).sum()
    }

    #[inline(always)]
    fn largest(self, v: Labels) -> Labels {
        [v.iter().copied().fold(0, u8::max); LABELS]
    }
}
