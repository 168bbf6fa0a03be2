//! What each preset does, as data: how supports are found and matched, and the rungs in order.
//!
//! A rung is a publishable result. The paper's `n_iters` is the number of rungs a caller lets run.

use crate::census::Pattern;
use crate::confidence::Curve;
use crate::cost::Window;
use crate::epipolar::{Search, Taps};
use crate::params::Preset;
use crate::support::Consistency;

/// No ladder has more rungs.
pub(crate) const MOST_RUNGS: usize = 8;

/// How the pixels that become support points are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Detector {
    /// The strongest horizontal gradient of each cell.
    StrongestPerCell,
    /// FAST corners, the best of each bin of a 12x10 grid (paper, section III-A).
    FastInBins,
}

/// What is done to get to a rung.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Work {
    /// One iteration of ours: search the strongest (from the second on: the strongest badly explained) pixel of each
    /// cell, insert it into the mesh, validate what changed.
    Mesh {
        /// Side of a cell in px, a power of two.
        cell_px: usize,
        /// Badly explained pixels that make a cell worth a search, from the second iteration on.
        unexplained_px: usize,
    },
    /// Badly explained pixels try their neighbours' disparities.
    Propagate,
    /// Semi-global matching in a band around the mesh at a quarter of the resolution, and around its result at half.
    HalfBand,
    /// The half resolution result tested a pixel to either side at full resolution, what it lost recovered, and smoothed.
    Full,
    /// One iteration of the paper: validate the mesh, keeping for the next iteration the best (C_g) and worst (C_b) pixel
    /// of each cell of the occupancy grid.
    Paper {
        /// Side of an occupancy cell in px (the paper's sz_occ).
        occupancy_px: usize,
    },
}

/// A rung and the way to it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rung {
    pub(crate) name: &'static str,
    pub(crate) work: Work,
    /// Window of the cost evaluation.
    pub(crate) window: Window,
}

/// All constants of a preset.
#[derive(Debug)]
pub(crate) struct Recipe {
    pub(crate) pattern: Pattern,
    pub(crate) detector: Detector,
    pub(crate) search: Search,
    pub(crate) consistency: Option<Consistency>,
    /// Costs (of 250) up to this validate a disparity (the paper's t_hi).
    pub(crate) valid_up_to: u8,
    /// Costs (of 250) below this make a pixel confident (the paper's t_lo).
    pub(crate) confident_below: u8,
    /// Cost of half the full confidence: the border of the confident subset.
    pub(crate) half_confidence_at: u8,
    /// Share of the mask's pixels that are right within 3 px over their mean confidence: set
    /// by hand near what ten KITTI 2012 scenes showed, not fitted, so an ordering more than a probability.
    pub(crate) estimate: Curve,
    pub(crate) rungs: &'static [Rung],
}

const fn mesh(name: &'static str, cell_px: usize, unexplained_px: usize) -> Rung {
    Rung {
        name,
        work: Work::Mesh {
            cell_px,
            unexplained_px,
        },
        window: Window::Side5,
    }
}

const fn paper(name: &'static str, occupancy_px: usize) -> Rung {
    Rung {
        name,
        work: Work::Paper { occupancy_px },
        window: Window::Side5,
    }
}

/// What the presets that start from our mesh have in common.
const MESH: Recipe = Recipe {
    pattern: Pattern::Sparse9x7,
    detector: Detector::StrongestPerCell,
    search: Search {
        taps: Taps::Quincunx,
        max_cost: 0.35,
        uniqueness: 0.72,
        left_right_px: 1,
        subpixel: true,
    },
    consistency: Some(Consistency {
        radius_px: 60,
        tolerance_px: 5.0,
        supporters: 2,
    }),
    valid_up_to: 125,
    confident_below: 62,
    half_confidence_at: 75,
    estimate: &[(0.0, 0.0), (90.0, 0.7), (160.0, 0.87), (254.0, 0.99)],
    rungs: &[mesh("mesh-16", 16, 32)],
};

static DEFAULT: Recipe = Recipe {
    rungs: &[
        mesh("mesh", 16, 32),
        Rung {
            name: "half",
            work: Work::HalfBand,
            window: Window::Side5,
        },
        Rung {
            name: "full",
            work: Work::Full,
            window: Window::Side5,
        },
    ],
    ..MESH
};

static FAST: Recipe = Recipe {
    rungs: &[
        mesh("mesh-16", 16, 32),
        mesh("mesh-8", 8, 20),
        mesh("mesh-4", 4, 8),
        Rung {
            name: "propagate",
            work: Work::Propagate,
            window: Window::Side7,
        },
    ],
    ..MESH
};

static PAPER: Recipe = Recipe {
    pattern: Pattern::Full5x5,
    detector: Detector::FastInBins,
    search: Search {
        taps: Taps::Window5x5,
        max_cost: 0.35,
        // Unpublished: of 0.68 to 0.8, one with which no scene of three data sets loses more than half a point at any rung.
        uniqueness: 0.72,
        left_right_px: 1,
        subpixel: false,
    },
    consistency: None,
    valid_up_to: 125,
    confident_below: 42,
    half_confidence_at: 75,
    estimate: &[(0.0, 0.0), (90.0, 0.7), (160.0, 0.87), (254.0, 0.99)],
    rungs: &[
        paper("grid-32", 32),
        paper("grid-16", 16),
        paper("grid-8", 8),
        paper("grid-4", 4),
        // The paper's grid goes on to 1 px, where the dense map of ETH3D gets worse; it reports four iterations at most.
        paper("grid-2", 2),
    ],
};

impl Recipe {
    /// Whether the views are needed again once their codes and gradients are known.
    pub(crate) fn looks_back(&self) -> bool {
        let looks_back = |rung: &Rung| matches!(rung.work, Work::HalfBand | Work::Paper { .. });
        self.rungs.iter().any(looks_back)
    }

    pub(crate) fn of(preset: Preset) -> &'static Self {
        match preset {
            Preset::Default => &DEFAULT,
            Preset::Fast => &FAST,
            Preset::Paper => &PAPER,
        }
    }
}

/// Names of a preset's rungs without regions to focus on, in order; the first is what `base` publishes. At most 8.
#[must_use]
pub fn rung_names(preset: Preset) -> Vec<&'static str> {
    Recipe::of(preset).rungs.iter().map(|rung| rung.name).collect()
}
