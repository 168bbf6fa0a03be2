//! After its first frames, a matcher allocates in the triangulation (spade's own memory) and nowhere else.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::alloc::System;
use std::collections::BTreeMap;

use stats_alloc::{INSTRUMENTED_SYSTEM, StatsAlloc};
use stereo::{
    DisparityMap, Focus, GrayView, Level, Matcher, Mesh, MeshParams, Params, Progress, Roi, Serial, Shape,
    StereoPair,
};

#[global_allocator]
static COUNTED: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Allocations of this process so far.
fn allocations() -> usize {
    let stats = COUNTED.stats();
    stats.allocations + stats.reallocations
}

const WIDTH: usize = 480;
const HEIGHT: usize = 300;

/// A textured pair: steps of disparity, and noise that differs between the views.
fn images(seed: u64) -> [Vec<u8>; 2] {
    let hash = |v: u64| (v.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 41).wrapping_mul(0x1656_67B1) >> 9 & 0xFF;
    let texture = |x: usize, y: usize| hash(seed ^ (x as u64 / 2 * 7919 + y as u64 / 2 * 104_729));
    let image = |shifted: usize| {
        let pixel = |at: usize| {
            let (x, y) = (at % WIDTH, at / WIDTH);
            let noise = hash(seed + 99 + shifted as u64 + at as u64 * 31) / 32;
            let disparity = 5 + (x / 60 * 7 + y / 50 * 5) % 23;
            u8::try_from((texture(x + shifted * disparity, y) * 7 / 8 + noise).min(255)).unwrap()
        };
        (0..WIDTH * HEIGHT).map(pixel).collect()
    };
    [image(0), image(1)]
}

/// What each stage allocated in one frame, by its name.
fn one_frame(
    matcher: &mut Matcher,
    images: &[Vec<u8>; 2],
    (out, mesh): (&mut DisparityMap, &mut Mesh),
    counts: &mut BTreeMap<&'static str, usize>,
) {
    let views = images
        .each_ref()
        .map(|data| GrayView::new(data, WIDTH, HEIGHT, WIDTH).unwrap());
    let pair = StereoPair::new(views[0], views[1]).unwrap();
    let mut before = allocations();
    let mut count = |stage: &'static str| {
        let new = allocations() - before;
        *counts.entry(stage).or_default() += new;
        // What counting itself allocates does not count.
        before = allocations();
    };
    let mut progress = matcher.base_by_stage(pair, out, &Serial, &mut count).unwrap();
    loop {
        if !matches!(progress, Progress::Working) {
            matcher.mesh(&MeshParams::default(), mesh);
            count("mesh");
        }
        if matches!(progress, Progress::Converged(_)) {
            break;
        }
        let stage = matcher.next_stage();
        progress = matcher.refine(pair, out, &Serial);
        count(stage);
    }
}

#[test]
fn nothing_but_the_triangulation_allocates_after_the_first_frames() {
    let shape = Shape::new(WIDTH, HEIGHT).unwrap();
    let region = Roi {
        x: 100,
        y: 80,
        width: 200,
        height: 120,
    };
    let focus = vec![Focus { region, weight: 1.0 }];
    let focused = |params: Params| Params {
        focus: focus.clone(),
        ..params
    };
    let frames: Vec<_> = (0..3).map(|seed| images(17 * seed)).collect();
    for params in [
        Params::default(),
        Params::fast(),
        Params::paper(),
        focused(Params::default()),
        focused(Params::fast()),
    ] {
        let mut matcher = Matcher::new(Level::detect(), shape, params.clone()).unwrap();
        let (mut out, mut mesh) = (DisparityMap::new(shape), Mesh::default());
        let mut counts = BTreeMap::new();
        for frame in &frames {
            one_frame(&mut matcher, frame, (&mut out, &mut mesh), &mut counts);
        }
        let warm_up: usize = counts.values().sum();
        assert!(warm_up > 20, "what is counted is counted: {counts:?}");
        counts.values_mut().for_each(|count| *count = 0);
        for frame in frames.iter().chain(&frames) {
            one_frame(&mut matcher, frame, (&mut out, &mut mesh), &mut counts);
        }
        let allowed = counts.remove("triangulate");
        assert!(allowed > Some(0), "spade allocates for each frame");
        assert!(
            counts.values().all(|count| *count == 0),
            "preset {:?}, {} regions, allocations by stage in six frames: {counts:?}",
            params.preset,
            params.focus.len()
        );
    }
}
