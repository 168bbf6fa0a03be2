//! Speckles: small islands of disparities that fit nothing around them are usually wrong.

use crate::marks;
use crate::simd::{Kernel, Lanes, Level};

/// Largest step in 1/64 px between neighbours of one island.
const STEP: u16 = 64;

/// Scratch: the image's runs and the islands they belong to.
#[derive(Debug, Default)]
pub(crate) struct Speckle {
    runs: Vec<Run>,
    /// Where runs of a row begin or end.
    ends: Vec<u8>,
}

/// Consecutive valid pixels of a row without a step.
#[derive(Debug, Clone, Copy)]
struct Run {
    /// First pixel in the map, and the one after the last.
    from: u32,
    to: u32,
    /// A run of the same island, itself if it stands for it.
    parent: u32,
    /// Pixels of the island, where this run stands for it.
    size: u32,
}

impl Speckle {
    /// Clears `valid` (ones and zeros) on islands of up to `max_size` pixels in a map of rows of `width`.
    pub(crate) fn remove(
        &mut self,
        level: Level,
        width: usize,
        disparity: &[u16],
        valid: &mut [u8],
        max_size: u32,
    ) {
        self.runs.clear();
        marks::clear(&mut self.ends, width);
        let mut above = 0..0;
        let rows = disparity.chunks_exact(width).zip(valid.chunks_exact(width));
        for (y, (disparities, valid)) in rows.enumerate() {
            let first = self.runs.len();
            level.run(MarkEnds {
                disparity: disparities,
                valid,
                ends: &mut self.ends,
            });
            self.find_runs(y * width, valid);
            self.join(above, first, width, disparity);
            above = first..self.runs.len();
        }
        for index in 0..self.runs.len() {
            let island = self.find(index);
            if self.runs[island].size <= max_size {
                let Run { from, to, .. } = self.runs[index];
                valid[from as usize..to as usize].fill(0);
            }
        }
    }

    /// The runs between `ends` of a row whose first pixel is `at`.
    fn find_runs(&mut self, at: usize, valid: &[u8]) {
        let mut start = None;
        for x in marks::positions(&self.ends) {
            if let Some(start) = start {
                // An image has fewer than 2^32 pixels and so fewer runs.
                let [from, to, parent, size] = [at + start, at + x, self.runs.len(), x - start]
                    .map(|n| u32::try_from(n).unwrap_or(u32::MAX));
                self.runs.push(Run {
                    from,
                    to,
                    parent,
                    size,
                });
            }
            start = valid.get(x).is_some_and(|valid| *valid != 0).then_some(x);
        }
    }

    /// Joins the runs from `first` on with those of the row above that they touch without a step.
    fn join(&mut self, mut above: std::ops::Range<usize>, first: usize, width: usize, disparity: &[u16]) {
        for index in first..self.runs.len() {
            // The same columns one row up; in the first row there is nothing above, and nothing to subtract from.
            let [from, to] =
                [self.runs[index].from, self.runs[index].to].map(|at| (at as usize).saturating_sub(width));
            while above.start < above.end && self.runs[above.start].to as usize <= from {
                above.start += 1;
            }
            for other in above.clone() {
                let start = (self.runs[other].from as usize).max(from);
                let end = (self.runs[other].to as usize).min(to);
                if start >= to {
                    break;
                }
                let (upper, lower) = (&disparity[start..end], &disparity[start + width..end + width]);
                if upper.iter().zip(lower).any(|(a, b)| a.abs_diff(*b) <= STEP) {
                    self.unite(index, other);
                }
            }
        }
    }

    fn find(&mut self, mut index: usize) -> usize {
        while self.runs[index].parent as usize != index {
            let parent = self.runs[index].parent as usize;
            self.runs[index].parent = self.runs[parent].parent;
            index = parent;
        }
        index
    }

    fn unite(&mut self, a: usize, b: usize) {
        let (a, b) = (self.find(a), self.find(b));
        if a != b {
            let (large, small) = if self.runs[a].size >= self.runs[b].size {
                (a, b)
            } else {
                (b, a)
            };
            self.runs[small].parent = u32::try_from(large).unwrap_or(u32::MAX);
            self.runs[large].size += self.runs[small].size;
        }
    }
}

/// Marks the pixels where a run ends just before or begins, the one behind the row among them.
struct MarkEnds<'a> {
    disparity: &'a [u16],
    valid: &'a [u8],
    ends: &'a mut [u8],
}

impl Kernel for MarkEnds<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let last = self.valid.len() - 1;
        let (before, here) = (&self.disparity[..last], &self.disparity[1..=last]);
        let (valid_before, valid_here) = (&self.valid[..last], &self.valid[1..=last]);
        (self.ends[0], self.ends[last + 1]) = (self.valid[0], self.valid[last]);
        let ends = &mut self.ends[1..=last];
        for x in 0..last {
            let steps = u8::from(before[x].abs_diff(here[x]) > STEP);
            ends[x] = (valid_before[x] ^ valid_here[x]) | (steps & valid_here[x]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Speckle;
    use crate::simd::Level;

    fn kept(width: usize, disparity: &[u16], valid: &[u8], max_size: u32) -> Vec<u8> {
        let mut valid = valid.to_vec();
        Speckle::default().remove(Level::detect(), width, disparity, &mut valid, max_size);
        valid
    }

    #[test]
    fn islands_are_joined_over_rows_and_small_ones_are_removed() {
        // A U of five pixels, and a pixel that touches it at another depth.
        let disparity = [100, 900, 100, 100, 100, 100];
        let valid = [1, 1, 1, 1, 1, 1];
        assert_eq!(kept(3, &disparity, &valid, 1), [1, 0, 1, 1, 1, 1]);
        assert_eq!(kept(3, &disparity, &valid, 4), [1, 0, 1, 1, 1, 1]);
        assert_eq!(kept(3, &disparity, &valid, 5), [0; 6]);
    }

    #[test]
    fn invalid_pixels_and_steps_separate_islands() {
        let disparity = [64, 128, 192, 257, 257, 257, 257, 257, 257, 257];
        let valid = [1, 1, 1, 1, 1, 1, 0, 1, 1, 0];
        assert_eq!(kept(10, &disparity, &valid, 2), [1, 1, 1, 1, 1, 1, 0, 0, 0, 0]);
        assert_eq!(kept(10, &disparity, &valid, 3), [0; 10]);
    }
}
