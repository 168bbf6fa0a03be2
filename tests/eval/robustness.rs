//! `cargo eval robustness`: what exposure, noise, misalignment, blur, 16 bits and many disparities do to the answers.

use std::fmt::Write as _;

use anyhow::Result;
use stereo::Preset;
use stereo_tests::dataset::{LoadedScene, decoded};
use stereo_tests::degrade::Degradation;
use stereo_tests::score::{Score, mean, score};
use stereo_tests::truth::TruthMap;
use stereod::decode::Side;

use crate::contest::{Turns, take_turns};
use crate::method::{Contestant, Method, Views, ladder_length};
use crate::pairs::{SIZES, Size, resized};
use crate::source::{DISPARITIES, DataSet, Document, KITTI, MIDDLEBURY, MOTORCYCLE, Source};

/// What is done to the pairs.
#[derive(Debug, Clone, Copy)]
enum Change {
    Degraded(Degradation),
    /// 16-bit files through the server's decoder, with gray values times this; OpenCV's SGBM takes 8 bits only.
    Wide(u16),
}

const NONE: Degradation = Degradation::NONE;
const CASES: [(&str, Change); 12] = [
    ("as recorded", Change::Degraded(NONE)),
    ("gain 0.7", Change::Degraded(Degradation { gain: 0.7, ..NONE })),
    ("gain 1.4", Change::Degraded(Degradation { gain: 1.4, ..NONE })),
    (
        "offset -20",
        Change::Degraded(Degradation {
            offset: -20.0,
            ..NONE
        }),
    ),
    (
        "offset +20",
        Change::Degraded(Degradation { offset: 20.0, ..NONE }),
    ),
    (
        "noise, sigma 8",
        Change::Degraded(Degradation {
            noise_sigma: 8.0,
            ..NONE
        }),
    ),
    (
        "right view 1 px lower",
        Change::Degraded(Degradation {
            misaligned_px: 1.0,
            ..NONE
        }),
    ),
    (
        "right view 2 px lower",
        Change::Degraded(Degradation {
            misaligned_px: 2.0,
            ..NONE
        }),
    ),
    (
        "right view blurred, sigma 1.5 px",
        Change::Degraded(Degradation {
            blur_sigma_px: 1.5,
            ..NONE
        }),
    ),
    ("16 bits, all used", Change::Wide(257)),
    ("16 bits, 14 used", Change::Wide(64)),
    ("16 bits, 12 used", Change::Wide(16)),
];
/// Large images take long.
const TWICE: Turns = Turns { rounds: 2, burst: 1 };
const PRESETS: [Preset; 2] = [Preset::Default, Preset::Fast];

pub(crate) fn run(source: &Source) -> Result<()> {
    let mut text = String::from(
        "Whole ladders: all <3 px / density over the high-gradient pixels of the unchanged left view / D1-all of the dense \
         result, in %. Noise is in both views, every other change in the right one.\n",
    );
    for set in [KITTI, MIDDLEBURY] {
        write!(text, "\n{}", table(source, set)?)?;
    }
    source.publish(Document::Figures, "robustness", &text)?;
    source.publish(Document::Figures, "many-disparities", &many_disparities(source)?)
}

/// Both presets, semi-dense and dense, then SGBM.
fn contestants(source: &Source) -> Result<Vec<Contestant>> {
    let methods = PRESETS.map(|preset| Method::new(preset, ladder_length(preset)));
    let mut list: Vec<Contestant> = methods
        .iter()
        .flat_map(|method| [Contestant::ours(*method), Contestant::ours(method.dense())])
        .collect();
    list.extend(source.peers(&["sgbm"])?);
    Ok(list)
}

/// One row a change.
fn table(source: &Source, set: DataSet) -> Result<String> {
    let scenes = source.views(set)?;
    let mut contestants = contestants(source)?;
    let mut text = format!(
        "| {}, {} scenes | default | fast | SGBM |\n|---|---|---|---|\n",
        set.title,
        scenes.len()
    );
    for (name, change) in CASES {
        let mut scores: Vec<Vec<Score>> = vec![Vec::new(); contestants.len()];
        for clean in &scenes {
            let changed = changed(clean, change)?;
            let runs = take_turns(&mut contestants, &changed, DISPARITIES, Turns::ONCE)?;
            for (run, scores) in runs.iter().zip(&mut scores) {
                let truth = &clean.scored.truth.disparity_px;
                scores.push(score(&run.disparity_px, &clean.scored.left, truth));
            }
        }
        let means: Vec<Score> = scores.iter().map(|scores| mean(scores)).collect();
        let sgbm = match change {
            Change::Degraded(_) => figures(&means[4], &means[4]),
            Change::Wide(_) => "8 bits only".to_owned(),
        };
        writeln!(
            text,
            "| {name} | {} | {} | {sgbm} |",
            figures(&means[0], &means[1]),
            figures(&means[2], &means[3])
        )?;
    }
    Ok(text)
}

fn figures(semi_dense: &Score, dense: &Score) -> String {
    format!(
        "{:.1} / {:.1} / {:.1}",
        semi_dense.edges.all[1], semi_dense.edges.density, dense.dense.d1
    )
}

fn changed(clean: &Views, change: Change) -> Result<Views> {
    let (left, right) = (&clean.served.0, &clean.served.1);
    Ok(match change {
        Change::Degraded(degradation) => {
            let (scored_left, scored_right) = degradation.of(&clean.scored.left, &clean.scored.right);
            Views {
                name: clean.name.clone(),
                served: degradation.of(left, right),
                scored: LoadedScene {
                    left: scored_left,
                    right: scored_right,
                    truth: clean.scored.truth.clone(),
                },
            }
        }
        Change::Wide(factor) => Views {
            name: clean.name.clone(),
            served: (
                decoded(Side::Left, left.to_png16(factor)?)?,
                decoded(Side::Right, right.to_png16(factor)?)?,
            ),
            scored: clean.scored.clone(),
        },
    })
}

/// The motorcycle at 1920x1080, where its disparities go up to 155 px.
fn many_disparities(source: &Source) -> Result<String> {
    let Some(size) = SIZES.last() else {
        return Ok(String::new());
    };
    let mut text = format!(
        "Middlebury's motorcycle enlarged to {size}, where its disparities reach 155 px: all <3 px / density / D1-all, in %\n\n\
         | disparities searched | default | ms | fast | ms | SGBM | ms |\n|---|---|---|---|---|---|---|\n"
    );
    let mut contestants = contestants(source)?;
    for small in &source.views(MOTORCYCLE)? {
        let views = enlarged(small, *size)?;
        for disparities in [128, 192, 256] {
            let runs = take_turns(&mut contestants, &views, disparities, TWICE)?;
            let scores: Vec<Score> = runs
                .iter()
                .map(|run| {
                    let truth = &views.scored.truth.disparity_px;
                    score(&run.disparity_px, &views.scored.left, truth)
                })
                .collect();
            write!(text, "| {disparities} |")?;
            for (semi_dense, dense) in [(0, 1), (2, 3), (4, 4)] {
                let figures = figures(&scores[semi_dense], &scores[dense]);
                write!(text, " {figures} | {:.1} |", runs[semi_dense].match_ms)?;
            }
            text.push('\n');
        }
    }
    Ok(text)
}

/// A scene in another size, its truth taken from the nearest pixel.
fn enlarged(small: &Views, size: Size) -> Result<Views> {
    let truth = &small.scored.truth;
    let scale = size.width_px as f32 / truth.width_px as f32;
    let mut disparity_px = Vec::with_capacity(size.width_px * size.height_px);
    for y in 0..size.height_px {
        let row = (2 * y + 1) * truth.height_px / (2 * size.height_px);
        for x in 0..size.width_px {
            let column = (2 * x + 1) * truth.width_px / (2 * size.width_px);
            disparity_px.push(scale * truth.disparity_px[row * truth.width_px + column]);
        }
    }
    Ok(Views {
        name: format!("{} {size}", small.name),
        served: (resized(&small.served.0, size)?, resized(&small.served.1, size)?),
        scored: LoadedScene {
            left: resized(&small.scored.left, size)?,
            right: resized(&small.scored.right, size)?,
            truth: TruthMap::new(size.width_px, size.height_px, disparity_px)?,
        },
    })
}

#[cfg(test)]
mod tests {
    use super::{CASES, changed, enlarged};
    use crate::method::Views;
    use stereo_tests::dataset::LoadedScene;
    use stereo_tests::gray::GrayImage;
    use stereo_tests::truth::TruthMap;

    /// 48 x 40 px, every row alike; the true disparity is 4 px below the first row.
    fn ramp() -> Views {
        let gray: Vec<u8> = (0..40).flat_map(|_| (0..48).map(|x| 10 + 5 * x)).collect();
        let gray = GrayImage::new(48, 40, gray).expect("48 x 40");
        let truth = (0..48 * 40).map(|i| if i < 48 { 0.0 } else { 4.0 }).collect();
        Views {
            name: "ramp".to_owned(),
            served: (gray.clone(), gray.clone()),
            scored: LoadedScene {
                left: gray.clone(),
                right: gray,
                truth: TruthMap::new(48, 40, truth).expect("48 x 40"),
            },
        }
    }

    #[test]
    fn every_case_changes_what_is_matched_but_16_bits_however_many_are_used() {
        let clean = ramp();
        for (i, (name, change)) in CASES.into_iter().enumerate() {
            let changed = changed(&clean, change).expect("a changed pair");
            let same = changed.served == clean.served;
            // The rows are alike.
            let may_be_same = i == 0 || name.contains("lower") || name.contains("16 bits");
            assert_eq!(same, may_be_same, "{name}");
        }
    }

    #[test]
    fn disparities_grow_with_the_width_and_unknown_ones_stay_unknown() {
        let large = enlarged(&ramp(), "120x80".parse().expect("a size")).expect("enlarged");
        let truth = &large.scored.truth.disparity_px;
        assert_eq!(truth[120], 0.0);
        assert_eq!(truth[2 * 120 + 7], 10.0);
        assert_eq!(truth.iter().filter(|d| **d == 0.0).count(), 240);
    }
}
