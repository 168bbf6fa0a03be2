//! Where things are in space: the one place that turns pixels and disparities into metres.
//!
//! The camera's frame: x right, y down, z forward, in metres, with its origin in the left camera.
//! `z = focal_px * baseline_m / (disparity_px + doffs_px)`, `x = (u - cx_px) * z / focal_px`, `y = (v - cy_px) * z / focal_px`.

use crate::job::Calibration;

impl Calibration {
    /// Depth in metres along the optical axis of a disparity in px; `None` at or behind infinity.
    #[must_use]
    pub fn depth_m_from_disparity_px(&self, disparity_px: f32) -> Option<f64> {
        let parallax_px = f64::from(disparity_px) + self.doffs_px;
        let depth_m = self.focal_px * self.baseline_m / parallax_px;
        (parallax_px > 0.0 && depth_m.is_finite()).then_some(depth_m)
    }

    /// The point `[x, y, z]` in metres that column `u_px` and row `v_px` of the left view see with a disparity in px;
    /// `None` at or behind infinity.
    #[must_use]
    pub fn point_m_from_pixel(&self, u_px: f32, v_px: f32, disparity_px: f32) -> Option<[f64; 3]> {
        let z = self.depth_m_from_disparity_px(disparity_px)?;
        let x = (f64::from(u_px) - self.cx_px) * z / self.focal_px;
        let y = (f64::from(v_px) - self.cy_px) * z / self.focal_px;
        (x.is_finite() && y.is_finite()).then_some([x, y, z])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Calibration = Calibration {
        focal_px: 500.0,
        cx_px: 320.0,
        cy_px: 240.0,
        baseline_m: 0.1,
        doffs_px: 0.0,
    };

    #[test]
    fn a_disparity_of_ten_pixels_is_five_metres_away() {
        assert_eq!(CAMERA.depth_m_from_disparity_px(10.0), Some(5.0));
        assert_eq!(
            CAMERA.point_m_from_pixel(420.0, 140.0, 10.0),
            Some([1.0, -1.0, 5.0])
        );
    }

    #[test]
    fn the_offset_of_the_principal_points_is_added_to_the_disparity() {
        let offset = Calibration {
            doffs_px: 15.0,
            ..CAMERA
        };
        assert_eq!(offset.depth_m_from_disparity_px(10.0), Some(2.0));
    }

    #[test]
    fn points_at_or_behind_infinity_are_none() {
        assert_eq!(CAMERA.depth_m_from_disparity_px(0.0), None);
        assert_eq!(CAMERA.depth_m_from_disparity_px(f32::NAN), None);
        let offset = Calibration {
            doffs_px: -10.0,
            ..CAMERA
        };
        assert_eq!(offset.depth_m_from_disparity_px(10.0), None);
        assert_eq!(offset.depth_m_from_disparity_px(5.0), None);
    }
}
