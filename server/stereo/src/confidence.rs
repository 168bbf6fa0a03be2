//! What a cost says about a pixel: an 8-bit confidence, and how probably its disparity is right.
//!
//! Both are curves over the cost (of 250), straight between points. Confidence orders pixels and is made for a threshold:
//! half of it, [`CONFIDENT_UP_TO`], is the border of the confident subset. The probability is measured: the share of the
//! high-gradient pixels of that cost that were within 3 px of the truth on KITTI 2012. It never rises with the cost, and
//! costs never rise from rung to rung: so the quality estimate never falls.

/// Points (cost, value) of a curve by rising cost; 0 beyond the last.
pub(crate) type Curve = &'static [(u8, f32)];

/// Confidence of a validated pixel, 1..=254; one that is not validated has 0.
pub(crate) fn confidence(cost: u8, half_at: u8, valid_up_to: u8) -> u8 {
    let value = at(&[(0, 254.0), (half_at, 127.5), (valid_up_to, 1.0)], cost);
    #[expect(clippy::cast_possible_truncation, reason = "between 0 and 254")]
    #[expect(clippy::cast_sign_loss, reason = "between 0 and 254")]
    let confidence = value.round() as u8;
    confidence
}

/// The curve's value at `cost`.
pub(crate) fn at(curve: &[(u8, f32)], cost: u8) -> f32 {
    curve
        .windows(2)
        .find(|pair| (pair[0].0..=pair[1].0).contains(&cost))
        .map_or(0.0, |pair| {
            let ((x0, y0), (x1, y1)) = (pair[0], pair[1]);
            y0 + (y1 - y0) * f32::from(cost - x0) / f32::from(x1 - x0)
        })
}

#[cfg(test)]
mod tests {
    use super::{at, confidence};

    #[test]
    fn confidence_falls_from_254_over_half_to_1_and_then_0() {
        assert_eq!(
            [0, 75, 125, 126, 255].map(|cost| confidence(cost, 75, 125)),
            [254, 128, 1, 0, 0]
        );
        assert!((1..=255).all(|cost| confidence(cost, 75, 125) <= confidence(cost - 1, 75, 125)));
    }

    #[test]
    fn a_curve_is_straight_between_its_points_and_zero_beyond() {
        let curve = [(0, 1.0), (10, 0.5)];
        assert_eq!([0, 5, 10, 11].map(|cost| at(&curve, cost)), [1.0, 0.75, 0.5, 0.0]);
    }
}
