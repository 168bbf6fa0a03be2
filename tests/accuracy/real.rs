//! Real scenes, where they are: their licences keep them out of the repository.

use std::path::Path;

use stereo::Params;
use stereo_tests::dataset::find_scenes;
use stereo_tests::matching::Bench;
use stereo_tests::process::target_dir;
use stereo_tests::registry_pair::RegistryPair;
use stereo_tests::score::{Score, mean, score};

const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");

#[test]
fn kitti_2012_keeps_its_bounds_at_1_2_and_4_rungs() {
    let root = Path::new(DATA);
    if !root.join("kitti2012").is_dir() {
        eprintln!("skipped: there are no KITTI scenes in ../shared/data");
        return;
    }
    let mut before = 0.0;
    for (rungs, all_3_px, density) in [(1, 80.0, 96.0), (2, 84.0, 98.0), (4, 86.0, 99.0)] {
        let mut scores: Vec<Score> = Vec::new();
        for files in find_scenes(&root.join("kitti2012")).expect("a folder of scenes") {
            let scene = files.load().expect("readable files");
            let (left, right) = files.load_as_served().expect("readable files");
            let mut bench = Bench::new(&left, Params::default()).expect("good parameters");
            let run = bench.run(&left, &right, rungs).expect("a pair");
            scores.push(score(&run.disparity_px, &scene.left, &scene.truth.disparity_px));
        }
        let got = mean(&scores).edges;
        assert!(
            got.all[1] >= all_3_px,
            "{rungs} rungs: all <3 px {:.2}",
            got.all[1]
        );
        assert!(
            got.density >= density,
            "{rungs} rungs: density {:.2}",
            got.density
        );
        assert!(
            got.all[1] > before,
            "{rungs} rungs: {before:.2} -> {:.2}",
            got.all[1]
        );
        before = got.all[1];
    }
}

#[test]
fn the_registry_pair_keeps_its_bounds() {
    let Some(pair) = RegistryPair::cached(&target_dir().expect("cargo's folder")) else {
        eprintln!("skipped: the registry pair hasn't been fetched (`make demo` does)");
        return;
    };
    let scene = pair.load().expect("readable files");
    let mut bench = Bench::new(&scene.left, Params::default()).expect("good parameters");
    for (rungs, all_3_px) in [(1, 78.0), (u8::MAX, 88.0)] {
        let run = bench.run(&scene.left, &scene.right, rungs).expect("a pair");
        let got = score(&run.disparity_px, &scene.left, &scene.truth.disparity_px).edges;
        assert!(
            got.all[1] >= all_3_px,
            "{rungs} rungs: all <3 px {:.2}",
            got.all[1]
        );
        assert!(got.density >= 95.0, "{rungs} rungs: density {:.2}", got.density);
    }
}
