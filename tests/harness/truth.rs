//! Ground truth: disparity maps of the left view, where they come from, and which pixels both views see.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use image::DynamicImage;

/// Disparity of every pixel of the left view in px, 0 where unknown, row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct TruthMap {
    /// Width in pixels.
    pub width_px: usize,
    /// Height in pixels.
    pub height_px: usize,
    /// `width_px * height_px` disparities.
    pub disparity_px: Vec<f32>,
}

impl TruthMap {
    /// A map of `width_px` x `height_px`; what isn't a finite number over 0 becomes 0.
    ///
    /// # Errors
    /// If there isn't one disparity a pixel.
    pub fn new(width_px: usize, height_px: usize, mut disparity_px: Vec<f32>) -> Result<Self> {
        ensure!(
            disparity_px.len() == width_px * height_px,
            "{width_px} x {height_px} px need as many disparities, got {}",
            disparity_px.len()
        );
        for d in &mut disparity_px {
            if !(d.is_finite() && *d > 0.0) {
                *d = 0.0;
            }
        }
        Ok(Self {
            width_px,
            height_px,
            disparity_px,
        })
    }

    /// Reads a 16-bit PNG in KITTI's convention: px * 256, 0 = unknown.
    ///
    /// # Errors
    /// If the file can't be read or isn't a 16-bit gray PNG.
    pub fn read_png16(path: &Path) -> Result<Self> {
        let image = image::open(path).with_context(|| format!("can't read {}", path.display()))?;
        let DynamicImage::ImageLuma16(gray) = image else {
            bail!(
                "{} must be a 16-bit gray PNG, it is {:?}",
                path.display(),
                image.color()
            );
        };
        let px = gray.pixels().map(|p| f32::from(p.0[0]) / 256.0).collect();
        Self::new(
            usize::try_from(gray.width())?,
            usize::try_from(gray.height())?,
            px,
        )
    }

    /// Forgets the pixels where `keep` is false.
    ///
    /// # Errors
    /// If `keep` doesn't have one entry a pixel.
    pub fn retain(&mut self, keep: &[bool]) -> Result<()> {
        ensure!(
            keep.len() == self.disparity_px.len(),
            "{} pixels but {} flags",
            self.disparity_px.len(),
            keep.len()
        );
        for (d, &keep) in self.disparity_px.iter_mut().zip(keep) {
            if !keep {
                *d = 0.0;
            }
        }
        Ok(())
    }

    /// The pixels that the right view sees too, by z-buffer: every pixel is warped to the right view, and one that
    /// lands outside it, or where another lands with a disparity more than 1 px larger, is hidden.
    #[must_use]
    pub fn visible_in_right(&self) -> Vec<bool> {
        let mut visible = vec![false; self.disparity_px.len()];
        let mut nearest = vec![0.0_f32; self.width_px];
        for (row, flags) in self
            .disparity_px
            .chunks_exact(self.width_px)
            .zip(visible.chunks_exact_mut(self.width_px))
        {
            nearest.fill(0.0);
            for (x, &d) in row.iter().enumerate() {
                if let Some((a, b)) = self.landing(x, d) {
                    nearest[a] = nearest[a].max(d);
                    nearest[b] = nearest[b].max(d);
                }
            }
            for ((x, &d), flag) in row.iter().enumerate().zip(flags) {
                // Of the two columns it covers, one free of nearer pixels is enough to be seen.
                *flag = self
                    .landing(x, d)
                    .is_some_and(|(a, b)| nearest[a].min(nearest[b]) <= d + 1.0);
            }
        }
        visible
    }

    /// The two columns of the right view a pixel at `x` with disparity `d` falls between.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "checked to be within 0..=width - 1"
    )]
    fn landing(&self, x: usize, d: f32) -> Option<(usize, usize)> {
        let last = (self.width_px - 1) as f32;
        let x_right = x as f32 - d;
        (d > 0.0 && (0.0..=last).contains(&x_right))
            .then(|| (x_right.floor() as usize, x_right.ceil() as usize))
    }
}

#[cfg(test)]
mod tests {
    use super::TruthMap;

    #[test]
    fn a_pixel_behind_a_nearer_one_is_hidden() {
        // A near object (d = 4) at columns 8..12 covers columns 4..8 of the right view, where the far wall
        // (d = 1) of columns 5..9 would be seen.
        let row: Vec<f32> = (0..16)
            .map(|x| if (8..12).contains(&x) { 4.0 } else { 1.0 })
            .collect();
        let map = TruthMap::new(16, 1, row).expect("16 x 1");
        let hidden: Vec<usize> = map
            .visible_in_right()
            .iter()
            .enumerate()
            .filter(|(_, seen)| !**seen)
            .map(|(x, _)| x)
            .collect();
        assert_eq!(hidden, [0, 5, 6, 7]);
    }

    #[test]
    fn unknown_disparities_become_zero_and_are_not_visible() {
        let map = TruthMap::new(4, 1, vec![f32::INFINITY, f32::NAN, -1.0, 1.0]).expect("4 x 1");
        assert_eq!(map.disparity_px, [0.0, 0.0, 0.0, 1.0]);
        assert_eq!(map.visible_in_right(), [false, false, false, true]);
    }
}
