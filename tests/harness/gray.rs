//! 8-bit gray images, and files read as OpenCV's `imread(path, IMREAD_GRAYSCALE)` reads PNG.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use image::DynamicImage;
use stereo::GrayView;

/// An 8-bit gray image, row by row without padding.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GrayImage {
    width_px: usize,
    height_px: usize,
    pixels: Vec<u8>,
}

impl GrayImage {
    /// An image of `width_px` x `height_px`.
    ///
    /// # Errors
    /// If `pixels` doesn't hold `width_px * height_px` bytes.
    pub fn new(width_px: usize, height_px: usize, pixels: Vec<u8>) -> Result<Self> {
        ensure!(
            pixels.len() == width_px * height_px,
            "{width_px} x {height_px} px need {} bytes, got {}",
            width_px * height_px,
            pixels.len()
        );
        Ok(Self {
            width_px,
            height_px,
            pixels,
        })
    }

    /// Reads an image file; colour becomes gray exactly as OpenCV (through libpng) does it.
    ///
    /// # Errors
    /// If the file can't be read or decoded.
    pub fn read(path: &Path) -> Result<Self> {
        let image = image::open(path).with_context(|| format!("can't read the image {}", path.display()))?;
        Self::from_dynamic(&image)
    }

    /// A decoded image as gray; alpha is dropped.
    ///
    /// # Errors
    /// If the image has a pixel type that PNG and JPEG don't have.
    pub fn from_dynamic(image: &DynamicImage) -> Result<Self> {
        let pixels: Vec<u8> = match image {
            DynamicImage::ImageLuma8(gray) => gray.as_raw().clone(),
            DynamicImage::ImageLumaA8(gray) => gray.pixels().map(|p| p.0[0]).collect(),
            DynamicImage::ImageLuma16(gray) => gray.pixels().map(|p| high_byte(p.0[0])).collect(),
            DynamicImage::ImageLumaA16(gray) => gray.pixels().map(|p| high_byte(p.0[0])).collect(),
            DynamicImage::ImageRgb8(rgb) => rgb.pixels().map(|p| luma8(p.0)).collect(),
            DynamicImage::ImageRgba8(rgb) => rgb.pixels().map(|p| luma8([p.0[0], p.0[1], p.0[2]])).collect(),
            DynamicImage::ImageRgb16(rgb) => rgb.pixels().map(|p| luma16(p.0)).collect(),
            DynamicImage::ImageRgba16(rgb) => {
                rgb.pixels().map(|p| luma16([p.0[0], p.0[1], p.0[2]])).collect()
            }
            other => anyhow::bail!("no gray from pixels of type {:?}", other.color()),
        };
        Self::new(
            usize::try_from(image.width())?,
            usize::try_from(image.height())?,
            pixels,
        )
    }

    /// Width in pixels.
    #[must_use]
    pub fn width_px(&self) -> usize {
        self.width_px
    }

    /// Height in pixels.
    #[must_use]
    pub fn height_px(&self) -> usize {
        self.height_px
    }

    /// The pixels, row by row.
    #[must_use]
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// The image as the core takes it.
    #[must_use]
    #[expect(
        clippy::missing_panics_doc,
        reason = "it can't: the constructor has checked the length"
    )]
    pub fn view(&self) -> GrayView<'_> {
        GrayView::new(&self.pixels, self.width_px, self.height_px, self.width_px)
            .expect("the constructor has checked the length")
    }

    /// The image as a PNG file.
    ///
    /// # Errors
    /// If the encoder fails, which it does on images over its own limits only.
    pub fn to_png(&self) -> Result<Vec<u8>> {
        self.encoded(&self.pixels, image::ExtendedColorType::L8)
    }

    /// The image as a PNG file of 16 bits, every gray value times `factor`, at most 65,535.
    ///
    /// # Errors
    /// As [`Self::to_png`].
    pub fn to_png16(&self, factor: u16) -> Result<Vec<u8>> {
        let values = self
            .pixels
            .iter()
            .map(|&gray| u16::from(gray).saturating_mul(factor));
        let bytes: Vec<u8> = values.flat_map(u16::to_ne_bytes).collect();
        self.encoded(&bytes, image::ExtendedColorType::L16)
    }

    fn encoded(&self, bytes: &[u8], color: image::ExtendedColorType) -> Result<Vec<u8>> {
        let mut png = Vec::new();
        image::write_buffer_with_format(
            &mut std::io::Cursor::new(&mut png),
            bytes,
            u32::try_from(self.width_px)?,
            u32::try_from(self.height_px)?,
            color,
            image::ImageFormat::Png,
        )?;
        Ok(png)
    }
}

/// libpng's `png_set_rgb_to_gray(0.299, 0.587)`: 15-bit coefficients, cut off.
fn luma8([r, g, b]: [u8; 3]) -> u8 {
    let sum = 9797 * u32::from(r) + 19234 * u32::from(g) + 3737 * u32::from(b);
    u8::try_from(sum >> 15).expect("the coefficients sum to 1 << 15")
}

/// The same for 16 bits, rounded, then its high byte.
fn luma16([r, g, b]: [u16; 3]) -> u8 {
    let sum = 9797 * u64::from(r) + 19234 * u64::from(g) + 3737 * u64::from(b) + 16384;
    u8::try_from(sum >> 23).expect("the coefficients sum to 1 << 15")
}

fn high_byte(value: u16) -> u8 {
    value.to_be_bytes()[0]
}

#[cfg(test)]
mod tests {
    use super::{GrayImage, luma8, luma16};

    #[test]
    fn a_16_bit_file_holds_the_gray_values_times_the_factor() {
        let image = GrayImage::new(3, 1, vec![0, 17, 255]).expect("3 x 1");
        for (factor, high_bytes) in [(257, [0, 17, 255]), (16, [0, 1, 15])] {
            let png = image.to_png16(factor).expect("a PNG file");
            let read = image::load_from_memory(&png).expect("a PNG file");
            let read = GrayImage::from_dynamic(&read).expect("gray");
            assert_eq!(read.pixels(), high_bytes, "{factor}");
        }
    }

    #[test]
    fn gray_of_colour_is_what_opencv_reads() {
        // Expected values from cv2.imread(.., IMREAD_GRAYSCALE) of a PNG with these pixels, OpenCV 5.0.0.
        for (rgb, gray) in CV2_8_BIT {
            assert_eq!(luma8(*rgb), *gray, "{rgb:?}");
        }
        for (rgb, gray) in CV2_16_BIT {
            assert_eq!(luma16(*rgb), *gray, "{rgb:?}");
        }
    }

    const CV2_8_BIT: &[([u8; 3], u8)] = &[
        ([255, 255, 255], 255),
        ([0, 0, 0], 0),
        ([255, 0, 0], 76),
        ([0, 255, 0], 149),
        ([0, 0, 255], 29),
        ([173, 192, 206], 187),
        ([63, 120, 6], 89),
        ([131, 236, 96], 188),
        ([87, 4, 118], 41),
        ([71, 124, 161], 112),
        ([237, 73, 42], 118),
        ([250, 194, 16], 190),
    ];
    const CV2_16_BIT: &[([u16; 3], u8)] = &[
        ([65535, 65535, 65535], 255),
        ([25124, 30341, 18214], 107),
        ([45874, 37433, 9156], 143),
        ([8589, 13774, 26769], 53),
        ([35508, 2967, 10165], 52),
        ([3195, 25253, 66], 61),
        ([385, 9752, 47248], 43),
        ([12516, 13909, 65482], 75),
    ];
}
