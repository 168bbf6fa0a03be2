//! Everything that can be set about matching, validated once.

use crate::error::ParamsError;
use crate::focus::Focus;
use crate::image::{Roi, Shape};
use crate::ladder::rung_names;

/// The disparities that are searched: `min_px .. min_px + count` in whole pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DisparityRange {
    /// Smallest disparity in px, 0..=767.
    pub min_px: u16,
    /// Number of disparities, 16..=256 in steps of 16.
    pub count: u16,
}

impl DisparityRange {
    /// Largest accepted `min_px`: with 256 disparities above it, fixed-point disparities (1/64 px) still fit 16 bits.
    pub const MAX_MIN_PX: u16 = 767;

    /// Checks both numbers.
    ///
    /// # Errors
    /// [`ParamsError::OutOfRange`].
    pub fn validate(&self) -> Result<(), ParamsError> {
        let out_of_range = |name, expected, got: u16| {
            Err(ParamsError::OutOfRange {
                name,
                expected,
                got: f64::from(got),
            })
        };
        if self.min_px > Self::MAX_MIN_PX {
            return out_of_range("min_disparity", "0 to 767", self.min_px);
        }
        if !(16..=256).contains(&self.count) || !self.count.is_multiple_of(16) {
            return out_of_range("num_disparities", "16 to 256 in steps of 16", self.count);
        }
        Ok(())
    }
}

impl Default for DisparityRange {
    fn default() -> Self {
        Self {
            min_px: 0,
            count: 128,
        }
    }
}

/// Which pixels get a disparity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Density {
    /// The high-gradient pixels; after a mesh rung those whose disparity was validated, after a dense rung all of them, with
    /// little confidence where it was filled in.
    #[default]
    SemiDense,
    /// Every pixel; where validation failed or there is no texture, the mesh's plane, with confidence 0.
    Dense,
}

/// A named choice of algorithm parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Preset {
    /// Our best.
    #[default]
    Default,
    /// Mesh iterations alone: the first answers soonest.
    Fast,
    /// The paper to the letter.
    Paper,
}

/// All parameters of a matcher.
#[derive(Debug, Clone, PartialEq)]
pub struct Params {
    /// Which ladder and stage parameters are used.
    pub preset: Preset,
    /// Searched disparities.
    pub range: DisparityRange,
    /// Which pixels get a disparity.
    pub density: Density,
    /// Pixels with `confidence < 255 * min_confidence` are dropped; 0..=1, 0 drops none and 1 all.
    pub min_confidence: f32,
    /// Only this region is matched; `None` = the whole image.
    pub roi: Option<Roi>,
    /// Regions that are matched first (see [`Focus`]): 16 at most, with no more pixels together than the image.
    pub focus: Vec<Focus>,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            preset: Preset::Default,
            range: DisparityRange::default(),
            density: Density::SemiDense,
            min_confidence: 0.0,
            roi: None,
            focus: Vec::new(),
        }
    }
}

impl Params {
    /// Mesh iterations alone, with our supports, costs and resampling.
    #[must_use]
    pub fn fast() -> Self {
        Self {
            preset: Preset::Fast,
            ..Self::default()
        }
    }

    /// The paper to the letter (Pillai, Ramalingam, Leonard, ICRA 2016).
    #[must_use]
    pub fn paper() -> Self {
        Self {
            preset: Preset::Paper,
            ..Self::default()
        }
    }

    /// Checks every range, and the regions against `shape`.
    ///
    /// # Errors
    /// The first [`ParamsError`] found.
    pub fn validate(&self, shape: Shape) -> Result<(), ParamsError> {
        self.range.validate()?;
        if !(0.0..=1.0).contains(&self.min_confidence) {
            let got = f64::from(self.min_confidence);
            return Err(ParamsError::OutOfRange {
                name: "min_confidence",
                expected: "0 to 1",
                got,
            });
        }
        match self.roi {
            Some(roi) if !roi.lies_in(shape) => Err(ParamsError::RoiOutsideImage {
                roi,
                width_px: shape.width_px(),
                height_px: shape.height_px(),
            }),
            _ => Focus::validate(&self.focus, shape, self.roi),
        }
    }

    /// Names of the rungs with these parameters, in order; the first is what `base` publishes. At most 8.
    #[must_use]
    pub fn rung_names(&self) -> Vec<&'static str> {
        let mut names = rung_names(self.preset);
        let (_, turns) = Focus::turns(&self.focus, names.len());
        names.splice(1..1, turns.iter().map(|_| "focus"));
        names
    }
}
