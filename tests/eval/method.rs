//! The contestants: our matcher with each combination of options, and OpenCV's.

use std::cell::RefCell;
use std::path::Path;
use std::rc::Rc;

use anyhow::{Context, Result, bail};
use stereo::{Density, DisparityRange, Level, Params, Preset, rung_names};
use stereo_tests::dataset::{LoadedScene, SceneFiles};
use stereo_tests::gray::GrayImage;
use stereo_tests::matching::{Bench, Matched};

use crate::peers::Peers;

/// A scene as the contestants see it.
pub(crate) struct Views {
    pub(crate) name: String,
    /// Gray as OpenCV reads it, and the ground truth: what is scored, and what the peers get.
    pub(crate) scored: LoadedScene,
    /// Gray as the server reads it: what our matcher gets.
    pub(crate) served: (GrayImage, GrayImage),
}

impl Views {
    pub(crate) fn load(scene: &SceneFiles) -> Result<Self> {
        Ok(Self {
            name: scene.name.clone(),
            scored: scene.load()?,
            served: scene.load_as_served()?,
        })
    }
}

/// The preset of this name.
pub(crate) fn preset(name: &str) -> Result<Preset> {
    Ok(match name {
        "default" => Preset::Default,
        "fast" => Preset::Fast,
        "paper" => Preset::Paper,
        other => bail!("there is no preset {other}: use default, fast or paper"),
    })
}

/// The density of this name.
pub(crate) fn density(name: &str) -> Result<Density> {
    Ok(match name {
        "semi_dense" => Density::SemiDense,
        "dense" => Density::Dense,
        other => bail!("there is no density {other}: use semi_dense or dense"),
    })
}

/// The SIMD level of this name, if this machine has it.
pub(crate) fn level(name: &str) -> Result<Level> {
    let available = Level::available();
    let found = available.iter().find(|level| level.name() == name);
    found.copied().with_context(|| {
        let names: Vec<_> = available.iter().map(|level| level.name()).collect();
        format!(
            "this machine has no SIMD level {name}: it has {}",
            names.join(", ")
        )
    })
}

/// How many rungs a preset's whole ladder has.
pub(crate) fn ladder_length(preset: Preset) -> u8 {
    u8::try_from(rung_names(preset).len()).expect("a ladder has at most 8 rungs")
}

/// A preset's name.
pub(crate) fn preset_name(preset: Preset) -> &'static str {
    match preset {
        Preset::Default => "default",
        Preset::Fast => "fast",
        Preset::Paper => "paper",
    }
}

/// Options of one row of ours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Method {
    pub(crate) preset: Preset,
    pub(crate) density: Density,
    /// Rungs to climb at most, 1..
    pub(crate) rungs: u8,
    pub(crate) min_confidence: f32,
}

impl Method {
    /// `rungs` rungs of `preset`, semi-dense, of any confidence.
    pub(crate) fn new(preset: Preset, rungs: u8) -> Self {
        Self {
            preset,
            density: Density::SemiDense,
            rungs,
            min_confidence: 0.0,
        }
    }

    pub(crate) fn dense(self) -> Self {
        Self {
            density: Density::Dense,
            ..self
        }
    }

    pub(crate) fn confident(self, min_confidence: f32) -> Self {
        Self {
            min_confidence,
            ..self
        }
    }

    /// The name that the scripts outside of this repository use too.
    pub(crate) fn name(&self) -> String {
        let density = match self.density {
            Density::SemiDense => "semi_dense",
            Density::Dense => "dense",
        };
        let confidence = if self.min_confidence > 0.0 {
            format!(" conf {}", self.min_confidence)
        } else {
            String::new()
        };
        let preset = preset_name(self.preset);
        format!("stereod {preset} {} it {density}{confidence}", self.rungs)
    }

    /// The rows' short name: preset, rungs and the last one's name.
    pub(crate) fn short_name(&self) -> String {
        let names = rung_names(self.preset);
        let last = usize::from(self.rungs).min(names.len()) - 1;
        format!("{} {} ({})", preset_name(self.preset), self.rungs, names[last])
    }

    /// The parameters for so many disparities.
    pub(crate) fn params(&self, disparities: u16) -> Params {
        Params {
            preset: self.preset,
            density: self.density,
            min_confidence: self.min_confidence,
            range: DisparityRange {
                min_px: 0,
                count: disparities,
            },
            ..Params::default()
        }
    }
}

/// One that takes part.
pub(crate) enum Contestant {
    /// Our matcher; the bench is kept from scene to scene, as a server's worker keeps its own.
    Ours {
        method: Method,
        level: Level,
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
    /// The quality estimates of the rungs; none for a peer.
    pub(crate) estimates: Vec<f32>,
    /// Matching alone: ours by the clock, on one thread; peers by the process's CPU time.
    pub(crate) match_ms: f64,
    /// The same call by the clock.
    pub(crate) wall_ms: f64,
}

impl Contestant {
    /// Ours at this machine's best level.
    pub(crate) fn ours(method: Method) -> Self {
        Self::at_level(method, Level::detect())
    }

    pub(crate) fn at_level(method: Method, level: Level) -> Self {
        Self::Ours {
            method,
            level,
            bench: None,
        }
    }

    /// Some of OpenCV's: `sgbm`, `3way`, `bm`. `python` must have OpenCV.
    pub(crate) fn peers(python: &Path, names: &[&str]) -> Result<Vec<Self>> {
        if names.is_empty() {
            return Ok(Vec::new());
        }
        let process = Peers::start(python)?;
        let peer = |name: &&str| Self::Peer {
            name: (*name).to_owned(),
            process: process.clone(),
        };
        Ok(names.iter().map(peer).collect())
    }

    pub(crate) fn name(&self) -> String {
        match self {
            Self::Ours { method, .. } => method.name(),
            Self::Peer { name, process } => format!("OpenCV {} {name}", process.borrow().opencv_version()),
        }
    }

    /// The fastest of `repeat` runs.
    pub(crate) fn best_of(&mut self, repeat: u32, views: &Views, disparities: u16) -> Result<Run> {
        match self {
            Self::Ours { method, level, bench } => {
                let (left, right) = &views.served;
                let params = method.params(disparities);
                let bench = match bench {
                    Some(bench) => {
                        bench.reconfigure(left, params)?;
                        bench
                    }
                    None => bench.insert(Box::new(Bench::at_level(*level, left, params)?)),
                };
                let mut best = bench.run(left, right, method.rungs)?;
                for _ in 1..repeat {
                    let again = bench.run(left, right, method.rungs)?;
                    if again.elapsed < best.elapsed {
                        best = again;
                    }
                }
                Ok(best.into())
            }
            Self::Peer { name, process } => process.borrow_mut().best_of(
                name,
                repeat,
                (&views.scored.left, &views.scored.right),
                disparities,
            ),
        }
    }
}

impl From<Matched> for Run {
    fn from(matched: Matched) -> Self {
        let ms = 1e3 * matched.elapsed.as_secs_f64();
        Self {
            disparity_px: matched.disparity_px,
            estimates: matched.rungs.iter().map(|quality| quality.estimate).collect(),
            match_ms: ms,
            wall_ms: ms,
        }
    }
}
