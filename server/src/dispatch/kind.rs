//! What a frame's stages are like, for the scheduler's cost model: stages of one kind cost about the same for each pixel.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::time::{Duration, Instant};

use stereo::{Density, Params, Preset, Roi, Shape, rung_names};
use stereo_scheduler::{ClientId, JobSpec, StreamId, Urgency, Work};

use crate::job::{
    Compression, DisparityEncoding, FrameOptions, FrameRequest, ImageData, ImageEncoding, PixelFormat,
    ReplyFormat,
};

/// Kind of a stage. Every part of it is bounded, so there are a few hundred in practice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Kind {
    /// Both images to gray.
    Decode {
        /// Stands for their encodings.
        codecs: u8,
        /// Size class of the images.
        size: u32,
        /// Whether they are then halved; units are pixels of the halved images.
        is_half: bool,
    },
    /// The rungs.
    Match {
        /// Ladder.
        preset: Preset,
        /// Whether every pixel is wanted.
        is_dense: bool,
        /// Disparities in steps of 16.
        disparity_steps: u16,
        /// How small the region of interest is, as powers of two of the image.
        roi: u32,
        /// Regions that come first: rungs they take, and what part of the image they are.
        focus: FocusClass,
        /// Size class of the matched images.
        size: u32,
        /// Whether others help with it, which makes it cheaper as long as they do.
        is_split: bool,
    },
    /// Triangulation of the output mesh.
    Mesh {
        /// Ladder.
        preset: Preset,
        /// How small the region of interest is.
        roi: u32,
        /// Size class of the matched images.
        size: u32,
        /// Logarithm to base 4 of the triangles it may have.
        budget: u32,
    },
    /// All bodies.
    Encode {
        /// Formats, one bit each.
        formats: u16,
        /// Parts, encoding and compression of a protobuf result.
        result: u16,
        /// Size class of the images.
        size: u32,
        /// Whether the matched images were halved; units are their pixels.
        is_half: bool,
    },
}

impl stereo_scheduler::Kind for Kind {
    fn distance(&self, other: &Self) -> Option<u32> {
        let apart = |is_apart: bool, by: u32| if is_apart { by } else { 0 };
        match (*self, *other) {
            (
                Self::Decode {
                    codecs,
                    size,
                    is_half,
                },
                Self::Decode {
                    codecs: other,
                    size: other_size,
                    is_half: other_half,
                },
            ) => Some(
                codecs_apart(codecs, other) + size.abs_diff(other_size) + apart(is_half != other_half, 50),
            ),
            (
                Self::Match {
                    preset,
                    is_dense,
                    disparity_steps,
                    roi,
                    focus,
                    size,
                    is_split,
                },
                Self::Match {
                    preset: other_preset,
                    is_dense: other_dense,
                    disparity_steps: other_steps,
                    roi: other_roi,
                    focus: other_focus,
                    size: other_size,
                    is_split: other_split,
                },
            ) => Some(
                apart(preset != other_preset, 1000)
                    + apart(is_split != other_split, 100)
                    + focus.distance(other_focus)
                    + 10 * roi.abs_diff(other_roi)
                    + apart(is_dense != other_dense, 10)
                    + 2 * u32::from(disparity_steps.abs_diff(other_steps))
                    + size.abs_diff(other_size),
            ),
            (
                Self::Mesh {
                    preset,
                    roi,
                    size,
                    budget,
                },
                Self::Mesh {
                    preset: other_preset,
                    roi: other_roi,
                    size: other_size,
                    budget: other_budget,
                },
            ) => Some(
                apart(preset != other_preset, 100)
                    + 10 * roi.abs_diff(other_roi)
                    + 5 * budget.abs_diff(other_budget)
                    + size.abs_diff(other_size),
            ),
            (
                Self::Encode {
                    formats,
                    result,
                    size,
                    is_half,
                },
                Self::Encode {
                    formats: other_formats,
                    result: other_result,
                    size: other_size,
                    is_half: other_half,
                },
            ) => Some(
                1000 * (formats ^ other_formats).count_ones()
                    + 50 * (result ^ other_result).count_ones()
                    + apart(is_half != other_half, 20)
                    + size.abs_diff(other_size),
            ),
            _ => None,
        }
    }
}

/// Regions that a frame is to be matched in first, as far as costs go.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub(crate) struct FocusClass {
    /// Rungs they take.
    rungs: u8,
    /// How small they are together, as powers of two of the image; 0 = all of it, or none.
    area: u8,
}

impl FocusClass {
    /// Of `image_px` pixels.
    fn of(params: &Params, rungs: u8, image_px: u32) -> Self {
        let area: usize = params.focus.iter().map(|focus| focus.region.area_px()).sum();
        let area = match u32::try_from(area).unwrap_or(u32::MAX) {
            0 => 0,
            area => (image_px / area).max(1).ilog2(),
        };
        Self {
            rungs,
            area: u8::try_from(area).unwrap_or(u8::MAX),
        }
    }

    fn distance(self, other: Self) -> u32 {
        50 * u32::from(self.rungs.abs_diff(other.rungs)) + 10 * u32::from(self.area.abs_diff(other.area))
    }
}

/// How unlike two pairs of encodings are to decode: compressed and raw images very much, PNG and JPEG a little.
fn codecs_apart(one: u8, other: u8) -> u32 {
    let image = |one: u8, other: u8| match (one, other) {
        (one, other) if one == other => 0,
        (0..=1, 2..) | (2.., 0..=1) => 1000,
        _ => 100,
    };
    image(one / 4, other / 4) + image(one % 4, other % 4)
}

/// A request as the scheduler knows it; `time` turns moments into the scheduler's.
pub(super) fn spec(request: &FrameRequest, weight: u32, time: impl Fn(Instant) -> Duration) -> JobSpec<Kind> {
    let is_stream = request.ids.sequence.is_some() && !request.ids.camera_id.is_empty();
    JobSpec {
        client: ClientId(hashed(&request.client)),
        weight,
        stream: is_stream.then(|| StreamId(hashed(&request.ids.camera_id))),
        urgency: match request.deadline() {
            Some(deadline) => Urgency::Deadline {
                at: time(deadline),
                priority: super::priority(request.options.priority),
            },
            None => Urgency::Background,
        },
        work: work(request, false),
        half: can_be_halved(request).then(|| work(request, true)),
        is_mesh_optional: request.options.outputs.mesh_is_optional
            && !request.formats.iter().any(|format| format.needs_mesh()),
    }
}

/// Makes a job one that others help with. Its costs are learned apart: what is known of a worker alone stays true when all are busy.
pub(super) fn split(spec: &mut JobSpec<Kind>) {
    let ways = [Some(&mut spec.work), spec.half.as_mut()];
    for work in ways.into_iter().flatten() {
        if let Kind::Match { is_split, .. } = &mut work.matching {
            *is_split = true;
        }
    }
}

/// The stages of a request.
pub(crate) fn work(request: &FrameRequest, is_half: bool) -> Work<Kind> {
    let options = &request.options;
    let params = &options.params;
    let area = |width_px: u32, height_px: u32| width_px.max(1).saturating_mul(height_px.max(1));
    let (width_px, height_px) = (request.left.width_px, request.left.height_px);
    let image = area(width_px, height_px);
    let units = if is_half {
        area(width_px / 2, height_px / 2)
    } else {
        image
    };
    let roi = roi_class(params.roi, image);
    let (size, image_size) = (size_class(units), size_class(image));
    let disparities = if is_half {
        params.range.count / 2
    } else {
        params.range.count
    };
    let rungs = |names: Vec<&str>| u8::try_from(names.len()).unwrap_or(u8::MAX);
    let ladder = rungs(params.rung_names());
    let focus_rungs = ladder - rungs(rung_names(params.preset));
    Work {
        units,
        decode: Kind::Decode {
            codecs: 4 * codec(&request.left) + codec(&request.right),
            size: image_size,
            is_half,
        },
        matching: Kind::Match {
            preset: params.preset,
            is_dense: params.density == Density::Dense,
            disparity_steps: disparities.div_ceil(16),
            roi,
            focus: FocusClass::of(params, focus_rungs, image),
            size,
            is_split: false,
        },
        mesh: wants_mesh(request).then_some(Kind::Mesh {
            preset: params.preset,
            roi,
            size,
            budget: size_class(options.mesh.max_triangles),
        }),
        encode: encode_kind(&request.formats, options, image_size, is_half),
        rungs: options.max_iterations.unwrap_or(ladder).min(ladder),
    }
}

/// The least that any request can ask for: the first rung of the smallest images, and no mesh.
pub(crate) fn least_work() -> Work<Kind> {
    let side = u32::try_from(Shape::MIN_SIDE_PX).unwrap_or(1);
    let units = side * side;
    let size = size_class(units);
    let params = Params::default();
    Work {
        units,
        decode: Kind::Decode {
            codecs: 0,
            size,
            is_half: false,
        },
        matching: Kind::Match {
            preset: params.preset,
            is_dense: false,
            disparity_steps: params.range.count / 16,
            roi: 0,
            focus: FocusClass::default(),
            size,
            is_split: false,
        },
        mesh: None,
        encode: encode_kind(
            &[ReplyFormat::DisparityPng],
            &FrameOptions::default(),
            size,
            false,
        ),
        rungs: 1,
    }
}

/// The encoding of these bodies.
pub(crate) fn encode_kind(formats: &[ReplyFormat], options: &FrameOptions, size: u32, is_half: bool) -> Kind {
    let bit = |format: &ReplyFormat| match format {
        ReplyFormat::Protobuf => 1,
        ReplyFormat::Json => 2,
        ReplyFormat::DisparityPng => 4,
        ReplyFormat::ColorPng => 8,
        ReplyFormat::Glb => 16,
        ReplyFormat::Ply => 32,
        ReplyFormat::DisparityPart => 64,
        ReplyFormat::MeshPart => 128,
        ReplyFormat::StreamView => 256,
        // Costs next to nothing.
        ReplyFormat::ReportPart => 0,
    };
    let is_result = |format: &ReplyFormat| {
        matches!(
            format,
            ReplyFormat::Protobuf | ReplyFormat::DisparityPart | ReplyFormat::MeshPart
        )
    };
    let result = if formats.iter().any(is_result) {
        result_code(options)
    } else {
        0
    };
    Kind::Encode {
        formats: formats.iter().map(bit).fold(0, |bits, bit| bits | bit),
        result,
        size,
        is_half,
    }
}

/// What of a protobuf result makes it dearer or cheaper.
fn result_code(options: &FrameOptions) -> u16 {
    let outputs = options.outputs;
    let parts = [
        outputs.disparity,
        outputs.confidence,
        outputs.depth,
        outputs.mesh,
        outputs.points,
        outputs.colors,
    ];
    let bits = parts.iter().fold(0, |bits, &wanted| 2 * bits + u16::from(wanted));
    let encoding = match options.disparity_encoding {
        DisparityEncoding::F32 => 0,
        DisparityEncoding::U16 => 1,
        DisparityEncoding::Png16 => 2,
    };
    let compression = match options.compression {
        Compression::None => 0,
        Compression::Zstd => 1,
        Compression::Lz4 => 2,
    };
    bits + 64 * (encoding + 4 * compression)
}

/// Whether any body of the reply has the mesh in it.
fn wants_mesh(request: &FrameRequest) -> bool {
    let in_result = request.options.outputs.mesh;
    request.formats.iter().any(|&format| match format {
        ReplyFormat::Protobuf => in_result,
        ReplyFormat::StreamView => true,
        _ => format.needs_mesh(),
    })
}

/// Whether the client allows it and the halved images are not too small.
fn can_be_halved(request: &FrameRequest) -> bool {
    let least = 2 * Shape::MIN_SIDE_PX;
    let is_large = |px: u32| px as usize >= least;
    request.options.allow_downscale && is_large(request.left.width_px) && is_large(request.left.height_px)
}

/// Logarithm of the area: caches make large images dearer by the pixel.
pub(super) fn size_class(area_px: u32) -> u32 {
    area_px.max(1).ilog2()
}

fn roi_class(roi: Option<Roi>, image_px: u32) -> u32 {
    roi.map_or(0, |roi| {
        let area = u32::try_from(roi.width * roi.height).unwrap_or(u32::MAX);
        (image_px / area.max(1)).max(1).ilog2()
    })
}

fn codec(image: &ImageData) -> u8 {
    match image.encoding {
        ImageEncoding::Raw(PixelFormat::Mono8) => 0,
        ImageEncoding::Raw(_) => 1,
        ImageEncoding::Png => 2,
        ImageEncoding::Jpeg => 3,
    }
}

fn hashed(name: &str) -> u64 {
    let mut hasher = DefaultHasher::new();
    name.hash(&mut hasher);
    hasher.finish()
}

#[cfg(test)]
mod tests;
