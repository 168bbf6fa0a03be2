//! The disparity map as PNG, PFM and NPY files.

use std::io::Cursor;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use stereo_client::disparity_px;
use stereo_client::v1::StereoResult;

use super::missing;
use crate::failure::Failure;

/// Steps of a 16-bit disparity in one pixel.
const PER_PX: f32 = 256.0;
/// Share of the valid disparities beyond each end of the colours, as 1 / this.
const TAIL: usize = 50;
/// The part of the turbo scale that is used: its ends are nearly black, as invalid pixels are.
const COLDEST: f64 = 0.08;
const WARMEST: f64 = 0.94;

/// Disparities in px, NaN = none.
#[derive(Debug)]
pub(super) struct Map {
    width: u32,
    height: u32,
    px: Vec<f32>,
}

impl Map {
    pub(super) fn of(result: &StereoResult) -> Result<Self, Failure> {
        let disparity = result
            .disparity
            .as_ref()
            .filter(|disparity| !disparity.data.is_empty())
            .ok_or_else(|| missing("disparity", result))?;
        Ok(Self {
            width: disparity.width,
            height: disparity.height,
            px: disparity_px(disparity)?,
        })
    }

    /// 16 bit, px x 256, 0 = none; a valid disparity is at least 1.
    pub(super) fn png(&self) -> Result<Vec<u8>, Failure> {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "it is between 1 and the largest u16"
        )]
        let fixed = |&px: &f32| match px.is_nan() {
            true => 0,
            false => (px * PER_PX).round().clamp(1.0, 65535.0) as u16,
        };
        let bytes: Vec<u8> = self.px.iter().flat_map(|px| fixed(px).to_ne_bytes()).collect();
        self.encode(&bytes, ExtendedColorType::L16)
    }

    /// Near is warm, far is cold, none is black.
    pub(super) fn color_png(&self) -> Result<Vec<u8>, Failure> {
        let (far, near) = self.ends();
        let span = f64::from(near - far).max(1.0 / f64::from(PER_PX));
        let color = |&px: &f32| match px.is_nan() {
            true => [0; 3],
            false => {
                let nearness = (f64::from(px - far) / span).clamp(0.0, 1.0);
                let place = COLDEST + nearness * (WARMEST - COLDEST);
                colorous::TURBO.eval_continuous(place).into_array()
            }
        };
        let pixels: Vec<[u8; 3]> = self.px.iter().map(color).collect();
        self.encode(pixels.as_flattened(), ExtendedColorType::Rgb8)
    }

    /// Rows from bottom to top, infinite = none, as Middlebury has it.
    pub(super) fn pfm(&self) -> Vec<u8> {
        let mut file = format!("Pf\n{} {}\n-1.0\n", self.width, self.height).into_bytes();
        for row in self.px.chunks(self.width.max(1) as usize).rev() {
            let finite = |&px: &f32| if px.is_nan() { f32::INFINITY } else { px };
            file.extend(row.iter().flat_map(|px| finite(px).to_le_bytes()));
        }
        file
    }

    /// Version 1.0 of NumPy's format.
    pub(super) fn npy(&self) -> Vec<u8> {
        /// The header ends at a multiple of this.
        const ALIGNMENT: usize = 64;
        /// Magic, version and the header's length.
        const PREAMBLE: usize = 10;
        let mut header = format!(
            "{{'descr': '<f4', 'fortran_order': False, 'shape': ({}, {}), }}",
            self.height, self.width
        );
        let end = (PREAMBLE + header.len() + 1).next_multiple_of(ALIGNMENT);
        header.extend(std::iter::repeat_n(' ', end - PREAMBLE - 1 - header.len()));
        header.push('\n');
        let mut file = b"\x93NUMPY\x01\x00".to_vec();
        let length = u16::try_from(header.len()).expect("two numbers and some words are short");
        file.extend(length.to_le_bytes());
        file.extend(header.into_bytes());
        file.extend(self.px.iter().flat_map(|px| px.to_le_bytes()));
        file
    }

    /// The smallest and largest disparity without the tails; zeros if there is none.
    fn ends(&self) -> (f32, f32) {
        let mut valid: Vec<f32> = self.px.iter().copied().filter(|px| !px.is_nan()).collect();
        valid.sort_by(f32::total_cmp);
        let tail = valid.len() / TAIL;
        let at = |rank: usize| valid.get(rank).copied().unwrap_or_default();
        (at(tail), at(valid.len().saturating_sub(1 + tail)))
    }

    fn encode(&self, pixels: &[u8], color: ExtendedColorType) -> Result<Vec<u8>, Failure> {
        let mut file = Cursor::new(Vec::new());
        PngEncoder::new(&mut file)
            .write_image(pixels, self.width, self.height, color)
            .map_err(|why| Failure::failed(format!("the PNG can't be made ({why}): please report it")))?;
        Ok(file.into_inner())
    }
}

#[cfg(test)]
mod tests {
    use super::Map;

    fn map() -> Map {
        Map {
            width: 2,
            height: 2,
            px: vec![1.5, f32::NAN, 0.001, 300.0],
        }
    }

    #[test]
    fn a_png_has_256_steps_a_pixel_and_0_only_where_there_is_none() {
        let file = map().png().unwrap();
        let image = image::load_from_memory(&file).unwrap().into_luma16();
        assert_eq!(image.into_raw(), [384, 0, 1, 65535]);
    }

    #[test]
    fn only_what_has_no_disparity_is_black() {
        let file = map().color_png().unwrap();
        let image = image::load_from_memory(&file).unwrap().into_rgb8();
        let black: Vec<bool> = image.pixels().map(|pixel| pixel.0 == [0; 3]).collect();
        assert_eq!(black, [false, true, false, false]);
    }

    #[test]
    fn a_pfm_begins_with_its_last_row() {
        let file = map().pfm();
        let numbers: Vec<f32> = file[b"Pf\n2 2\n-1.0\n".len()..]
            .as_chunks::<4>()
            .0
            .iter()
            .map(|&bytes| f32::from_le_bytes(bytes))
            .collect();
        assert_eq!(numbers, [0.001, 300.0, 1.5, f32::INFINITY]);
    }

    #[test]
    fn the_numbers_of_an_npy_begin_at_a_multiple_of_64() {
        let file = map().npy();
        assert_eq!(file.len(), 128 + 4 * 4);
        assert_eq!(file[127], b'\n');
        assert!(String::from_utf8_lossy(&file[10..127]).contains("'shape': (2, 2)"));
    }
}
