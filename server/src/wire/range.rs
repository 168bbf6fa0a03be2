//! The ranges of numeric options: checks and refusals in the same words whatever encoding the number came in.

use crate::status::ServiceError;

/// A numeric option.
pub(super) struct Range {
    /// The option's name on the wire and in JSON.
    pub(super) name: &'static str,
    /// What is accepted, in words.
    pub(super) expected: &'static str,
    /// Smallest accepted value.
    pub(super) min: f64,
    /// Largest accepted value.
    pub(super) max: f64,
    /// What an accepted value is a multiple of; 0 = any value.
    pub(super) step: f64,
}

pub(super) const MAX_ITERATIONS: Range = Range {
    name: "max_iterations",
    expected: "a whole number from 1 to 255",
    min: 1.0,
    max: 255.0,
    step: 1.0,
};
pub(super) const NUM_DISPARITIES: Range = Range {
    name: "num_disparities",
    expected: "16 to 256 in steps of 16",
    min: 16.0,
    max: 256.0,
    step: 16.0,
};
pub(super) const MIN_DISPARITY: Range = Range {
    name: "min_disparity",
    expected: "a whole number from 0 to 767",
    min: 0.0,
    max: 767.0,
    step: 1.0,
};
pub(super) const MIN_CONFIDENCE: Range = Range {
    name: "min_confidence",
    expected: "a number from 0 to 1",
    min: 0.0,
    max: 1.0,
    step: 0.0,
};
pub(super) const MAX_DISPARITY_STEP_PX: Range = Range {
    name: "mesh.max_disparity_step_px",
    expected: "a number from 0.5 to 64",
    min: 0.5,
    max: 64.0,
    step: 0.0,
};
pub(super) const MIN_VALID_SHARE: Range = Range {
    name: "mesh.min_valid_share",
    expected: "a number from 0 to 1",
    min: 0.0,
    max: 1.0,
    step: 0.0,
};

pub(super) const MESH_TOLERANCE_PX: Range = Range {
    name: "mesh.tolerance_px",
    expected: "a number from 0.1 to 64",
    min: 0.1,
    max: 64.0,
    step: 0.0,
};
pub(super) const MAX_TRIANGLES: Range = Range {
    name: "mesh.max_triangles",
    expected: "a whole number from 100 to 1000000",
    min: 100.0,
    max: 1e6,
    step: 1.0,
};

pub(super) const FOCUS_WEIGHT: Range = Range {
    name: "focus.weight",
    expected: "a number from 0.001 to 1000",
    min: 0.001,
    max: 1000.0,
    step: 0.0,
};

impl Range {
    /// `got` if it is accepted; NaN never is.
    pub(super) fn check(&self, got: f64) -> Result<f64, ServiceError> {
        let on_step = self.step == 0.0 || got % self.step == 0.0;
        if (self.min..=self.max).contains(&got) && on_step {
            Ok(got)
        } else {
            Err(self.refuse(got))
        }
    }

    /// `got` as a small whole number if it is accepted.
    pub(super) fn check_u16(&self, got: f64) -> Result<u16, ServiceError> {
        let value = self.check(got)?;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the ranges lie within 0..=767"
        )]
        Ok(value as u16)
    }

    /// `got` as a whole number if it is accepted.
    pub(super) fn check_u32(&self, got: f64) -> Result<u32, ServiceError> {
        let value = self.check(got)?;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the ranges lie within 0..=1000000"
        )]
        Ok(value as u32)
    }

    /// `got` as a float if it is accepted.
    pub(super) fn check_f32(&self, got: f32) -> Result<f32, ServiceError> {
        self.check(got.into()).map(|_| got)
    }

    fn refuse(&self, got: f64) -> ServiceError {
        ServiceError::Invalid(format!("{} must be {}, got {got}", self.name, self.expected))
    }
}
