//! Speckles: small islands of disparities that fit nothing around them are usually wrong.

/// Largest step in 1/64 px between neighbours of one island.
const STEP: u16 = 64;

/// Scratch: the image's runs and the islands they belong to.
#[derive(Debug, Default)]
pub(crate) struct Speckle {
    runs: Vec<Run>,
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
    /// Clears `valid` on islands of up to `max_size` pixels in a map of rows of `width`.
    pub(crate) fn remove(&mut self, width: usize, disparity: &[u16], valid: &mut [u8], max_size: u32) {
        self.runs.clear();
        let mut above = 0..0;
        let rows = disparity.chunks_exact(width).zip(valid.chunks_exact(width));
        for (y, (row, row_valid)) in rows.enumerate() {
            let first = self.runs.len();
            self.find_runs(y * width, row, row_valid);
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

    fn find_runs(&mut self, at: usize, row: &[u16], valid: &[u8]) {
        let mut x = 0;
        while x < row.len() {
            if valid[x] == 0 {
                x += 1;
                continue;
            }
            let start = x;
            x += 1;
            while x < row.len() && valid[x] != 0 && row[x].abs_diff(row[x - 1]) <= STEP {
                x += 1;
            }
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
                if (start..end).any(|at| disparity[at].abs_diff(disparity[at + width]) <= STEP) {
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
