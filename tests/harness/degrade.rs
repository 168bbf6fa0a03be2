//! What real cameras do to a clean pair: exposure difference, noise, blur, misalignment. Seeded and deterministic.

use crate::gray::GrayImage;
use crate::texture::{hash, signed_unit};

/// What is done to a rendered pair; [`Degradation::NONE`] leaves it as it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Degradation {
    /// Factor on the right view's gray values (exposure).
    pub gain: f64,
    /// Added to the right view's gray values.
    pub offset: f64,
    /// Standard deviation of the noise on both views, in gray values.
    pub noise_sigma: f64,
    /// Rows by which the right view is too low, in pixels.
    pub misaligned_px: f64,
    /// Standard deviation of the right view's Gaussian blur, in pixels.
    pub blur_sigma_px: f64,
}

impl Degradation {
    /// A clean pair.
    pub const NONE: Self = Self {
        gain: 1.0,
        offset: 0.0,
        noise_sigma: 0.0,
        misaligned_px: 0.0,
        blur_sigma_px: 0.0,
    };
}

impl Degradation {
    /// A real pair, degraded: as a rendered one, but with rows that are moved after the fact, the border's repeated.
    #[must_use]
    #[expect(clippy::missing_panics_doc, reason = "it can't: both images keep their sizes")]
    pub fn of(&self, left: &GrayImage, right: &GrayImage) -> (GrayImage, GrayImage) {
        let real = |image: &GrayImage| image.pixels().iter().map(|&gray| f64::from(gray)).collect();
        let (mut left_gray, right_gray): (Vec<f64>, Vec<f64>) = (real(left), real(right));
        let mut right_gray = lowered(&right_gray, right.width_px(), self.misaligned_px);
        self.degrade(&mut left_gray, &mut right_gray, right.width_px());
        let quantized_like = |image: &GrayImage, gray: &[f64]| {
            let pixels = gray.iter().map(|&gray| quantized(gray)).collect();
            GrayImage::new(image.width_px(), image.height_px(), pixels).expect("the image's own size")
        };
        (
            quantized_like(left, &left_gray),
            quantized_like(right, &right_gray),
        )
    }

    /// Blur, exposure and noise, in this order; both views are `width` pixels wide.
    pub(crate) fn degrade(&self, left: &mut [f64], right: &mut [f64], width: usize) {
        blur(right, width, self.blur_sigma_px);
        for gray in &mut *right {
            *gray = *gray * self.gain + self.offset;
        }
        for (view, pixels) in [(0, left), (1, right)] {
            for (i, gray) in pixels.iter_mut().enumerate() {
                *gray += self.noise_sigma * noise(view, i);
            }
        }
    }
}

/// `gray` moved down by `rows`, between whole rows by linear interpolation.
fn lowered(gray: &[f64], width: usize, rows: f64) -> Vec<f64> {
    let last = (gray.len() / width - 1) as f64;
    let row = |y: f64| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to the image's rows"
        )]
        let y = y.clamp(0.0, last) as usize;
        &gray[y * width..][..width]
    };
    (0..gray.len() / width)
        .flat_map(|y| {
            let from = y as f64 - rows;
            let share = from - from.floor();
            let (above, below) = (row(from.floor()), row(from.floor() + 1.0));
            let mixed = above.iter().zip(below);
            mixed.map(move |(a, b)| a * (1.0 - share) + b * share)
        })
        .collect()
}

/// To the nearest 8-bit gray value.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to 0..=255"
)]
pub(crate) fn quantized(gray: f64) -> u8 {
    gray.round().clamp(0.0, 255.0) as u8
}

/// Blurs rows and columns of `pixels` by a Gaussian; nothing is done for `sigma_px <= 0`.
fn blur(pixels: &mut [f64], width: usize, sigma_px: f64) {
    if sigma_px <= 0.0 {
        return;
    }
    let reach = blur_reach_px(sigma_px);
    let weights: Vec<f64> = (0..=reach)
        .map(|i| (-0.5 * (f64::from(i) / sigma_px).powi(2)).exp())
        .collect();
    let total = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
    let height = pixels.len() / width;
    for (step, lines, line_step, n) in [(1, height, width, width), (width, width, 1, height)] {
        for line in 0..lines {
            let start = line * line_step;
            let old: Vec<f64> = (0..n).map(|i| pixels[start + i * step]).collect();
            for i in 0..n {
                let mut sum = weights[0] * old[i];
                for (k, weight) in weights.iter().enumerate().skip(1) {
                    sum += weight * (old[i.saturating_sub(k)] + old[(i + k).min(n - 1)]);
                }
                pixels[start + i * step] = sum / total;
            }
        }
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a blur of a few pixels"
)]
fn blur_reach_px(sigma_px: f64) -> u32 {
    (3.0 * sigma_px).ceil() as u32
}

/// Normally distributed noise of unit variance for pixel `i` of view `view`.
fn noise(view: u32, i: usize) -> f64 {
    let i = u32::try_from(i).expect("images have far fewer pixels than u32::MAX");
    // Box and Muller; the first number is kept off zero.
    let radius = (signed_unit(hash(0x51ed_270b, [view, i, 0])) / 2.0 + 0.5).max(1e-9);
    let angle = std::f64::consts::PI * signed_unit(hash(0x51ed_270b, [view, i, 1]));
    (-2.0 * radius.ln()).sqrt() * angle.cos()
}

#[cfg(test)]
mod tests {
    use super::{Degradation, blur, noise};
    use crate::gray::GrayImage;

    #[test]
    fn a_real_pair_is_moved_and_exposed_as_asked() {
        let image = GrayImage::new(2, 3, vec![10, 20, 30, 40, 50, 60]).expect("2 x 3");
        let changed = Degradation {
            gain: 2.0,
            offset: -5.0,
            misaligned_px: 1.5,
            ..Degradation::NONE
        };
        let (left, right) = changed.of(&image, &image);
        assert_eq!(left, image);
        assert_eq!(right.pixels(), [15, 35, 15, 35, 35, 55]);
        assert_eq!(Degradation::NONE.of(&image, &image), (image.clone(), image));
    }

    #[test]
    fn noise_has_unit_variance_and_no_bias() {
        let values: Vec<f64> = (0..50_000).map(|i| noise(0, i)).collect();
        let mean = values.iter().sum::<f64>() / 50_000.0;
        let variance = values.iter().map(|v| v * v).sum::<f64>() / 50_000.0;
        assert!(mean.abs() < 0.02, "{mean}");
        assert!((variance - 1.0).abs() < 0.03, "{variance}");
    }

    #[test]
    fn blur_keeps_flat_areas_and_spreads_a_point() {
        let mut flat = vec![7.0; 12 * 9];
        blur(&mut flat, 12, 1.5);
        assert!(flat.iter().all(|v| (v - 7.0).abs() < 1e-9));
        let mut point = vec![0.0; 21 * 21];
        point[10 * 21 + 10] = 1.0;
        blur(&mut point, 21, 1.0);
        assert!((point.iter().sum::<f64>() - 1.0).abs() < 1e-9);
        assert!((point[10 * 21 + 10] - 0.159).abs() < 0.002);
    }
}
