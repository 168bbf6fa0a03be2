//! Propagation: a pixel that failed tries the disparity of the nearest pixel that did not, from one side after another
//! (the spatial step of PatchMatch Stereo, Bleyer, Rhemann and Rother 2011).
//!
//! It makes a map of candidates; the ordinary cost evaluation decides. Thin things and object borders, which no triangle
//! fits, get their disparity from the part of them that was found.

/// Where a candidate comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum From {
    Left,
    Right,
    Above,
    Below,
}

/// How far a disparity travels, px.
const REACH_PX: u8 = 8;
/// Pixels cheaper than this (of 250) lend their disparity; dearer ones borrow.
const GOOD_BELOW: u8 = 63;

/// Writes to `candidates` the disparity each pixel tries: its own where it is good or nobody near is, else the one of the
/// nearest good pixel on side `from`.
pub(crate) fn candidates(from: From, width: usize, disparity: &[u16], cost: &[u8], candidates: &mut [u16]) {
    match from {
        From::Left | From::Right => {
            let rows = disparity.chunks_exact(width).zip(cost.chunks_exact(width));
            for ((disparity, cost), candidates) in rows.zip(candidates.chunks_exact_mut(width)) {
                let mut lender = Lender::default();
                let mut visit = |x: usize| candidates[x] = lender.visit(disparity[x], cost[x]);
                if from == From::Left {
                    (0..width).for_each(&mut visit)
                } else {
                    (0..width).rev().for_each(&mut visit)
                }
            }
        }
        From::Above | From::Below => {
            let mut lenders = vec![Lender::default(); width];
            let mut visit = |y: usize| {
                for (x, lender) in lenders.iter_mut().enumerate() {
                    let at = y * width + x;
                    candidates[at] = lender.visit(disparity[at], cost[at]);
                }
            };
            let height = disparity.len() / width;
            if from == From::Above {
                (0..height).for_each(&mut visit)
            } else {
                (0..height).rev().for_each(&mut visit)
            }
        }
    }
}

/// The last good pixel on the way.
#[derive(Debug, Clone, Copy, Default)]
struct Lender {
    disparity: u16,
    /// Steps it can still go.
    left: u8,
}

impl Lender {
    fn visit(&mut self, disparity: u16, cost: u8) -> u16 {
        if cost < GOOD_BELOW {
            *self = Self {
                disparity,
                left: REACH_PX,
            };
        } else if self.left > 0 {
            self.left -= 1;
        } else {
            self.disparity = disparity;
        }
        self.disparity
    }
}

#[cfg(test)]
mod tests;
