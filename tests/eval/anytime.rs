//! `cargo eval anytime`: what every rung brings, and whether any takes something away.

use std::fmt::Write as _;

use anyhow::Result;
use stereo::Preset;
use stereo_tests::dataset::LoadedScene;
use stereo_tests::render::RenderedPair;
use stereo_tests::scene::Scene;
use stereo_tests::score::score;

use crate::contest::{Turns, take_turns};
use crate::method::{Contestant, Method, Views, ladder_length, preset_name};
use crate::source::{DISPARITIES, Document, ETH3D, KITTI, MIDDLEBURY, Source};

/// What may be lost in one real scene from a rung to the next, in points of all <3 px, and in a rendered one.
const REAL_MAY_FALL: f64 = 1.0;
const RENDERED_MAY_FALL: f64 = 0.2;

pub(crate) fn run(source: &Source) -> Result<()> {
    let mut text = String::from(
        "All <3 px after every rung, in %: over the high-gradient pixels (`semi_dense`), and over all pixels (`dense`). The \
         mean over a data set must never fall, one real scene by at most 1.0, one rendered scene by at most 0.2, the estimate never.\n\n\
         | data set | preset | density | mean after rungs 1, 2, .. | mean falls by | one scene falls by at most | estimate |\n\
         |---|---|---|---|---|---|---|\n",
    );
    let mut sets = Vec::new();
    for set in [KITTI, MIDDLEBURY, ETH3D] {
        sets.push((set.title, source.views(set)?, REAL_MAY_FALL));
    }
    sets.push(("rendered", rendered(), RENDERED_MAY_FALL));
    for (title, scenes, may_fall) in sets {
        for preset in [Preset::Default, Preset::Fast, Preset::Paper] {
            for is_dense in [false, true] {
                let climb = Climb::of(preset, is_dense, &scenes)?;
                writeln!(
                    text,
                    "| {} | {} | {} | {} | {} | {} | {} |",
                    title,
                    preset_name(preset),
                    if is_dense { "dense" } else { "semi_dense" },
                    climb
                        .means()
                        .iter()
                        .map(|m| format!("{m:.2}"))
                        .collect::<Vec<_>>()
                        .join(" / "),
                    climb.mean_fall(),
                    climb.largest_fall(may_fall),
                    if climb.estimate_falls {
                        "**falls**"
                    } else {
                        "never falls"
                    }
                )?;
            }
        }
    }
    source.publish(Document::Figures, "anytime", &text)
}

/// The rendered scenes, whose truth is exact.
fn rendered() -> Vec<Views> {
    let views = |scene: Scene| {
        let RenderedPair {
            left, right, truth, ..
        } = RenderedPair::clean(&scene);
        Views {
            name: scene.name.to_owned(),
            served: (left.clone(), right.clone()),
            scored: LoadedScene { left, right, truth },
        }
    };
    Scene::all().into_iter().map(views).collect()
}

/// Accuracy of one preset after every rung.
struct Climb {
    /// Name of each scene, and its accuracy after every rung.
    scenes: Vec<(String, Vec<f64>)>,
    estimate_falls: bool,
}

impl Climb {
    fn of(preset: Preset, is_dense: bool, scenes: &[Views]) -> Result<Self> {
        let length = ladder_length(preset);
        let method = |rungs| {
            let method = Method::new(preset, rungs);
            if is_dense { method.dense() } else { method }
        };
        let mut rungs: Vec<Contestant> = (1..=length).map(|n| Contestant::ours(method(n))).collect();
        let mut climb = Self {
            scenes: Vec::new(),
            estimate_falls: false,
        };
        for views in scenes {
            let runs = take_turns(&mut rungs, views, DISPARITIES, Turns::ONCE)?;
            let accuracies = runs.iter().map(|run| {
                let truth = &views.scored.truth.disparity_px;
                let score = score(&run.disparity_px, &views.scored.left, truth);
                if is_dense {
                    score.dense.all[1]
                } else {
                    score.edges.all[1]
                }
            });
            climb.scenes.push((views.name.clone(), accuracies.collect()));
            let estimates = runs.last().map_or(&[][..], |run| &run.estimates);
            climb.estimate_falls |= estimates.windows(2).any(|pair| pair[1] < pair[0]);
        }
        Ok(climb)
    }

    fn means(&self) -> Vec<f64> {
        let length = self.scenes.first().map_or(0, |scene| scene.1.len());
        (0..length)
            .map(|rung| self.scenes.iter().map(|scene| scene.1[rung]).sum::<f64>() / self.scenes.len() as f64)
            .collect()
    }

    fn mean_fall(&self) -> String {
        match fall(&self.means()) {
            Some((points, rung)) => format!("**{points:.2}** at rung {rung}"),
            None => "never".to_owned(),
        }
    }

    fn largest_fall(&self, may_fall: f64) -> String {
        let falls = self
            .scenes
            .iter()
            .filter_map(|(name, accuracies)| Some((fall(accuracies)?, name)));
        match falls.max_by(|a, b| a.0.0.total_cmp(&b.0.0)) {
            Some(((points, rung), name)) if points > may_fall => {
                format!("**{points:.2}** at rung {rung} ({name})")
            }
            Some(((points, rung), name)) => format!("{points:.2} at rung {rung} ({name})"),
            None => "never".to_owned(),
        }
    }
}

/// The largest fall from one rung to the next, and the rung that it leads to; `None` if there is none.
fn fall(accuracies: &[f64]) -> Option<(f64, usize)> {
    let falls = accuracies
        .windows(2)
        .zip(2..)
        .map(|(pair, rung)| (pair[0] - pair[1], rung));
    falls
        .filter(|(points, _)| *points > 0.0)
        .max_by(|a, b| a.0.total_cmp(&b.0))
}

#[cfg(test)]
mod tests {
    use super::{Climb, fall};

    #[test]
    fn the_largest_fall_is_found_with_its_rung() {
        assert_eq!(fall(&[80.0, 90.0, 90.0, 95.0]), None);
        assert_eq!(fall(&[80.0, 79.5, 90.0, 88.0]), Some((2.0, 4)));
        assert_eq!(fall(&[]), None);
    }

    #[test]
    fn a_scene_may_fall_while_the_mean_rises() {
        let climb = Climb {
            scenes: vec![
                ("a".to_owned(), vec![50.0, 60.0]),
                ("b".to_owned(), vec![70.0, 68.5]),
            ],
            estimate_falls: false,
        };
        assert_eq!(climb.means(), [60.0, 64.25]);
        assert_eq!(climb.mean_fall(), "never");
        assert_eq!(climb.largest_fall(1.0), "**1.50** at rung 2 (b)");
    }
}
