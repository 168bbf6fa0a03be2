//! Rows of pixels to gray and to RGB, by integer arithmetic that the compiler vectorises.

use crate::job::PixelFormat;

/// How a row of bytes holds its pixels: the raw formats, and the one more that PNG files have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Layout {
    /// One of the raw formats.
    Raw(PixelFormat),
    /// 8-bit gray and alpha.
    GrayAlpha8,
}

impl Layout {
    /// Bytes of one pixel (of half a pair for YUYV).
    pub(super) fn bytes_per_px(self) -> usize {
        match self {
            Self::Raw(PixelFormat::Mono8) => 1,
            Self::Raw(PixelFormat::Mono16 | PixelFormat::Yuyv) | Self::GrayAlpha8 => 2,
            Self::Raw(PixelFormat::Rgb8 | PixelFormat::Bgr8) => 3,
            Self::Raw(PixelFormat::Rgba8 | PixelFormat::Bgra8) => 4,
        }
    }

    /// Writes `row` as 8-bit gray. Colours become BT.601 luma, 16-bit values keep their upper byte, alpha is ignored,
    /// and YUYV keeps its luma as it is. `row` holds at least `gray.len()` pixels.
    pub(super) fn write_gray(self, row: &[u8], gray: &mut [u8]) {
        match self {
            Self::Raw(PixelFormat::Mono8) => gray.copy_from_slice(&row[..gray.len()]),
            Self::Raw(PixelFormat::Mono16) => pick::<2, 1>(row, gray),
            Self::Raw(PixelFormat::Yuyv) | Self::GrayAlpha8 => pick::<2, 0>(row, gray),
            Self::Raw(PixelFormat::Rgb8) => luma_row::<3, 0, 2>(row, gray),
            Self::Raw(PixelFormat::Bgr8) => luma_row::<3, 2, 0>(row, gray),
            Self::Raw(PixelFormat::Rgba8) => luma_row::<4, 0, 2>(row, gray),
            Self::Raw(PixelFormat::Bgra8) => luma_row::<4, 2, 0>(row, gray),
        }
    }

    /// Writes `row` as RGB, three bytes a pixel; gray is repeated, YUYV is taken as BT.601 video range. `row` holds at
    /// least `rgb.len() / 3` pixels.
    pub(super) fn write_rgb(self, row: &[u8], rgb: &mut [u8]) {
        match self {
            Self::Raw(PixelFormat::Mono8) => repeat::<1, 0>(row, rgb),
            Self::Raw(PixelFormat::Mono16) => repeat::<2, 1>(row, rgb),
            Self::GrayAlpha8 => repeat::<2, 0>(row, rgb),
            Self::Raw(PixelFormat::Yuyv) => rgb_from_yuyv(row, rgb),
            Self::Raw(PixelFormat::Rgb8) => rgb.copy_from_slice(&row[..rgb.len()]),
            Self::Raw(PixelFormat::Bgr8) => reorder::<3, 2, 0>(row, rgb),
            Self::Raw(PixelFormat::Rgba8) => reorder::<4, 0, 2>(row, rgb),
            Self::Raw(PixelFormat::Bgra8) => reorder::<4, 2, 0>(row, rgb),
        }
    }
}

/// Byte `AT` of every `N`.
fn pick<const N: usize, const AT: usize>(row: &[u8], gray: &mut [u8]) {
    for (pixel, out) in row.as_chunks::<N>().0.iter().zip(gray) {
        *out = pixel[AT];
    }
}

/// BT.601 luma of pixels of `N` bytes with red at `R`, green at 1 and blue at `B`.
fn luma_row<const N: usize, const R: usize, const B: usize>(row: &[u8], gray: &mut [u8]) {
    for (pixel, out) in row.as_chunks::<N>().0.iter().zip(gray) {
        *out = luma(pixel[R], pixel[1], pixel[B]);
    }
}

/// `0.299 R + 0.587 G + 0.114 B` in 1/256; within 1 of the exact value, and exact for grays. Fits 16 bits, which
/// doubles the vector width.
fn luma(r: u8, g: u8, b: u8) -> u8 {
    let sum = 77 * u16::from(r) + 150 * u16::from(g) + 29 * u16::from(b) + 128;
    sum.to_be_bytes()[0]
}

/// Byte `AT` of every `N`, three times.
fn repeat<const N: usize, const AT: usize>(row: &[u8], rgb: &mut [u8]) {
    for (pixel, out) in row.as_chunks::<N>().0.iter().zip(rgb.as_chunks_mut::<3>().0) {
        *out = [pixel[AT]; 3];
    }
}

/// Bytes `R`, 1 and `B` of every `N`.
fn reorder<const N: usize, const R: usize, const B: usize>(row: &[u8], rgb: &mut [u8]) {
    for (pixel, out) in row.as_chunks::<N>().0.iter().zip(rgb.as_chunks_mut::<3>().0) {
        *out = [pixel[R], pixel[1], pixel[B]];
    }
}

/// BT.601 video range (luma 16..=235, chroma 16..=240) in 1/256.
fn rgb_from_yuyv(row: &[u8], rgb: &mut [u8]) {
    let clamp = |value: i32| u8::try_from(value.clamp(0, 255)).unwrap_or(u8::MAX);
    for ([y0, u, y1, v], out) in row.as_chunks::<4>().0.iter().zip(rgb.as_chunks_mut::<6>().0) {
        let (u, v) = (i32::from(*u) - 128, i32::from(*v) - 128);
        for (y, pixel) in [y0, y1].into_iter().zip(out.as_chunks_mut::<3>().0) {
            let y = 298 * (i32::from(*y) - 16) + 128;
            *pixel = [
                clamp((y + 409 * v) >> 8),
                clamp((y - 100 * u - 208 * v) >> 8),
                clamp((y + 516 * u) >> 8),
            ];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Layout;
    use crate::job::PixelFormat;

    fn gray(layout: Layout, row: &[u8]) -> Vec<u8> {
        let mut out = vec![0; row.len() / layout.bytes_per_px()];
        layout.write_gray(row, &mut out);
        out
    }

    fn rgb(layout: Layout, row: &[u8]) -> Vec<u8> {
        let mut out = vec![0; row.len() / layout.bytes_per_px() * 3];
        layout.write_rgb(row, &mut out);
        out
    }

    #[test]
    fn luma_is_within_one_of_bt601_for_every_colour_of_a_fine_grid() {
        for r in (0..=255).step_by(5) {
            for g in (0..=255).step_by(5) {
                for b in (0..=255).step_by(5) {
                    let exact = 0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b);
                    let got = f64::from(super::luma(r, g, b));
                    assert!((got - exact).abs() <= 1.0, "{r} {g} {b}: {got} for {exact}");
                }
            }
        }
        for value in 0..=255 {
            assert_eq!(super::luma(value, value, value), value);
        }
    }

    #[test]
    fn the_four_colour_orders_agree_and_alpha_is_ignored() {
        let expected = gray(Layout::Raw(PixelFormat::Rgb8), &[200, 30, 90, 1, 2, 250]);
        assert_eq!(
            gray(Layout::Raw(PixelFormat::Bgr8), &[90, 30, 200, 250, 2, 1]),
            expected
        );
        assert_eq!(
            gray(Layout::Raw(PixelFormat::Rgba8), &[200, 30, 90, 7, 1, 2, 250, 0]),
            expected
        );
        assert_eq!(
            gray(Layout::Raw(PixelFormat::Bgra8), &[90, 30, 200, 9, 250, 2, 1, 255]),
            expected
        );
        let colours = vec![200, 30, 90, 1, 2, 250];
        assert_eq!(
            rgb(Layout::Raw(PixelFormat::Bgr8), &[90, 30, 200, 250, 2, 1]),
            colours
        );
        assert_eq!(
            rgb(Layout::Raw(PixelFormat::Rgba8), &[200, 30, 90, 7, 1, 2, 250, 0]),
            colours
        );
        assert_eq!(
            rgb(Layout::Raw(PixelFormat::Bgra8), &[90, 30, 200, 9, 250, 2, 1, 255]),
            colours
        );
    }

    #[test]
    fn sixteen_bit_gray_keeps_its_upper_byte() {
        let row: Vec<u8> = [0x0000_u16, 0x00ff, 0x0100, 0xabcd, 0xffff]
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        assert_eq!(
            gray(Layout::Raw(PixelFormat::Mono16), &row),
            [0, 0, 1, 0xab, 0xff]
        );
        assert_eq!(&rgb(Layout::Raw(PixelFormat::Mono16), &row)[9..12], [0xab; 3]);
    }

    #[test]
    fn yuyv_keeps_its_luma_and_has_the_colours_of_video_range() {
        let row = [16, 128, 235, 128, 81, 90, 145, 240];
        assert_eq!(gray(Layout::Raw(PixelFormat::Yuyv), &row), [16, 235, 81, 145]);
        let colours = rgb(Layout::Raw(PixelFormat::Yuyv), &row);
        assert_eq!(&colours[..6], [0, 0, 0, 255, 255, 255]);
        assert!(
            colours[6] >= 253 && colours[7] <= 2 && colours[8] <= 2,
            "pure red, got {:?}",
            &colours[6..9]
        );
    }
}
