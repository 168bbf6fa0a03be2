//! What the stages of a frame cost on this machine, learned from every frame.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use stereo::{Density, Params, Preset, Shape};
use stereo_scheduler::Costs;

use crate::job::{DisparityEncoding, FrameOptions, ImageData, ImageEncoding, PixelFormat, ReplyFormat};

/// A stage, with what makes it dearer or cheaper besides the size of the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Stage {
    /// Both images to gray; the number stands for their encodings.
    Decode(u8),
    /// The rung of this index, 0 = base.
    Rung(u8),
    /// Triangulation of the output mesh.
    Mesh,
    /// One body; the number stands for the parts and the disparity encoding of a protobuf result.
    Encode(ReplyFormat, u8),
}

/// Frames whose stages cost about the same for each pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct FrameClass {
    preset: Preset,
    is_dense: bool,
    /// Number of disparities in steps of 16.
    disparity_steps: u16,
    /// Logarithm to base 4 of the area: caches make large images dearer by the pixel.
    area_class: u32,
    area_px: u32,
}

impl FrameClass {
    pub(crate) fn new(shape: Shape, params: &Params) -> Self {
        let area_px = u32::try_from(shape.area_px()).unwrap_or(u32::MAX);
        Self {
            preset: params.preset,
            is_dense: params.density == Density::Dense,
            disparity_steps: params.range.count / 16,
            area_class: area_px.ilog2() / 2,
            area_px,
        }
    }
}

/// The costs of all stages, shared by the workers. A few hundred entries at most: every part of the key is bounded.
#[derive(Debug, Default)]
pub(crate) struct CostBook {
    costs: Mutex<Costs<(FrameClass, Stage)>>,
}

impl CostBook {
    /// A stage of a frame of `class` took `took`.
    pub(crate) fn record(&self, class: FrameClass, stage: Stage, took: Duration) {
        let mut costs = self.costs.lock().unwrap_or_else(PoisonError::into_inner);
        costs.record(key(class, stage), class.area_px, took);
    }

    /// What it will take nearly always; `None` while nothing is known.
    pub(crate) fn tail(&self, class: FrameClass, stage: Stage) -> Option<Duration> {
        let costs = self.costs.lock().unwrap_or_else(PoisonError::into_inner);
        costs.tail(&key(class, stage), class.area_px)
    }
}

/// The area itself is the unit of the work, so it is no part of the key.
fn key(class: FrameClass, stage: Stage) -> (FrameClass, Stage) {
    (FrameClass { area_px: 0, ..class }, stage)
}

/// The decoding of a pair.
pub(crate) fn decode_stage(left: &ImageData, right: &ImageData) -> Stage {
    let code = |image: &ImageData| match image.encoding {
        ImageEncoding::Raw(PixelFormat::Mono8) => 0,
        ImageEncoding::Raw(_) => 1,
        ImageEncoding::Png => 2,
        ImageEncoding::Jpeg => 3,
    };
    Stage::Decode(4 * code(left) + code(right))
}

/// The encoding of one body.
pub(crate) fn encode_stage(format: ReplyFormat, options: &FrameOptions) -> Stage {
    if format != ReplyFormat::Protobuf {
        return Stage::Encode(format, 0);
    }
    let outputs = options.outputs;
    let parts = [
        outputs.disparity,
        outputs.confidence,
        outputs.depth,
        outputs.mesh,
        outputs.points,
    ];
    let bits = parts.iter().fold(0, |bits, &wanted| 2 * bits + u8::from(wanted));
    let encoding = match options.disparity_encoding {
        DisparityEncoding::F32 => 0,
        DisparityEncoding::U16 => 1,
        DisparityEncoding::Png16 => 2,
    };
    Stage::Encode(format, 64 * encoding + bits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_one_class_share_costs_by_the_pixel() {
        let book = CostBook::default();
        let class = |width| FrameClass::new(Shape::new(width, 480).unwrap(), &Params::default());
        book.record(class(640), Stage::Mesh, Duration::from_millis(4));
        let small = book.tail(class(640), Stage::Mesh).unwrap();
        let large = book.tail(class(960), Stage::Mesh).unwrap();
        assert!((large.as_secs_f64() / small.as_secs_f64() - 1.5).abs() < 1e-3);
        assert_eq!(book.tail(class(640), Stage::Rung(0)), None);
    }
}
