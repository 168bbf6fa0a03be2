//! An 8-bit confidence for every pixel, from what each rung knows of it.
//!
//! Confidence orders pixels, and half of it is the border of the confident subset. Mesh rungs know the matching cost; the
//! dense rungs know as well whether the right view agrees and whether the surroundings are one surface, which tells more.

use crate::ladder::Recipe;
use crate::simd::{Kernel, Lanes, Level, TABLE};

/// Points of a curve, by rising x.
pub(crate) type Curve = &'static [(f32, f32)];

/// The curve's value at `x`, straight between points; the end's value beyond it.
pub(crate) fn at(curve: &[(f32, f32)], x: f32) -> f32 {
    for pair in curve.windows(2) {
        let ((x0, y0), (x1, y1)) = (pair[0], pair[1]);
        if x <= x1 {
            return y0 + (y1 - y0) * (x - x0).max(0.0) / (x1 - x0);
        }
    }
    curve.last().map_or(0.0, |&(_, y)| y)
}

/// Half of the full confidence.
const HALF: u16 = 127;
/// Full confidence; 255 is never given, so that a minimum of 1 drops everything.
const FULL: u16 = 254;
/// Confidence over the cost: 254 at 0, half at `half_at`, next to nothing at `valid_up_to`, 0 beyond.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CostScale {
    half_at: u16,
    valid_up_to: u16,
    /// Confidence a cost below and above half takes away, with 8 fractional bits.
    steep: u16,
    flat: u16,
}

impl CostScale {
    /// A preset's.
    pub(crate) fn of(recipe: &Recipe) -> Self {
        Self::new(recipe.half_confidence_at.into(), recipe.valid_up_to.into())
    }

    /// `half_at` is more than 0 and less than `valid_up_to`, and that less than [`TABLE`].
    fn new(half_at: u16, valid_up_to: u16) -> Self {
        Self {
            half_at,
            valid_up_to,
            steep: (FULL - HALF) * 256 / half_at,
            flat: (HALF - 1) * 256 / (valid_up_to - half_at),
        }
    }

    /// Half the full confidence is reached `by` later.
    pub(crate) fn milder(self, by: u16) -> Self {
        Self::new(self.half_at + by, self.valid_up_to)
    }

    /// Confidences of validated pixels by their costs.
    #[inline(always)]
    pub(crate) fn rate(self, costs: &[u8], confidence: &mut [u8]) {
        for (confidence, cost) in confidence.iter_mut().zip(costs) {
            *confidence = self.of_cost(u16::from(*cost));
        }
    }

    /// Confidences of all costs that validate a pixel; of the others it is 0.
    pub(crate) fn table(self) -> [u8; TABLE] {
        let mut table = [0; TABLE];
        for (confidence, cost) in table.iter_mut().zip(0..) {
            *confidence = self.of_cost(cost);
        }
        table
    }

    #[inline(always)]
    fn of_cost(self, cost: u16) -> u8 {
        let near = FULL - ((cost.min(self.half_at) * self.steep) >> 8);
        let beyond = cost
            .saturating_sub(self.half_at)
            .min(self.valid_up_to - self.half_at);
        let far = (beyond * self.flat) >> 8;
        #[expect(clippy::cast_possible_truncation, reason = "at most 254")]
        let confidence = (near.saturating_sub(far)).max(1) as u8;
        if cost <= self.valid_up_to { confidence } else { 0 }
    }
}

/// Confidences after a mesh rung.
pub(crate) fn rate_costs(level: Level, scale: CostScale, costs: &[u8], confidence: &mut [u8]) {
    level.run(Costs {
        scale,
        costs,
        confidence,
    });
}

struct Costs<'a> {
    scale: CostScale,
    costs: &'a [u8],
    confidence: &'a mut [u8],
}

impl Kernel for Costs<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        self.scale.rate(self.costs, self.confidence);
    }
}

/// Confidences of a dense row: at most the certainties of its half resolution row, and less for high costs, if known.
pub(crate) fn rate_dense(
    level: Level,
    scale: CostScale,
    certainties: &[u8],
    costs: Option<&[u8]>,
    confidence: &mut [u8],
) {
    level.run(Dense {
        scale,
        certainties,
        costs,
        confidence,
    });
}

/// The same as a kernel.
pub(crate) struct Dense<'a> {
    pub(crate) scale: CostScale,
    pub(crate) certainties: &'a [u8],
    pub(crate) costs: Option<&'a [u8]>,
    pub(crate) confidence: &'a mut [u8],
}

impl Kernel for Dense<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self {
            scale,
            certainties,
            costs,
            confidence,
        } = self;
        // Without costs, as if all were at half of what is confident.
        let most = if costs.is_some() { FULL } else { (FULL + HALF) / 2 };
        #[expect(clippy::cast_possible_truncation, reason = "at most 254")]
        let most = most as u8;
        let (pairs, last) = confidence.as_chunks_mut::<2>();
        for (pair, certainty) in pairs.iter_mut().zip(certainties) {
            // Both alike, as one number: so the loop becomes vector code.
            *pair = (u16::from((*certainty).min(most)) * 0x0101).to_le_bytes();
        }
        if let ([last], Some(certainty)) = (last, certainties.last()) {
            *last = (*certainty).min(most);
        }
        let Some(costs) = costs else { return };
        for (confidence, cost) in confidence.iter_mut().zip(costs) {
            let cost = u16::from(*cost).min(scale.valid_up_to);
            *confidence = (*confidence).min(scale.of_cost(cost));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{CostScale, at};

    #[test]
    fn confidence_falls_from_254_over_half_to_next_to_nothing_and_then_0() {
        let costs: Vec<u8> = (0..=255).collect();
        let mut confidence = vec![0; 256];
        CostScale::new(75, 125).rate(&costs, &mut confidence);
        assert_eq!([0, 126, 255].map(|cost| confidence[cost]), [254, 0, 0]);
        assert!((1..=4).contains(&confidence[125]), "{}", confidence[125]);
        assert!(confidence[75] >= 127 && confidence[76] <= 127);
        assert!(confidence.windows(2).all(|pair| pair[0] >= pair[1]));
    }

    #[test]
    fn a_curve_is_straight_between_its_points_and_level_beyond() {
        let curve = [(0.0, 1.0), (10.0, 0.5)];
        assert_eq!(
            [0.0, 5.0, 10.0, 11.0].map(|x| at(&curve, x)),
            [1.0, 0.75, 0.5, 0.5]
        );
    }
}
