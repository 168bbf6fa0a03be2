//! One block of a row: what is published of its pixels, and what is counted there.

use crate::changes::BLOCK_PX;
use crate::confidence::CostScale;
use crate::disparity::FIXED_PER_PX;
use crate::params::{Density, Params};
use crate::simd::{Lanes, TABLE};

/// Pixels of one block, as changes are marked: plain loops over arrays of this length become vector code.
pub(super) const BLOCK: usize = BLOCK_PX;

/// A disparity that moves by this much (1/64 px), or comes or goes, has changed.
const CHANGED_FROM: u16 = FIXED_PER_PX / 4;

/// What is counted in a block.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Block {
    /// Pixels asked for, and those of them that have a disparity.
    pub(super) asked: u8,
    pub(super) answered: u8,
    /// Pixels of the mask, and the sum of their confidences.
    pub(super) textured: u8,
    pub(super) confidence: u16,
}

/// A row's maps and output.
pub(super) struct Row<'a> {
    pub(super) mask: &'a [u8],
    pub(super) interpolated: &'a [u16],
    pub(super) disparity: &'a [u16],
    /// Confidences, or costs if the rule has a scale for them.
    pub(super) rated: &'a [u8],
    pub(super) fixed: &'a mut [u16],
    pub(super) confidence: &'a mut [u8],
    /// Pixels that are not what they were, by their places in a block.
    pub(super) changed: &'a mut [u16; BLOCK],
}

/// What is published of a pixel.
pub(super) struct Rule {
    /// Confidences of costs.
    scale: Option<[u8; TABLE]>,
    /// All ones if pixels outside the mask and without validation are wanted too.
    everything: u8,
    least_confidence: u8,
    offset: u16,
}

/// From a place on, all bytes are ones, in front of it none.
const COUNTED: [u8; 2 * BLOCK] = {
    let mut counted = [0; 2 * BLOCK];
    let mut k = BLOCK;
    while k < 2 * BLOCK {
        counted[k] = u8::MAX;
        k += 1;
    }
    counted
};

impl Rule {
    pub(super) fn new(params: &Params, scale: Option<CostScale>) -> Self {
        let is_dense = params.density == Density::Dense;
        #[expect(clippy::cast_possible_truncation, reason = "between 0 and 255")]
        #[expect(clippy::cast_sign_loss, reason = "between 0 and 255")]
        let least_confidence = (255.0 * params.min_confidence).ceil() as u8;
        Self {
            scale: scale.map(CostScale::table),
            everything: u8::from(is_dense).wrapping_neg(),
            // Without validation there is none.
            least_confidence: least_confidence.max(u8::from(!is_dense)),
            offset: params.range.min_px * FIXED_PER_PX,
        }
    }

    /// Writes block `number` of a row.
    #[inline(always)]
    pub(super) fn write<L: Lanes>(&self, lanes: L, row: &mut Row<'_>, number: usize) -> Block {
        let (n, from) = (row.mask.len(), number * BLOCK);
        if n < BLOCK {
            return self.write_short(lanes, row);
        }
        // The last block overlaps the one before where the row is no multiple: single pixels are many times slower.
        let start = from.min(n - BLOCK);
        let span = start..start + BLOCK;
        let mut part = Row {
            mask: &row.mask[span.clone()],
            interpolated: &row.interpolated[span.clone()],
            disparity: &row.disparity[span.clone()],
            rated: &row.rated[span.clone()],
            fixed: &mut row.fixed[span.clone()],
            confidence: &mut row.confidence[span],
            changed: row.changed,
        };
        self.write_whole(lanes, &mut part, from - start)
    }

    /// A row shorter than a block becomes the end of one.
    #[inline(always)]
    fn write_short<L: Lanes>(&self, lanes: L, row: &mut Row<'_>) -> Block {
        let skipped = BLOCK - row.mask.len();
        let (mut mask, mut interpolated, mut disparity, mut rated) =
            ([0; BLOCK], [0; BLOCK], [0; BLOCK], [0; BLOCK]);
        let (mut fixed, mut confidence) = ([0; BLOCK], [0; BLOCK]);
        mask[skipped..].copy_from_slice(row.mask);
        interpolated[skipped..].copy_from_slice(row.interpolated);
        disparity[skipped..].copy_from_slice(row.disparity);
        rated[skipped..].copy_from_slice(row.rated);
        fixed[skipped..].copy_from_slice(row.fixed);
        let mut whole = Row {
            mask: &mask,
            interpolated: &interpolated,
            disparity: &disparity,
            rated: &rated,
            fixed: &mut fixed,
            confidence: &mut confidence,
            changed: row.changed,
        };
        let counted = self.write_whole(lanes, &mut whole, skipped);
        row.fixed.copy_from_slice(&fixed[skipped..]);
        row.confidence.copy_from_slice(&confidence[skipped..]);
        counted
    }

    /// A row of a block's length, whose first `skipped` pixels are not counted.
    #[inline(always)]
    fn write_whole<L: Lanes>(&self, lanes: L, row: &mut Row<'_>, skipped: usize) -> Block {
        let (one, everything) = (lanes.splat(1), lanes.splat(self.everything));
        let (mut valid, mut kept) = ([0; BLOCK], [0; BLOCK]);
        let [mut asked, mut answered, mut textured, mut confidence] = [0; 4];
        let counted = &COUNTED[BLOCK - skipped..][..BLOCK];
        for x in (0..BLOCK).step_by(L::BYTES) {
            let rated = lanes.load(&row.rated[x..]);
            let sure = match &self.scale {
                Some(table) => lanes.lookup_or_zero(table, rated),
                None => rated,
            };
            let is_textured = lanes.equal(lanes.load(&row.mask[x..]), one);
            let is_sure = lanes.equal(lanes.max(sure, lanes.splat(self.least_confidence)), sure);
            let is_wanted = lanes.max(is_textured, everything);
            let is_kept = lanes.and(is_wanted, is_sure);
            lanes.store(lanes.and(sure, is_kept), &mut row.confidence[x..]);
            lanes.store(is_kept, &mut kept[x..]);
            lanes.store(sure, &mut valid[x..]);
            let counted_here = lanes.load(&counted[x..]);
            let ones = lanes.and(one, counted_here);
            let textured_here = lanes.and(is_textured, counted_here);
            asked += lanes.total(lanes.and(is_wanted, ones));
            answered += lanes.total(lanes.and(is_kept, ones));
            textured += lanes.total(lanes.and(textured_here, one));
            confidence += lanes.total(lanes.and(textured_here, sure));
        }
        // Bytes and words by themselves: mixed, vectors would be taken apart and put together again and again.
        let (Some(disparity), Some(interpolated), Some(fixed)) = (
            row.disparity.first_chunk::<BLOCK>(),
            row.interpolated.first_chunk::<BLOCK>(),
            row.fixed.first_chunk_mut::<BLOCK>(),
        ) else {
            return Block::default();
        };
        if self.everything == 0 {
            for x in 0..BLOCK {
                let value = (disparity[x] + self.offset).max(1) & widened(kept[x]);
                row.changed[x] += has_moved(fixed[x], value) & widened(counted[x]);
                fixed[x] = value;
            }
        } else {
            for x in 0..BLOCK {
                let is_valid = u16::from(valid[x] > 0).wrapping_neg();
                let value = (disparity[x] & is_valid) | (interpolated[x] & !is_valid);
                let value = (value + self.offset).max(1) & widened(kept[x]);
                row.changed[x] += has_moved(fixed[x], value) & widened(counted[x]);
                fixed[x] = value;
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "64 pixels, and 254 for each")]
        {
            Block {
                asked: asked as u8,
                answered: answered as u8,
                textured: textured as u8,
                confidence: confidence as u16,
            }
        }
    }
}

/// All ones or none.
#[inline(always)]
fn widened(mask: u8) -> u16 {
    i16::from(mask.cast_signed()).cast_unsigned()
}

/// 1 if it has, else 0.
#[inline(always)]
fn has_moved(before: u16, now: u16) -> u16 {
    let has_moved = before.abs_diff(now) >= CHANGED_FROM;
    u16::from(has_moved | ((before > 0) != (now > 0)))
}
