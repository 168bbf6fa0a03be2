//! `cargo eval COMMAND`: accuracy and time of the core, in process, beside OpenCV on the same pairs.
//!
//! The scoring protocol is [`stereo_tests::score`]'s. Every method runs on one thread; they take turns, of several runs the
//! fastest counts, and over scenes the median.

mod accuracy;
mod any;
mod anytime;
mod chart;
mod confidence;
mod contest;
mod foveation;
mod frame;
mod kernels;
mod levels;
mod meshes;
mod method;
mod pairs;
mod peers;
mod printed;
mod robustness;
mod rooms;
mod shared_pixels;
mod sizes;
mod source;
mod stages;
mod table;
mod threads;

use anyhow::Result;
use clap::Parser;

use crate::source::Source;

/// Accuracy and time of the core, in process.
#[derive(Debug, Parser)]
enum Command {
    Any(any::Args),
    Stages(stages::Args),
    /// Every preset after every rung beside OpenCV, in three data sets.
    Accuracy(Source),
    /// Every resolution, as the paper's table IV.
    Sizes(Source),
    /// Whole answers at every SIMD level.
    Levels(Source),
    /// Stages at every SIMD level, and the longest step.
    Kernels(Source),
    /// One frame on one thread and on two.
    Threads(Source),
    /// Pairs without ground truth beside SGBM, as the paper's table V.
    Rooms(Source),
    /// Exposure, noise, misalignment, blur, 16 bits, many disparities.
    Robustness(Source),
    /// What every rung brings, and whether any takes something away.
    Anytime(Source),
    /// What `min_confidence` gives and takes.
    Confidence(Source),
    /// Time until a region is done, against its area.
    Foveation(Source),
    /// The mesh that is sent, drawn again from its vertices, against ground truth.
    Meshes(Source),
    /// Our dense result at exactly the pixels that OpenCV returns.
    SharedPixels(Source),
}

fn main() -> Result<()> {
    match Command::parse() {
        Command::Any(args) => any::run(&args),
        Command::Stages(args) => stages::run(&args),
        Command::Accuracy(source) => accuracy::run(&source),
        Command::Sizes(source) => sizes::run(&source),
        Command::Levels(source) => levels::run(&source),
        Command::Kernels(source) => kernels::run(&source),
        Command::Threads(source) => threads::run(&source),
        Command::Rooms(source) => rooms::run(&source),
        Command::Robustness(source) => robustness::run(&source),
        Command::Anytime(source) => anytime::run(&source),
        Command::Confidence(source) => confidence::run(&source),
        Command::Foveation(source) => foveation::run(&source),
        Command::Meshes(source) => meshes::run(&source),
        Command::SharedPixels(source) => shared_pixels::run(&source),
    }
}
