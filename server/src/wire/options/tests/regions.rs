//! Regions: the one that is matched, and those to focus on.

use super::*;

#[test]
fn roi_has_to_lie_inside_the_image() {
    let with = |x, y, width, height| Options {
        roi: Some(Region { x, y, width, height }),
        ..Options::default()
    };
    assert!(valid(&with(0, 0, 640, 480)).params.roi.is_some());
    assert!(valid(&with(639, 479, 1, 1)).params.roi.is_some());
    for options in [
        with(1, 0, 640, 480),
        with(640, 0, 1, 1),
        with(u32::MAX, u32::MAX, u32::MAX, u32::MAX),
    ] {
        let (code, text) = refusal(&options);
        assert!(
            code == 422 && text.starts_with("roi (") && text.contains("640 x 480"),
            "{text}"
        );
    }
    refused_naming(&with(5, 5, 0, 10), &["roi", "at least 1 x 1"]);
}

fn focused(list: &[(u32, u32, u32, u32, Option<f32>)]) -> Options {
    let focus = list.iter().map(|&(x, y, width, height, weight)| v1::Focus {
        region: Some(Region { x, y, width, height }),
        weight,
    });
    Options {
        focus: focus.collect(),
        ..Options::default()
    }
}

#[test]
fn regions_to_focus_on_reach_the_domain_or_are_refused_by_name() {
    let options = focused(&[(1, 2, 30, 40, None), (0, 0, 640, 400, Some(2.5))]);
    let focus = valid(&options).params.focus;
    let weights: Vec<f32> = focus.iter().map(|focus| focus.weight).collect();
    assert_eq!(weights, [1.0, 2.5]);
    let first = Roi {
        x: 1,
        y: 2,
        width: 30,
        height: 40,
    };
    assert_eq!(focus[0].region, first);
    for weight in [0.0, -1.0, 0.0001, 1000.5, f32::NAN, f32::INFINITY] {
        refused_naming(
            &focused(&[(0, 0, 9, 9, Some(weight))]),
            &["focus.weight", "0.001 to 1000"],
        );
    }
    refused_naming(&focused(&[(0, 0, 9, 0, None)]), &["focus", "1 x 1", "9 x 0"]);
    refused_naming(&focused(&[(0, 0, 9, 9, None); 17]), &["focus", "16", "17"]);
    let no_region = Options {
        focus: vec![v1::Focus::default()],
        ..Options::default()
    };
    refused_naming(&no_region, &["focus", "region"]);
    let (code, text) = refusal(&focused(&[(0, 0, 641, 9, None)]));
    assert!(
        code == 422 && text.contains("focus") && text.contains("640 x 480"),
        "{text}"
    );
    let (code, text) = refusal(&focused(&[(0, 0, 640, 480, None), (0, 0, 1, 1, None)]));
    assert!(
        code == 422 && text.contains("307201") && text.contains("307200"),
        "{text}"
    );
    let outside_roi = Options {
        roi: Some(Region {
            x: 100,
            y: 0,
            width: 100,
            height: 100,
        }),
        ..focused(&[(99, 0, 9, 9, None)])
    };
    assert_eq!(refusal(&outside_roi).0, 422);
}
