//! Disparity in colours: near is warm, far is cold, invalid is black.
//!
//! The colours are the turbo scale (Mikhailov 2019) without its nearly black ends, which would look invalid,
//! stretched over the 2nd to 98th percentile of the valid disparities of this frame, so that a few wrong ones don't
//! take the contrast.

use png::{BitDepth, ColorType};
use stereo::DisparityMap;

use super::histogram::Histogram;
use super::png::Picture;
use crate::status::ServiceError;

/// Share of the valid disparities beyond each end of the scale, as 1 / this.
const TAIL: usize = 50;

/// The part of the turbo scale that is used, 0 to 1 being all of it.
const COLDEST: f64 = 0.08;
const WARMEST: f64 = 0.94;

/// The map as a PNG file.
pub(super) fn encode(map: &DisparityMap) -> Result<Vec<u8>, ServiceError> {
    let (far, near) = range(map);
    // A colour for every disparity of the scale.
    let span = f64::from(near - far).max(1.0);
    let scale: Vec<[u8; 3]> = (far..=near)
        .map(|fixed| {
            let nearness = f64::from(fixed - far) / span;
            colorous::TURBO
                .eval_continuous(COLDEST + nearness * (WARMEST - COLDEST))
                .into_array()
        })
        .collect();
    let color = |&fixed: &u16| match fixed {
        0 => [0; 3],
        _ => scale[usize::from(fixed.clamp(far, near) - far)],
    };
    let pixels: Vec<[u8; 3]> = map.fixed().iter().map(color).collect();
    Picture {
        width_px: map.shape().width_px(),
        height_px: map.shape().height_px(),
        color: ColorType::Rgb,
        depth: BitDepth::Eight,
    }
    .write(pixels.as_flattened())
}

/// The fixed-point disparities at both ends of the scale; equal if there is only one, 0 if there is none.
fn range(map: &DisparityMap) -> (u16, u16) {
    let histogram = Histogram::new(map);
    let tail = histogram.valid() / TAIL;
    let end = |rank| histogram.ranked(rank).unwrap_or(0);
    (end(tail), end(histogram.valid().saturating_sub(1 + tail)))
}

#[cfg(test)]
mod tests {
    use stereo::{DisparityMap, Shape};

    use super::{encode, range};

    fn map(fixed_at: impl Fn(usize) -> u16) -> DisparityMap {
        let mut map = DisparityMap::new(Shape::new(64, 32).unwrap());
        for (i, fixed) in map.parts_mut().0.iter_mut().enumerate() {
            *fixed = fixed_at(i);
        }
        map
    }

    fn colours(fixed_at: impl Fn(usize) -> u16) -> Vec<[u8; 3]> {
        let map = map(fixed_at);
        let file = encode(&map).unwrap();
        assert_eq!(encode(&map).unwrap(), file, "the same map is the same file");
        let image = image::load_from_memory_with_format(&file, image::ImageFormat::Png)
            .unwrap()
            .into_rgb8();
        assert_eq!(image.dimensions(), (64, 32));
        image.pixels().map(|p| p.0).collect()
    }

    #[test]
    fn near_is_warm_far_is_cold_and_invalid_is_black() {
        let image = colours(|i| match i % 64 {
            0..16 => 0,
            16..40 => 4 * 64,
            _ => 60 * 64,
        });
        assert_eq!(image[3], [0, 0, 0]);
        let ([r, _, b], [near_r, _, near_b]) = (image[20].map(u32::from), image[50].map(u32::from));
        assert!(b > 2 * r.max(1), "far is cold: {:?}", image[20]);
        assert!(near_r > 2 * near_b.max(1), "near is warm: {:?}", image[50]);
    }

    #[test]
    fn a_few_wild_disparities_leave_the_contrast_to_the_rest() {
        let ramp = |i: usize| u16::try_from(640 + i).unwrap();
        let calm = range(&map(ramp));
        let wild = range(&map(|i| if i % 100 == 0 { u16::MAX } else { ramp(i) }));
        assert!(
            calm.0.abs_diff(wild.0) < 50 && calm.1.abs_diff(wild.1) < 50,
            "{calm:?} {wild:?}"
        );
    }

    #[test]
    fn an_empty_map_is_black_and_a_flat_one_has_one_colour() {
        assert!(colours(|_| 0).iter().all(|&p| p == [0; 3]));
        let flat = colours(|_| 777);
        assert!(flat.iter().all(|&p| p == flat[0] && p != [0; 3]));
    }
}
