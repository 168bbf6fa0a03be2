//! Disparity as KITTI's 16-bit gray PNG: `value = disparity_px * 256`, 0 = invalid.

use png::{BitDepth, ColorType};
use stereo::{DisparityMap, FIXED_PER_PX};

use super::png::Picture;
use crate::status::ServiceError;

/// Steps of KITTI's disparity in one pixel.
pub const KITTI_PER_PX: u16 = 256;

/// KITTI's value of a fixed-point disparity of the core: 0 stays 0 (invalid), valid ones are at least 1, and what 16
/// bits can't say (256 px and more) saturates.
#[must_use]
pub fn kitti_from_fixed(fixed: u16) -> u16 {
    const { assert!(KITTI_PER_PX >= FIXED_PER_PX && KITTI_PER_PX.is_multiple_of(FIXED_PER_PX)) };
    fixed.saturating_mul(KITTI_PER_PX / FIXED_PER_PX)
}

/// The map as a PNG file.
///
/// # Errors
/// [`ServiceError::Internal`] if the encoder fails, which it doesn't for shapes the core knows.
pub fn encode(map: &DisparityMap) -> Result<Vec<u8>, ServiceError> {
    let pixels: Vec<[u8; 2]> = map
        .fixed()
        .iter()
        .map(|&fixed| kitti_from_fixed(fixed).to_be_bytes())
        .collect();
    Picture {
        width_px: map.shape().width_px(),
        height_px: map.shape().height_px(),
        color: ColorType::Grayscale,
        depth: BitDepth::Sixteen,
    }
    .write(pixels.as_flattened())
}

#[cfg(test)]
mod tests {
    use stereo::{DisparityMap, Shape};

    use super::{encode, kitti_from_fixed};

    #[test]
    fn the_file_holds_256ths_of_a_pixel_and_0_for_invalid() {
        let mut map = DisparityMap::new(Shape::new(37, 33).unwrap());
        let fixed = [0, 1, 64, 65, 128 * 64 - 1, 256 * 64 - 1, 256 * 64, u16::MAX];
        map.parts_mut().0[..fixed.len()].copy_from_slice(&fixed);
        let file = encode(&map).unwrap();
        let image = image::load_from_memory_with_format(&file, image::ImageFormat::Png).unwrap();
        let image::DynamicImage::ImageLuma16(image) = image else {
            panic!("not 16-bit gray: {:?}", image.color())
        };
        assert_eq!(image.dimensions(), (37, 33));
        let values = image.as_raw();
        assert_eq!(values[..8], [0, 4, 256, 260, 32_764, 65_532, 65_535, 65_535]);
        assert!(values[8..].iter().all(|&v| v == 0));
        assert_eq!(encode(&map).unwrap(), file, "the same map is the same file");
    }

    #[test]
    fn every_disparity_below_256_px_is_exact_and_no_valid_one_becomes_invalid() {
        for fixed in 0..=u16::MAX {
            let exact = u32::from(fixed) * 4;
            assert_eq!(u32::from(kitti_from_fixed(fixed)), exact.min(65_535));
        }
    }
}
