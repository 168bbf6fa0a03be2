//! Filling: a pixel without a disparity gets one from its neighbours in the four directions.
//!
//! What the right view does not see belongs to the background, so the largest of the four is never right; the smallest
//! may be an outlier. The second smallest is neither.

/// Fills the pixels of `disparity` (rows of `width`) where `valid` is 0; without any valid pixel they become 0.
pub(crate) fn fill(width: usize, disparity: &mut [u16], valid: &[u8]) {
    const NONE: u16 = u16::MAX;
    // Upwards: a pixel to fill remembers the next valid one below, in its own place.
    let mut carried = vec![NONE; width];
    for (row, valid) in disparity
        .chunks_exact_mut(width)
        .zip(valid.chunks_exact(width))
        .rev()
    {
        for ((value, valid), carried) in row.iter_mut().zip(valid).zip(&mut carried) {
            let here = if *valid != 0 { *value } else { *carried };
            (*value, *carried) = (here, here);
        }
    }
    // Downwards, with the last valid one above, and the ends of the gap in the row.
    carried.fill(NONE);
    for (row, valid) in disparity.chunks_exact_mut(width).zip(valid.chunks_exact(width)) {
        let mut x = 0;
        let mut left = NONE;
        while x < width {
            if valid[x] != 0 {
                (left, carried[x]) = (row[x], row[x]);
                x += 1;
                continue;
            }
            let end = (x..width).find(|&at| valid[at] != 0).unwrap_or(width);
            let right = if end < width { row[end] } else { NONE };
            for (value, above) in row[x..end].iter_mut().zip(&carried[x..end]) {
                let mut around = [left, right, *above, *value];
                around.sort_unstable();
                let chosen = if around[1] == NONE { around[0] } else { around[1] };
                *value = if chosen == NONE { 0 } else { chosen };
            }
            x = end;
        }
    }
}
