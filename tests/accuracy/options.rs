//! What the parameters promise.

use stereo::{Density, DisparityRange, Params, Roi};

use crate::{clean, matched};

#[test]
fn min_confidence_trades_density_for_accuracy() {
    let pair = clean("road with boxes and poles");
    let at = |min_confidence| {
        matched(
            pair,
            Params {
                min_confidence,
                ..Params::default()
            },
            u8::MAX,
        )
        .score
        .edges
    };
    let (all, confident, none) = (at(0.0), at(0.5), at(1.0));
    assert!(
        confident.density < all.density,
        "{} -> {}",
        all.density,
        confident.density
    );
    assert!(confident.density > 30.0, "{}", confident.density);
    assert!(
        confident.returned[1] > all.returned[1],
        "{} -> {}",
        all.returned[1],
        confident.returned[1]
    );
    assert_eq!(none.density, 0.0);
}

#[test]
fn a_range_that_begins_above_zero_gives_the_same_accuracy() {
    let pair = clean("sphere");
    let range = DisparityRange {
        min_px: 16,
        count: 48,
    };
    let got = matched(
        pair,
        Params {
            range,
            ..Params::default()
        },
        u8::MAX,
    );
    let whole = matched(pair, Params::default(), u8::MAX);
    let (narrow, wide) = (got.score.edges.all[1], whole.score.edges.all[1]);
    assert!(narrow >= wide - 1.0, "{wide:.2} -> {narrow:.2}");
    assert!(
        got.disparity_px
            .iter()
            .filter(|d| d.is_finite())
            .all(|d| (15.0..=65.0).contains(d))
    );
}

#[test]
fn no_disparity_leaves_the_range_that_was_searched() {
    let pair = clean("sphere");
    for density in [Density::SemiDense, Density::Dense] {
        let range = DisparityRange {
            min_px: 16,
            count: 16,
        };
        let got = matched(
            pair,
            Params {
                range,
                density,
                ..Params::default()
            },
            u8::MAX,
        );
        let valid: Vec<f32> = got.disparity_px.into_iter().filter(|d| d.is_finite()).collect();
        assert!(valid.len() > 10_000);
        let strays: Vec<&f32> = valid.iter().filter(|d| !(16.0..=32.0).contains(*d)).collect();
        assert!(
            strays.is_empty(),
            "{density:?}: {} strays such as {:?}",
            strays.len(),
            strays.first()
        );
    }
}

#[test]
fn only_the_region_of_interest_is_matched_and_as_well_as_the_whole() {
    let pair = clean("sphere");
    let roi = Roi {
        x: 150,
        y: 60,
        width: 240,
        height: 200,
    };
    for density in [Density::SemiDense, Density::Dense] {
        let params = Params {
            roi: Some(roi),
            density,
            ..Params::default()
        };
        let whole = matched(
            pair,
            Params {
                roi: None,
                ..params.clone()
            },
            u8::MAX,
        );
        let got = matched(pair, params, u8::MAX);
        let (mut inside, mut good, mut good_of_whole) = (0_u32, 0_u32, 0_u32);
        for (i, (d, truth)) in got.disparity_px.iter().zip(&pair.truth.disparity_px).enumerate() {
            let (x, y) = (i % pair.left.width_px(), i / pair.left.width_px());
            let is_inside =
                (roi.x..roi.x + roi.width).contains(&x) && (roi.y..roi.y + roi.height).contains(&y);
            assert!(
                is_inside || d.is_nan(),
                "column {x}, row {y} is outside but has {d}"
            );
            if is_inside && d.is_finite() && *truth > 0.0 {
                inside += 1;
                good += u32::from((d - truth).abs() < 3.0);
                good_of_whole += u32::from((whole.disparity_px[i] - truth).abs() < 3.0);
            }
        }
        assert!(inside > 15_000, "{density:?}: {inside}");
        // Within half a point of what matching the whole image gives there.
        assert!(
            good * 200 + inside >= good_of_whole * 200,
            "{density:?}: {good} of {inside}, in the whole {good_of_whole}"
        );
    }
}
