//! Propagation: a pixel that failed tries the disparity of the nearest pixel of its row that did not (the spatial step of PatchMatch Stereo, Bleyer, Rhemann and Rother 2011).
//!
//! It makes a map of candidates; the ordinary cost evaluation decides. Thin things and object borders, which no triangle
//! fits, get their disparity from the part of them that was found.

use crate::changes::Changes;
use crate::simd::{Kernel, Lanes, Level, mask};

/// How far a disparity travels, px.
const REACH_PX: usize = 8;
/// Pixels cheaper than this (of 250) lend their disparity; dearer ones borrow.
const GOOD_BELOW: u8 = 63;
/// Of a pixel that neither has a good disparity nor has been lent one.
const NONE: u16 = u16::MAX;

/// Pixels of one block: plain loops over arrays of this length become vector code.
const BLOCK: usize = 64;

/// Two rows with room for the reach on both sides.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    rows: [Vec<u16>; 2],
}

/// The result so far.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Found<'a> {
    pub(crate) width: usize,
    pub(crate) disparity: &'a [u16],
    pub(crate) cost: &'a [u8],
    /// No more than this is lent.
    pub(crate) max_fixed: u16,
}

/// Share of the pixels with these costs that are not good.
pub(crate) fn failed_share(level: Level, cost: &[u8]) -> f32 {
    level.run(Failed { cost }) as f32 / cost.len() as f32
}

struct Failed<'a> {
    cost: &'a [u8],
}

impl Kernel for Failed<'_> {
    type Output = u32;

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> u32 {
        let mut failed = 0;
        // As many blocks as a byte can count.
        for part in self.cost.chunks(BLOCK * usize::from(u8::MAX)) {
            let mut counts = [0u8; BLOCK];
            let (blocks, rest) = part.as_chunks::<BLOCK>();
            for block in blocks {
                for (count, cost) in counts.iter_mut().zip(block) {
                    *count += u8::from(*cost >= GOOD_BELOW);
                }
            }
            for &cost in rest {
                failed += u32::from(cost >= GOOD_BELOW);
            }
            for count in counts {
                failed += u32::from(count);
            }
        }
        failed
    }
}

/// Writes to `candidates` the disparity each pixel tries: its own where it is good or nobody near is, else the one of the
/// nearest good pixel of its row. Near are those 1 px away, then 2 and 3, 4 to 7, and 8; those on the left come first. Marks the pixels that borrow in `changes`.
pub(crate) fn candidates(
    level: Level,
    found: Found<'_>,
    candidates: &mut [u16],
    changes: &mut Changes,
    scratch: &mut Scratch,
) {
    level.run(Candidates {
        found,
        candidates,
        changes,
        scratch,
    });
}

struct Candidates<'a> {
    found: Found<'a>,
    candidates: &'a mut [u16],
    changes: &'a mut Changes,
    scratch: &'a mut Scratch,
}

impl Kernel for Candidates<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self {
            found,
            candidates,
            changes,
            scratch,
        } = self;
        let width = found.width;
        for row in &mut scratch.rows {
            row.clear();
            row.resize(width.next_multiple_of(BLOCK) + 2 * REACH_PX, NONE);
        }
        let [one, other] = &mut scratch.rows;
        let (mut lent, mut next) = (&mut one[..], &mut other[..]);
        let rows = found
            .disparity
            .chunks_exact(width)
            .zip(found.cost.chunks_exact(width));
        for (y, ((disparity, cost), candidates)) in rows.zip(candidates.chunks_exact_mut(width)).enumerate() {
            // What lies beyond the row may have been lent to.
            lent[REACH_PX + width..].fill(NONE);
            let inner = lent[REACH_PX..REACH_PX + width].iter_mut();
            for (lent, (disparity, cost)) in inner.zip(disparity.iter().zip(cost)) {
                *lent = (*disparity).min(found.max_fixed) | mask(*cost >= GOOD_BELOW);
            }
            // Each step takes what lies `step` away: after these, from up to 1, 3, 7 and 8 away.
            for step in [1, 2, 4, 1] {
                let n = lent.len() - 2 * REACH_PX;
                let here = lent[REACH_PX..][..n].as_chunks::<BLOCK>().0;
                let left = lent[REACH_PX - step..][..n].as_chunks::<BLOCK>().0;
                let right = lent[REACH_PX + step..][..n].as_chunks::<BLOCK>().0;
                let blocks = next[REACH_PX..][..n].as_chunks_mut::<BLOCK>().0;
                for (block, next) in blocks.iter_mut().enumerate() {
                    let (here, left, right) = (&here[block], &left[block], &right[block]);
                    for k in 0..BLOCK {
                        next[k] = or_else(here[k], or_else(left[k], right[k]));
                    }
                }
                std::mem::swap(&mut lent, &mut next);
            }
            let inner = &lent[REACH_PX..REACH_PX + width];
            for (block, candidates) in candidates.chunks_mut(BLOCK).enumerate() {
                let x = block * BLOCK;
                let n = candidates.len();
                let (own, cost, lent) = (&disparity[x..x + n], &cost[x..x + n], &inner[x..x + n]);
                let mut borrows = 0;
                for k in 0..n {
                    borrows |= !none(lent[k]) & mask(cost[k] >= GOOD_BELOW);
                    candidates[k] = or_else(lent[k], own[k].min(found.max_fixed));
                }
                if borrows > 0 {
                    changes.mark(y, x, x);
                }
            }
        }
    }
}

#[inline(always)]
fn none(disparity: u16) -> u16 {
    mask(disparity == NONE)
}

/// `disparity`, or `otherwise` if it is [`NONE`], which is all ones.
#[inline(always)]
fn or_else(disparity: u16, otherwise: u16) -> u16 {
    disparity & (otherwise | !none(disparity))
}

#[cfg(test)]
mod tests;
