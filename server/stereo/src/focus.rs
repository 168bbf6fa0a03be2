//! Foveation: regions of the image that matter more.
//!
//! After the first rung, each region climbs the whole ladder by itself before anything is done for the rest: heavier ones
//! before lighter ones, those of equal weight together, as one rung. Then the ladder goes on for the whole image, in which
//! the regions keep what they have until its last rung, which is the same as without regions.

use crate::error::ParamsError;
use crate::image::{Roi, Shape};
use crate::ladder::MOST_RUNGS;

/// A region that matters more than the rest of the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Focus {
    /// Inside the image, and inside the region of interest if there is one.
    pub region: Roi,
    /// Heavier regions come first; above 0, at most [`Self::MAX_WEIGHT`].
    pub weight: f32,
}

impl Focus {
    /// The most regions of a frame.
    pub const MOST: usize = 16;
    /// The largest weight.
    pub const MAX_WEIGHT: f32 = 1000.0;

    /// Checks the regions of a frame of `shape` that is matched within `roi`.
    pub(crate) fn validate(all: &[Self], shape: Shape, roi: Option<Roi>) -> Result<(), ParamsError> {
        if all.len() > Self::MOST {
            return Err(ParamsError::TooManyRegions {
                most: Self::MOST,
                got: all.len(),
            });
        }
        let within = roi.unwrap_or(Roi::full(shape));
        for focus in all {
            if !(focus.weight > 0.0 && focus.weight <= Self::MAX_WEIGHT) {
                return Err(ParamsError::OutOfRange {
                    name: "focus.weight",
                    expected: "above 0 and at most 1000",
                    got: focus.weight.into(),
                });
            }
            if !focus.region.lies_in(shape) || !focus.region.lies_in_region(within) {
                return Err(ParamsError::FocusOutside {
                    region: focus.region,
                    within,
                });
            }
        }
        let (got_px, most_px) = (
            all.iter().map(|focus| focus.region.area_px()).sum(),
            shape.area_px(),
        );
        if got_px > most_px {
            return Err(ParamsError::FocusTooLarge { most_px, got_px });
        }
        Ok(())
    }

    /// The regions in the order of their turns, the heaviest first, and for each rung the number of them that are done then. A
    /// ladder of `rungs` rungs has no more than [`MOST_RUNGS`] with those; the lightest regions may have to share one.
    pub(crate) fn turns(all: &[Self], rungs: usize) -> (Vec<Roi>, Vec<usize>) {
        let mut sorted = all.to_vec();
        // Stable: equal ones stay in the order they were given in.
        sorted.sort_by(|a, b| b.weight.total_cmp(&a.weight));
        let mut ends = Vec::new();
        for group in sorted.chunk_by(|a, b| a.weight == b.weight) {
            let end = ends.last().copied().unwrap_or(0) + group.len();
            if ends.len() + rungs < MOST_RUNGS {
                ends.push(end);
            } else if let Some(last) = ends.last_mut() {
                *last = end;
            }
        }
        (sorted.into_iter().map(|focus| focus.region).collect(), ends)
    }
}

#[cfg(test)]
mod tests {
    use super::Focus;
    use crate::image::Roi;

    fn at(x: usize, weight: f32) -> Focus {
        let region = Roi {
            x,
            y: 0,
            width: 8,
            height: 8,
        };
        Focus { region, weight }
    }

    #[test]
    fn heavy_regions_come_first_and_equal_ones_share_a_rung() {
        let (order, ends) = Focus::turns(&[at(1, 1.0), at(2, 5.0), at(3, 1.0), at(4, 2.0)], 3);
        assert_eq!(order.iter().map(|roi| roi.x).collect::<Vec<_>>(), [2, 4, 1, 3]);
        assert_eq!(ends, [1, 2, 4]);
        assert_eq!(Focus::turns(&[], 3), (vec![], vec![]));
    }

    #[test]
    fn no_ladder_has_more_than_eight_rungs() {
        let all: Vec<Focus> = (1..=10u8).map(|k| at(k.into(), k.into())).collect();
        assert_eq!(Focus::turns(&all, 3).1, [1, 2, 3, 4, 10]);
        assert_eq!(Focus::turns(&all, 6).1, [1, 10]);
    }
}
