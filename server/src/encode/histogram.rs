//! How often every disparity occurs in a map.

use stereo::DisparityMap;

/// Counts of the valid fixed-point disparities; 256 KB, filled in one pass.
pub(super) struct Histogram {
    counts: Vec<u32>,
    valid: usize,
}

impl Histogram {
    pub(super) fn new(map: &DisparityMap) -> Self {
        let mut counts = vec![0_u32; usize::from(u16::MAX) + 1];
        for &fixed in map.fixed() {
            counts[usize::from(fixed)] += 1;
        }
        let invalid = std::mem::take(&mut counts[0]) as usize;
        Self {
            counts,
            valid: map.fixed().len() - invalid,
        }
    }

    /// Pixels with a disparity.
    pub(super) fn valid(&self) -> usize {
        self.valid
    }

    /// The fixed-point disparity that `rank` valid ones come before in order of size; `None` if there are not that
    /// many.
    pub(super) fn ranked(&self, rank: usize) -> Option<u16> {
        let mut up_to = 0;
        (0..=u16::MAX).zip(&self.counts).find_map(|(fixed, &count)| {
            up_to += count as usize;
            (up_to > rank).then_some(fixed)
        })
    }
}

#[cfg(test)]
mod tests {
    use stereo::{DisparityMap, Shape};

    use super::Histogram;

    #[test]
    fn ranks_are_those_of_the_sorted_valid_disparities() {
        let mut map = DisparityMap::new(Shape::new(32, 32).unwrap());
        map.parts_mut().0[..6].copy_from_slice(&[9, 0, 65_535, 1, 9, 40]);
        let histogram = Histogram::new(&map);
        assert_eq!(histogram.valid(), 5);
        let ranked: Vec<_> = (0..6).map(|rank| histogram.ranked(rank)).collect();
        assert_eq!(ranked, [Some(1), Some(9), Some(9), Some(40), Some(65_535), None]);
        assert_eq!(
            Histogram::new(&DisparityMap::new(Shape::new(32, 32).unwrap())).ranked(0),
            None
        );
    }
}
