//! Tunable, anytime stereo matching: a valid result early, a better one for every step the caller can afford.
//!
//! The method is that of *High-Performance and Tunable Stereo Reconstruction* (Pillai, Ramalingam, Leonard, ICRA 2016),
//! and what came of measuring it. Instead of searching every pixel's disparity, it searches a few well textured ones,
//! spans a mesh of triangles over them, and asks every pixel whether its triangle's plane explains it. Where it does not,
//! more pixels are searched, the mesh gets finer, and the question is asked again:
//!
//! ```text
//!                left, right (8-bit gray views)
//!                           |
//!   plane      copies with margins, so that nothing has a border case
//!   gradient   Sobel: high-gradient mask (the paper's Omega_I), horizontal strength
//!   census     every pixel's neighbourhood as bits, one byte plane for eight of them
//!                           |
//!        .----> support     which pixels to search: strongest of each cell (paper: FAST corners in bins)
//!        |      epipolar    their disparity: full search, uniqueness, left-right check, sub-pixel
//!        |      triangulation   Delaunay mesh over them, grown in place (spade)
//!        |      interpolate     plane coefficients in disparity space, rasterised: D_it
//!        |      cost        census cost along the planes; the better of old and new is kept: D_f, C_f
//!        |                  |
//!        |      publish     a rung is done: disparity, confidence, quality estimate  ---> caller
//!        |                  |
//!        '----- resample    badly explained pixels of finer cells (paper: C_g and C_b of a halved grid)
//!                           |
//!               propagate   (preset fast) badly explained pixels try their neighbours' disparities
//!               coarse      (preset default) bands of semi-global matching around the mesh, at a quarter and at half of
//!                           the resolution: band, winner, speckle, fill, certainty
//!               upsample, cost, smooth   that result at full resolution, corrected by up to a pixel
//!               recovery    badly explained pixels of that are searched for: what was too thin for half the resolution
//!               surface     the mesh of such a dense result, fitted to its map
//! ```
//!
//! Regions that matter more ([`Focus`]) climb the ladder first, each in a frame of its own.
//!
//! What belongs to which preset is data: `ladder`. A **rung** is a publishable result, a **step** a bounded slice of the
//! work towards the next one. [`Matcher::base`] climbs the first rung, every call of [`Matcher::refine`] does one step.
//! The core knows no clock, no thread and no file: when to stop is the caller's decision, threads are an argument
//! ([`ForkJoin`]), and the same input gives the same bits.
//!
//! **Conventions.** `x` (or `u`) grows to the right, `y` (or `v`) down, pixel centres are whole numbers. Images are
//! rectified: a point at column `x_left` of the left view is at `x_right = x_left - disparity` of the right one, in the
//! same row, and `disparity >= 0`. Disparities are in pixels, in maps in 1/64 px ([`FIXED_PER_PX`]) with 0 for "none".
//!
//! ```
//! use stereo::{DisparityMap, GrayView, Level, Matcher, Params, Progress, Serial, Shape, StereoPair};
//!
//! let (width, height) = (64, 48);
//! let (left, right) = (vec![0u8; width * height], vec![0u8; width * height]);
//! let view = |data| GrayView::new(data, width, height, width);
//! let pair = StereoPair::new(view(&left)?, view(&right)?)?;
//!
//! let shape = Shape::new(width, height)?;
//! let mut matcher = Matcher::new(Level::detect(), shape, Params::default())?;
//! let mut map = DisparityMap::new(shape);
//! let mut progress = matcher.base(pair, &mut map, &Serial)?;
//! while !matches!(progress, Progress::Converged(_)) {
//!     // `map` holds the best result so far: leave whenever there is no time left.
//!     progress = matcher.refine(pair, &mut map, &Serial);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod band;
mod census;
mod certainty;
mod changes;
mod coarse;
mod confidence;
mod convergence;
mod cost;
mod disparity;
mod epipolar;
mod error;
mod fast;
mod fill;
mod fitted;
mod focus;
mod fork_join;
mod frame;
mod gradient;
mod image;
mod interpolate;
mod ladder;
mod marks;
mod matcher;
mod mesh;
mod output_mesh;
mod paper;
mod params;
mod plane;
mod propagate;
mod publish;
mod recovery;
#[cfg(test)]
mod scene;
#[expect(
    unsafe_code,
    reason = "dispatch to detected instruction sets, and their loads and stores"
)]
mod simd;
mod smooth;
mod speckle;
mod support;
mod surface;
mod triangulation;
mod upsample;
mod winner;

pub use disparity::{DisparityMap, FIXED_PER_PX};
pub use error::{MatchError, ParamsError};
pub use focus::Focus;
pub use fork_join::{ForkJoin, Serial};
pub use image::{GrayView, Roi, Shape, StereoPair};
pub use ladder::rung_names;
pub use matcher::{Matcher, Progress, Quality};
pub use mesh::{Mesh, MeshParams, Vertex};
pub use params::{Density, DisparityRange, Params, Preset};
pub use simd::Level;
