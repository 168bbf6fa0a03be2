//! Matching at half resolution: each pixel of the small images is the mean of 2 x 2, each disparity found counts twice, for 2 x 2 pixels.

use stereo::{
    DisparityMap, DisparityRange, FIXED_PER_PX, Focus, GrayView, Mesh, MeshParams, Params, Roi, Shape,
    StereoPair,
};

use super::rig::unmatchable;
use crate::status::ServiceError;

/// Both images halved, and what is found in them.
#[derive(Default)]
pub(super) struct Half {
    left: Vec<u8>,
    right: Vec<u8>,
    width_px: usize,
    height_px: usize,
    map: Option<DisparityMap>,
}

impl Half {
    /// Halves both images; a last odd column or row is left out.
    pub(super) fn load(&mut self, left: GrayView<'_>, right: GrayView<'_>) -> Result<(), ServiceError> {
        (self.width_px, self.height_px) = (left.width_px() / 2, left.height_px() / 2);
        shrink(left, &mut self.left);
        shrink(right, &mut self.right);
        let shape = self.shape()?;
        match &mut self.map {
            Some(map) if map.shape() == shape => {}
            Some(map) => map.reset(shape),
            None => self.map = Some(DisparityMap::new(shape)),
        }
        Ok(())
    }

    pub(super) fn shape(&self) -> Result<Shape, ServiceError> {
        Shape::new(self.width_px, self.height_px).map_err(unmatchable)
    }

    pub(super) fn pair_and_map(&mut self) -> Result<(StereoPair<'_>, &mut DisparityMap), ServiceError> {
        let view =
            |data| GrayView::new(data, self.width_px, self.height_px, self.width_px).map_err(unmatchable);
        let pair = StereoPair::new(view(&self.left)?, view(&self.right)?).map_err(unmatchable)?;
        let map = self.map.as_mut();
        let map = map.ok_or_else(|| ServiceError::Internal("half a frame has no map".to_owned()))?;
        Ok((pair, map))
    }

    /// Writes what was found into a map of the images' own size: inside the region of interest, and the disparities that were searched.
    pub(super) fn enlarge_map(&self, params: &Params, full: &mut DisparityMap) {
        let Some(half) = &self.map else { return };
        let shape = full.shape();
        full.reset(shape);
        let roi = params.roi.unwrap_or_else(|| Roi::full(shape));
        let searched = searched_fixed(params.range);
        let (fixed, confidence) = full.parts_mut();
        let columns = roi.x..roi.x + roi.width;
        for y in roi.y..roi.y + roi.height {
            let row = (y / 2).min(self.height_px - 1) * self.width_px;
            let out = y * shape.width_px();
            for x in columns.clone() {
                let at = row + (x / 2).min(self.width_px - 1);
                let doubled = half.fixed()[at].saturating_mul(2);
                if doubled > 0 && searched.contains(&doubled) {
                    (fixed[out + x], confidence[out + x]) = (doubled, half.confidence()[at]);
                }
            }
        }
    }
}

/// The parameters for images of half the size.
pub(super) fn params(full: &Params, half: Shape) -> Params {
    let DisparityRange { min_px, count } = full.range;
    let end_px = (min_px + count).div_ceil(2);
    let halved = |roi: Roi| {
        let (x, y) = (
            (roi.x / 2).min(half.width_px() - 1),
            (roi.y / 2).min(half.height_px() - 1),
        );
        let right = (roi.x + roi.width).div_ceil(2).min(half.width_px());
        let bottom = (roi.y + roi.height).div_ceil(2).min(half.height_px());
        Roi {
            x,
            y,
            width: (right - x).max(1),
            height: (bottom - y).max(1),
        }
    };
    // What reaches over the border by half a pixel could be more than the image together.
    let mut left_px = half.area_px();
    let focus = full.focus.iter().filter_map(|focus| {
        let region = halved(focus.region);
        left_px = left_px.checked_sub(region.area_px())?;
        Some(Focus { region, ..*focus })
    });
    Params {
        range: DisparityRange {
            min_px: min_px / 2,
            count: (end_px - min_px / 2).next_multiple_of(16),
        },
        roi: full.roi.map(halved),
        focus: focus.collect(),
        ..full.clone()
    }
}

/// What is asked of the mesh in the disparities of images of half the size.
pub(super) fn mesh_params(full: &MeshParams) -> MeshParams {
    MeshParams {
        tolerance_px: full.tolerance_px / 2.0,
        max_disparity_step_px: full.max_disparity_step_px / 2.0,
        ..*full
    }
}

/// The mesh in the pixels of the images' own size: a small pixel's centre lies between the four it is the mean of.
pub(super) fn enlarge_mesh(mesh: &mut Mesh) {
    for vertex in &mut mesh.vertices {
        vertex.u = 2.0 * vertex.u + 0.5;
        vertex.v = 2.0 * vertex.v + 0.5;
        vertex.disparity *= 2.0;
    }
}

/// The fixed-point disparities that were asked for.
fn searched_fixed(range: DisparityRange) -> std::ops::RangeInclusive<u16> {
    let fixed = |px: u16| px.saturating_mul(FIXED_PER_PX);
    fixed(range.min_px)..=fixed(range.min_px + range.count - 1)
}

fn shrink(view: GrayView<'_>, out: &mut Vec<u8>) {
    out.clear();
    out.reserve(view.width_px() / 2 * (view.height_px() / 2));
    for y in 0..view.height_px() / 2 {
        let rows = (
            view.row(2 * y).as_chunks::<2>().0,
            view.row(2 * y + 1).as_chunks::<2>().0,
        );
        out.extend(rows.0.iter().zip(rows.1).map(|(upper, lower)| {
            let sum: u16 = [upper[0], upper[1], lower[0], lower[1]]
                .map(u16::from)
                .iter()
                .sum();
            // The rounded mean of bytes is a byte.
            u8::try_from((sum + 2) / 4).unwrap_or(u8::MAX)
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_pixel_is_the_rounded_mean_of_four() {
        let data: Vec<u8> = vec![0, 1, 10, 20, 9, 1, 2, 30, 40, 9, 7, 7, 7, 7, 7];
        let mut out = Vec::new();
        let padded = [data, vec![0; 32 * 40]].concat();
        let view = GrayView::new(&padded, 33, 33, 33).unwrap();
        shrink(view, &mut out);
        assert_eq!(out.len(), 16 * 16);
        let first =
            (u16::from(padded[0]) + u16::from(padded[1]) + u16::from(padded[33]) + u16::from(padded[34]) + 2)
                / 4;
        assert_eq!(u16::from(out[0]), first);
    }

    #[test]
    fn half_the_parameters_cover_the_whole_search_and_region() {
        let half = Shape::new(320, 240).unwrap();
        let full = Params {
            range: DisparityRange { min_px: 5, count: 48 },
            roi: Some(Roi {
                x: 639,
                y: 1,
                width: 1,
                height: 3,
            }),
            ..Params::default()
        };
        let small = params(&full, half);
        assert_eq!(small.range, DisparityRange { min_px: 2, count: 32 });
        assert_eq!(
            small.roi,
            Some(Roi {
                x: 319,
                y: 0,
                width: 1,
                height: 2
            })
        );
        small.validate(half).unwrap();
    }

    #[test]
    fn half_the_regions_to_focus_on_fit_into_half_the_image() {
        let half = Shape::new(320, 240).unwrap();
        let focus = |x, y, width, height| Focus {
            region: Roi { x, y, width, height },
            weight: 3.0,
        };
        let whole_in_two = vec![focus(0, 0, 321, 480), focus(321, 0, 319, 480)];
        let full = Params {
            focus: whole_in_two,
            ..Params::default()
        };
        full.validate(Shape::new(640, 480).unwrap()).unwrap();
        let small = params(&full, half);
        small.validate(half).unwrap();
        assert_eq!(
            small.focus,
            [focus(0, 0, 161, 240)],
            "the column between both is one too many"
        );
        let odd = Params {
            focus: vec![focus(3, 5, 4, 2)],
            ..Params::default()
        };
        assert_eq!(params(&odd, half).focus, [focus(1, 2, 3, 2)]);
    }

    #[test]
    fn the_small_images_mesh_is_as_fine_as_the_large_ones_would_be() {
        let full = MeshParams {
            tolerance_px: 1.5,
            max_disparity_step_px: 6.0,
            max_triangles: 700,
            ..MeshParams::default()
        };
        let half = mesh_params(&full);
        assert_eq!((half.tolerance_px, half.max_disparity_step_px), (0.75, 3.0));
        assert_eq!(half.max_triangles, 700);
    }

    #[test]
    fn what_was_found_is_doubled_inside_the_region_only() {
        let mut half = Half {
            width_px: 32,
            height_px: 32,
            map: Some(DisparityMap::new(Shape::new(32, 32).unwrap())),
            ..Half::default()
        };
        let (fixed, confidence) = half.map.as_mut().unwrap().parts_mut();
        fixed.fill(10 * FIXED_PER_PX);
        confidence.fill(200);
        fixed[0] = 100 * FIXED_PER_PX;
        let mut full = DisparityMap::new(Shape::new(65, 64).unwrap());
        let params = Params {
            roi: Some(Roi {
                x: 0,
                y: 0,
                width: 65,
                height: 10,
            }),
            ..Params::default()
        };
        half.enlarge_map(&params, &mut full);
        assert_eq!(full.disparity_px(0, 0), None, "200 px were not searched");
        assert_eq!(
            full.disparity_px(64, 9),
            Some(20.0),
            "the odd column has its neighbour's"
        );
        assert_eq!(full.confidence()[2], 200);
        assert_eq!(full.disparity_px(5, 10), None, "outside the region");
    }
}
