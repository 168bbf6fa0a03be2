//! What a server says about itself. What a newer server says besides is left out.

use serde::{Deserialize, Serialize};

/// The answer of `GET /v1/info`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Info {
    /// The software's version.
    pub version: String,
    /// Name of the server in reports.
    pub instance: String,
    /// Instruction-set level it computes with.
    pub simd: String,
    /// Threads that compute.
    pub workers: u32,
    /// What it refuses before any work.
    pub limits: Limits,
    /// Its presets, with the rungs of each ladder from the first result to the best.
    pub presets: Vec<PresetInfo>,
}

/// The limits a client has to keep.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Limits {
    /// Size of one request's body in bytes.
    pub body_bytes: u64,
    /// Pixels of one image.
    pub image_pixels: u64,
    /// Smallest width and height of an image in pixels.
    pub min_side_px: u32,
    /// Largest width and height of an image in pixels.
    pub max_side_px: u32,
}

/// One preset.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PresetInfo {
    /// The name that options give.
    pub name: String,
    /// Its rungs, in order.
    pub rungs: Vec<String>,
}
