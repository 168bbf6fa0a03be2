//! The contestants: our matcher with each combination of options, and OpenCV's.

use std::cell::RefCell;
use std::rc::Rc;

use anyhow::{Result, bail, ensure};
use stereo::{Density, DisparityRange, Params, Preset};
use stereo_tests::dataset::{LoadedScene, SceneFiles};
use stereo_tests::gray::GrayImage;
use stereo_tests::matching::Bench;

use crate::peers::Peers;

/// A scene as the contestants see it.
pub(crate) struct Views {
    /// Gray as OpenCV reads it, and the ground truth: what is scored, and what the peers get.
    pub(crate) scored: LoadedScene,
    /// Gray as the server reads it: what our matcher gets.
    pub(crate) served: (GrayImage, GrayImage),
}

impl Views {
    pub(crate) fn load(scene: &SceneFiles) -> Result<Self> {
        Ok(Self {
            scored: scene.load()?,
            served: scene.load_as_served()?,
        })
    }
}

/// Options of one row of ours.
pub(crate) struct Method {
    name: String,
    params: Params,
    rungs: u8,
}

impl Method {
    pub(crate) fn new(preset: &str, density: &str, rungs: u8, min_confidence: f32) -> Result<Self> {
        let confidence = if min_confidence > 0.0 {
            format!(" conf {min_confidence}")
        } else {
            String::new()
        };
        let name = format!("stereod {preset} {rungs} it {density}{confidence}");
        let preset = match preset {
            "default" => Preset::Default,
            "fast" => Preset::Fast,
            "paper" => Preset::Paper,
            other => bail!("there is no preset {other}: use default, fast or paper"),
        };
        let density = match density {
            "semi_dense" => Density::SemiDense,
            "dense" => Density::Dense,
            other => bail!("there is no density {other}: use semi_dense or dense"),
        };
        ensure!(rungs > 0, "--iterations counts the first one: it is at least 1");
        ensure!(
            (0.0..=1.0).contains(&min_confidence),
            "--min-confidence must be 0 to 1, got {min_confidence}"
        );
        Ok(Self {
            name,
            params: Params {
                preset,
                density,
                min_confidence,
                ..Params::default()
            },
            rungs,
        })
    }
}

/// A row of the table.
pub(crate) enum Contestant {
    /// Our matcher; the bench is kept from scene to scene, as a server's worker keeps its own.
    Ours {
        method: Box<Method>,
        bench: Option<Box<Bench>>,
    },
    /// One of OpenCV's.
    Peer {
        name: String,
        process: Rc<RefCell<Peers>>,
    },
}

/// The fastest run of one contestant on one scene.
pub(crate) struct Run {
    /// Disparity of every pixel in px; NaN or <= 0 where there is none.
    pub(crate) disparity_px: Vec<f32>,
    /// Matching alone: ours by the clock, on one thread; peers by the process's CPU time.
    pub(crate) match_ms: f64,
    /// The same call by the clock.
    pub(crate) wall_ms: f64,
}

impl Contestant {
    pub(crate) fn name(&self) -> String {
        match self {
            Self::Ours { method, .. } => method.name.clone(),
            Self::Peer { name, process } => format!("OpenCV {} {name}", process.borrow().opencv_version()),
        }
    }

    pub(crate) fn best_of(&mut self, repeat: u32, views: &Views, disparities: u16) -> Result<Run> {
        match self {
            Self::Ours { method, bench } => {
                let (left, right) = &views.served;
                let mut params = method.params.clone();
                params.range = DisparityRange {
                    min_px: 0,
                    count: disparities,
                };
                let bench = match bench {
                    Some(bench) => {
                        bench.reconfigure(left, params)?;
                        bench
                    }
                    None => bench.insert(Box::new(Bench::new(left, params)?)),
                };
                let mut best = bench.run(left, right, method.rungs)?;
                for _ in 1..repeat {
                    let again = bench.run(left, right, method.rungs)?;
                    if again.elapsed < best.elapsed {
                        best = again;
                    }
                }
                let ms = 1e3 * best.elapsed.as_secs_f64();
                Ok(Run {
                    disparity_px: best.disparity_px,
                    match_ms: ms,
                    wall_ms: ms,
                })
            }
            Self::Peer { name, process } => process.borrow_mut().best_of(
                name,
                repeat,
                &views.scored.left,
                &views.scored.right,
                disparities,
            ),
        }
    }
}
