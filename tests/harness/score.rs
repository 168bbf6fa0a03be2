//! The scoring protocol, the same for every method and every data set.
//!
//! - High-gradient pixels: Sobel 3x3 magnitude `sqrt(gx^2 + gy^2) > 80` on the 8-bit gray left view, borders mirrored
//!   without repeating the edge (OpenCV's default).
//! - Ground truth: non-occluded pixels with a known disparity.
//! - Density: share of those pixels that got a disparity.
//! - Returned: share of the *returned* pixels within 2, 3, 4, 5 px; all: share of *all* of them (missing = wrong).
//! - Dense columns: the same over every pixel with ground truth.
//! - D1: error over 3 px and over 5 %, missing = wrong.

use crate::gray::GrayImage;

/// Error bounds in px of [`Accuracy::returned`] and [`Accuracy::all`].
pub const BOUNDS_PX: [f32; 4] = [2.0, 3.0, 4.0, 5.0];

/// Figures over one set of pixels, all in percent.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Accuracy {
    /// Share of the pixels that have a disparity.
    pub density: f64,
    /// Share of the returned pixels within [`BOUNDS_PX`].
    pub returned: [f64; 4],
    /// Share of all pixels within [`BOUNDS_PX`].
    pub all: [f64; 4],
    /// Share of all pixels that are missing, or wrong by over 3 px and over 5 %.
    pub d1: f64,
}

/// Figures of one scene or the mean of several.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Score {
    /// Over the high-gradient pixels with ground truth.
    pub edges: Accuracy,
    /// Over every pixel with ground truth.
    pub dense: Accuracy,
}

/// Scores `disparity_px` (NaN or <= 0 = none) against `truth_px` (<= 0 = unknown), both of `left`'s size.
///
/// # Panics
/// If the lengths differ from the image's.
#[must_use]
pub fn score(disparity_px: &[f32], left: &GrayImage, truth_px: &[f32]) -> Score {
    assert_eq!(disparity_px.len(), left.pixels().len(), "one disparity a pixel");
    assert_eq!(truth_px.len(), left.pixels().len(), "one true disparity a pixel");
    let strong = high_gradient(left);
    let mut edges = Tally::default();
    let mut dense = Tally::default();
    for ((&got, &truth), &strong) in disparity_px.iter().zip(truth_px).zip(&strong) {
        if truth > 0.0 {
            dense.add(got, truth);
            if strong {
                edges.add(got, truth);
            }
        }
    }
    Score {
        edges: edges.accuracy(),
        dense: dense.accuracy(),
    }
}

/// Share in percent of the pixels with `chosen` and a true disparity that are within `bound_px` of it; missing = wrong, 0
/// for no such pixel.
///
/// # Panics
/// If the lengths differ.
#[must_use]
pub fn share_within(disparity_px: &[f32], truth_px: &[f32], chosen: &[bool], bound_px: f32) -> f64 {
    assert_eq!(disparity_px.len(), truth_px.len(), "one disparity a true one");
    assert_eq!(chosen.len(), truth_px.len(), "one choice a true disparity");
    let (mut total, mut within) = (0_u32, 0_u32);
    for ((&got, &truth), &chosen) in disparity_px.iter().zip(truth_px).zip(chosen) {
        if chosen && truth > 0.0 {
            total += 1;
            within += u32::from(got > 0.0 && (got - truth).abs() < bound_px);
        }
    }
    100.0 * f64::from(within) / f64::from(total.max(1))
}

/// The mean of several scenes' scores; zeros for none.
#[must_use]
pub fn mean(scores: &[Score]) -> Score {
    let mean_of = |figure: &dyn Fn(&Score) -> f64| {
        scores.iter().map(figure).sum::<f64>()
            / f64::from(u32::try_from(scores.len().max(1)).unwrap_or(u32::MAX))
    };
    let accuracy = |part: &dyn Fn(&Score) -> Accuracy| Accuracy {
        density: mean_of(&|s| part(s).density),
        returned: std::array::from_fn(|i| mean_of(&|s| part(s).returned[i])),
        all: std::array::from_fn(|i| mean_of(&|s| part(s).all[i])),
        d1: mean_of(&|s| part(s).d1),
    };
    Score {
        edges: accuracy(&|s| s.edges),
        dense: accuracy(&|s| s.dense),
    }
}

/// Which pixels of `image` have a Sobel magnitude over 80.
#[must_use]
pub fn high_gradient(image: &GrayImage) -> Vec<bool> {
    let (width, height) = (image.width_px(), image.height_px());
    let at = |x: usize, y: usize| i32::from(image.pixels()[y * width + x]);
    let mut strong = Vec::with_capacity(width * height);
    for y in 0..height {
        let (above, below) = mirrored_neighbours(y, height);
        for x in 0..width {
            let (before, after) = mirrored_neighbours(x, width);
            let gx = at(after, above) + 2 * at(after, y) + at(after, below)
                - at(before, above)
                - 2 * at(before, y)
                - at(before, below);
            let gy = at(before, below) + 2 * at(x, below) + at(after, below)
                - at(before, above)
                - 2 * at(x, above)
                - at(after, above);
            strong.push(gx * gx + gy * gy > 80 * 80);
        }
    }
    strong
}

/// The positions before and after `i` in `0..n`; at the ends the neighbour on the other side stands in.
fn mirrored_neighbours(i: usize, n: usize) -> (usize, usize) {
    let before = if i > 0 { i - 1 } else { 1.min(n - 1) };
    let after = if i + 1 < n { i + 1 } else { n.saturating_sub(2) };
    (before, after)
}

#[derive(Debug, Default)]
struct Tally {
    total: u32,
    returned: u32,
    within: [u32; 4],
    d1_wrong: u32,
}

impl Tally {
    fn add(&mut self, got: f32, truth: f32) {
        self.total += 1;
        if got > 0.0 {
            let error = (got - truth).abs();
            self.returned += 1;
            for (count, bound) in self.within.iter_mut().zip(BOUNDS_PX) {
                *count += u32::from(error < bound);
            }
            self.d1_wrong += u32::from(error > 3.0 && error > 0.05 * truth);
        } else {
            self.d1_wrong += 1;
        }
    }

    fn accuracy(&self) -> Accuracy {
        let percent = |count: u32, of: u32| 100.0 * f64::from(count) / f64::from(of.max(1));
        Accuracy {
            density: percent(self.returned, self.total),
            returned: self.within.map(|n| percent(n, self.returned)),
            all: self.within.map(|n| percent(n, self.total)),
            d1: percent(self.d1_wrong, self.total),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Accuracy, high_gradient, mean, score, share_within};
    use crate::gray::GrayImage;

    fn step_edge() -> GrayImage {
        let pixels = (0..40).map(|i| if i % 8 < 4 { 10 } else { 200 }).collect();
        GrayImage::new(8, 5, pixels).expect("8 x 5")
    }

    #[test]
    fn only_the_pixels_beside_a_step_have_a_high_gradient() {
        let row: Vec<bool> = (0..8).map(|x| x == 3 || x == 4).collect();
        assert_eq!(high_gradient(&step_edge()), row.repeat(5));
    }

    #[test]
    fn a_magnitude_of_exactly_80_is_not_high() {
        let image = |step: u8| GrayImage::new(3, 1, vec![0, 0, step]).expect("3 x 1");
        // One row, mirrored: the kernel's column weights add up to 4.
        assert_eq!(high_gradient(&image(20)), [false, false, false]);
        assert_eq!(high_gradient(&image(21)), [false, true, false]);
    }

    #[test]
    fn missing_pixels_count_in_all_but_not_in_returned() {
        let left = step_edge();
        let truth = vec![10.0; 40];
        let mut got = vec![0.0; 40];
        for y in 0..5 {
            got[y * 8 + 3] = 12.5; // within 3 px, not within 2
        }
        let scored = score(&got, &left, &truth);
        assert_eq!(scored.edges.density, 50.0);
        assert_eq!(scored.edges.returned, [0.0, 100.0, 100.0, 100.0]);
        assert_eq!(scored.edges.all, [0.0, 50.0, 50.0, 50.0]);
        assert_eq!(scored.edges.d1, 50.0);
        assert_eq!(scored.dense.density, 12.5);
    }

    #[test]
    fn an_error_under_five_percent_is_not_d1_wrong() {
        let left = step_edge();
        let scored = score(&[104.0; 40], &left, &[100.0; 40]);
        assert_eq!(scored.dense.d1, 0.0);
        assert_eq!(scored.dense.all[1], 0.0);
    }

    #[test]
    fn every_figure_of_an_arbitrary_map_is_the_reference_scripts() {
        // Formulas for left view, truth and disparity; the figures are those of the same protocol written in Python with
        // OpenCV's Sobel and numpy.
        let (mut pixels, mut truths, mut got) = (Vec::new(), Vec::new(), Vec::new());
        for y in 0..31_u16 {
            for x in 0..47_u16 {
                pixels.push((x * x * 7 + y * y * 3 + x * y * 5).to_le_bytes()[0]);
                let fixed = if (x + y) % 4 == 0 {
                    0
                } else {
                    (x * 97 + y * 31) % 30_000
                };
                let truth = f32::from(fixed) / 256.0;
                let error = (f32::from((x * 5 + y * 11) % 23) - 11.0) * 0.625;
                truths.push(truth);
                got.push(if (x * 3 + y) % 5 == 0 { 0.0 } else { truth + error });
            }
        }
        let left = GrayImage::new(47, 31, pixels).expect("47 x 31");
        let scored = score(&got, &left, &truths);
        let figures = |a: Accuracy| [a.density, a.returned[0], a.returned[3], a.all[1], a.all[2], a.d1];
        let edges = [
            75.445_545, 32.414_698, 67.716_535, 31.089_109, 44.455_446, 68.910_891,
        ];
        let dense = [
            74.748_399, 31.578_947, 66.829_865, 30.466_606, 43.458_371, 69.533_394,
        ];
        for (got, expected) in figures(scored.edges)
            .iter()
            .zip(edges)
            .chain(figures(scored.dense).iter().zip(dense))
        {
            assert!((got - expected).abs() < 1e-5, "{got} for {expected}");
        }
    }

    #[test]
    fn a_share_counts_the_chosen_pixels_with_truth_only() {
        let got = [5.4, 9.0, f32::NAN, 5.0, 5.0];
        let truth = [5.0, 5.0, 5.0, 5.0, 0.0];
        let share = share_within(&got, &truth, &[true, true, true, false, true], 0.5);
        assert!((share - 100.0 / 3.0).abs() < 1e-9, "{share}");
        assert_eq!(share_within(&got, &truth, &[false; 5], 0.5), 0.0);
    }

    #[test]
    fn nan_is_no_disparity_and_unknown_truth_is_not_scored() {
        let left = step_edge();
        let mut truth = vec![0.0; 40];
        truth[0] = 5.0;
        let scored = score(&[f32::NAN; 40], &left, &truth);
        assert_eq!(scored.dense.density, 0.0);
        assert_eq!(scored.dense.d1, 100.0);
        assert_eq!(mean(&[scored, scored]), scored);
    }
}
