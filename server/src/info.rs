//! What the server says about itself.

use serde::Serialize;
use stereo::{Preset, Shape, rung_names};
use utoipa::ToSchema;

use crate::config::Config;

/// The body of `GET /v1/info`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct Info {
    /// `stereod`.
    pub name: &'static str,
    /// The software's version.
    pub version: &'static str,
    /// Name of this server in reports.
    pub instance: String,
    /// Instruction-set level in use.
    pub simd: &'static str,
    /// Threads that compute.
    pub workers: u32,
    /// What is refused before any work is done.
    pub limits: Limits,
    /// Names of algorithm parameters, with the rungs of each ladder from the first result to the best.
    pub presets: Vec<PresetInfo>,
}

/// The limits a client has to keep.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct Limits {
    /// Size of one request's body in bytes.
    pub body_bytes: u64,
    /// Pixels of one image.
    pub image_pixels: u64,
    /// Smallest width and height of an image in pixels.
    pub min_side_px: usize,
    /// Largest width and height of an image in pixels.
    pub max_side_px: usize,
    /// Bodies of all requests under way, in bytes.
    pub bytes_in_flight: u64,
    /// Requests that wait for a worker at one time.
    pub queue_capacity: u32,
    /// Connections open at one time.
    pub connections: u32,
}

/// One preset.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct PresetInfo {
    /// The name that options give.
    pub name: &'static str,
    /// Its rungs, in order.
    pub rungs: Vec<&'static str>,
}

impl Info {
    /// What a server with this configuration says, computing at the level called `simd`.
    #[must_use]
    pub fn new(config: &Config, simd: &'static str) -> Self {
        let preset = |name, preset| PresetInfo {
            name,
            rungs: rung_names(preset),
        };
        Self {
            name: "stereod",
            version: env!("CARGO_PKG_VERSION"),
            instance: config.instance.clone(),
            simd,
            workers: config.workers.count,
            limits: Limits {
                body_bytes: config.limits.body_bytes,
                image_pixels: config.limits.image_pixels,
                min_side_px: Shape::MIN_SIDE_PX,
                max_side_px: Shape::MAX_SIDE_PX,
                bytes_in_flight: config.limits.bytes_in_flight,
                queue_capacity: config.workers.queue_capacity,
                connections: config.http.connections,
            },
            presets: vec![
                preset("default", Preset::Default),
                preset("fast", Preset::Fast),
                preset("paper", Preset::Paper),
            ],
        }
    }
}
