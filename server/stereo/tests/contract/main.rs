//! What a caller may rely on, whatever the images: the contract of `Matcher`.
#![expect(clippy::unwrap_used, reason = "tests")]

mod answers;
mod bits;
#[path = "../common/mod.rs"]
mod common;
mod meshes;
mod refusals;

use stereo::{
    DisparityMap, ForkJoin, GrayView, Level, Matcher, Params, Progress, Quality, Shape, StereoPair,
};

/// A textured pair: what the left view shows at `x`, the right shows at `x - disparity(y)`.
struct Pair {
    left: Vec<u8>,
    right: Vec<u8>,
    width: usize,
    height: usize,
}

/// Smooth noise: whole-number hashes of a 3 px grid, with lines between.
fn texture(x: i64, y: i64) -> u8 {
    let hash = |x: i64, y: i64| {
        let mut v =
            (x.wrapping_mul(0x9E37_79B9) ^ y.wrapping_mul(0x85EB_CA6B)).wrapping_mul(0x27D4_EB2F_1656_67C5);
        v ^= v >> 29;
        (v.wrapping_mul(0x1656_67B1_9E37_79F9) >> 40) & 0xFF
    };
    let (cx, cy, fx, fy) = (x.div_euclid(3), y.div_euclid(3), x.rem_euclid(3), y.rem_euclid(3));
    let row = |cy| hash(cx, cy) * (3 - fx) + hash(cx + 1, cy) * fx;
    u8::try_from((row(cy) * (3 - fy) + row(cy + 1) * fy) / 9).unwrap()
}

impl Pair {
    fn with_disparity(width: usize, height: usize, disparity: impl Fn(usize) -> i64) -> Self {
        let pixels = |shifted: bool| {
            (0..width * height)
                .map(|at| {
                    let (x, y) = (at % width, at / width);
                    let shift = if shifted { disparity(y) } else { 0 };
                    texture(i64::try_from(x).unwrap() + shift, i64::try_from(y).unwrap())
                })
                .collect()
        };
        Self {
            left: pixels(false),
            right: pixels(true),
            width,
            height,
        }
    }

    fn shape(&self) -> Shape {
        Shape::new(self.width, self.height).unwrap()
    }

    fn views(&self) -> StereoPair<'_> {
        let view = |data| GrayView::new(data, self.width, self.height, self.width).unwrap();
        StereoPair::new(view(&self.left), view(&self.right)).unwrap()
    }
}

fn matcher(shape: Shape, params: Params) -> Matcher {
    Matcher::new(Level::detect(), shape, params).unwrap()
}

/// The result of every rung.
fn climb(matcher: &mut Matcher, pair: &Pair, join: &dyn ForkJoin) -> Vec<(Quality, DisparityMap)> {
    let mut out = DisparityMap::new(pair.shape());
    let mut rungs = Vec::new();
    let mut progress = matcher.base(pair.views(), &mut out, join).unwrap();
    loop {
        match progress {
            Progress::Working => {}
            Progress::Improved(quality) => rungs.push((quality, out.clone())),
            Progress::Converged(quality) => {
                rungs.push((quality, out));
                return rungs;
            }
        }
        progress = matcher.refine(pair.views(), &mut out, join);
    }
}

fn share_within_half_px(map: &DisparityMap, truth: impl Fn(usize) -> f32) -> f32 {
    share_within(0.5, 0, map, truth)
}

/// Of the columns from `first` on.
fn share_within(tolerance_px: f32, first: usize, map: &DisparityMap, truth: impl Fn(usize) -> f32) -> f32 {
    let width = map.shape().width_px();
    let (mut returned, mut right) = (0.0, 0.0);
    for (at, disparity) in map
        .iter_px()
        .enumerate()
        .filter(|(_, disparity)| !disparity.is_nan())
    {
        if at % width < first {
            continue;
        }
        returned += 1.0;
        right += f32::from(u8::from((disparity - truth(at / width)).abs() < tolerance_px));
    }
    right / returned
}
