use clap::Parser;

use super::*;
use crate::args::{Cli, Command};

/// A folder that is removed at the end of its test.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("stereod-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn image(&self, name: &str, width_px: u32, shift_px: u32) -> String {
        let path = self.0.join(name);
        let pixel = |x: u32, y: u32| {
            let mixed = ((x + shift_px).wrapping_mul(0x9e37_79b9) ^ y.wrapping_mul(0x85eb_ca6b))
                .wrapping_mul(0x2c1b_3c6d);
            image::Luma([(mixed >> 24).to_le_bytes()[0]])
        };
        image::GrayImage::from_fn(width_px, 64, pixel)
            .save(&path)
            .unwrap();
        path.to_str().unwrap().to_owned()
    }

    fn file(&self, name: &str, text: &str) -> String {
        let path = self.0.join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        drop(std::fs::remove_dir_all(&self.0));
    }
}

fn args(left: &str, right: &str, out: &Path, flags: &[&str]) -> Box<MatchArgs> {
    let start = ["stereod", "match", left, right, "--out", out.to_str().unwrap()];
    match Cli::try_parse_from(start.iter().chain(flags)).unwrap().command {
        Command::Match(args) => args,
        Command::Serve(_) | Command::Token { .. } => unreachable!("`match` was given"),
    }
}

#[tokio::test]
async fn a_pair_of_files_becomes_five_files() {
    let folder = Folder::new("match");
    let (left, right) = (folder.image("left.png", 96, 0), folder.image("right.png", 96, 8));
    let meta = folder.file(
        "meta.json",
        r#"{"scene": "x", "focal_px": 100.0, "cx": 48, "cy": 32, "baseline_m": 0.1}"#,
    );
    let out = folder.0.join("new/out");
    run(&args(
        &left,
        &right,
        &out,
        &[
            "--num-disparities",
            "32",
            "--calibration",
            &meta,
            "--max-triangles",
            "100",
        ],
    ))
    .await
    .unwrap();
    for (name, _) in OUTPUTS {
        assert!(std::fs::metadata(out.join(name)).unwrap().len() > 0, "{name}");
    }
    let report: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap();
    assert!(report["report"]["iterations_run"].as_u64().unwrap() >= 1);
}

#[tokio::test]
async fn each_kind_of_fault_has_its_own_exit_code_and_writes_nothing() {
    let folder = Folder::new("faults");
    let (left, right) = (folder.image("left.png", 96, 0), folder.image("right.png", 96, 8));
    let wide = folder.image("wide.png", 128, 0);
    let tiny = folder.image("tiny.png", 16, 0);
    let text = folder.file("text.png", "not a picture");
    let whole = std::fs::read(&left).unwrap();
    let cut = folder.0.join("cut.png");
    std::fs::write(&cut, &whole[..whole.len() / 2]).unwrap();
    let out = folder.0.join("out");
    for (left, right, flags, code, word) in [
        (
            left.as_str(),
            right.as_str(),
            ["--num-disparities", "17"].as_slice(),
            64,
            "num_disparities",
        ),
        (&left, &right, &["--preset", "magic"], 64, "preset"),
        (&left, &right, &["--simd", "avx99"], 64, "avx99"),
        (
            &left,
            &right,
            &["--max-triangles", "99"],
            64,
            "mesh.max_triangles",
        ),
        (&left, &right, &["--mesh-tolerance", "0"], 64, "mesh.tolerance_px"),
        (
            &left,
            &right,
            &["--latency-budget-ms", "0"],
            64,
            "latency_budget_ms",
        ),
        (&left, &right, &["--calibration", &text], 65, "text.png"),
        (&left, &wide, &[], 65, "128"),
        (&tiny, &tiny, &[], 65, "32"),
        (&text, &right, &[], 65, "left"),
        (cut.to_str().unwrap(), &right, &[], 65, "left"),
        ("no/such.png", &right, &[], 74, "no/such.png"),
    ] {
        let error = run(&args(left, right, &out, flags)).await.unwrap_err();
        assert_eq!(error.exit_code(), code, "{error}");
        assert!(error.to_string().contains(word), "{error}");
        assert!(!out.exists());
    }
    let in_the_way = folder.0.join("text.png");
    let error = run(&args(&left, &right, &in_the_way, &[])).await.unwrap_err();
    assert_eq!(error.exit_code(), 74, "{error}");
}
