//! `stereod match`: the same results from files, without a network.

use std::path::{Path, PathBuf};

use serde_json::json;
use stereo_tests::process::run;

use crate::conversation::{PAIR, Server, png16};

/// A fresh folder for one test, with the pair in it.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        drop(std::fs::remove_dir_all(&folder));
        std::fs::create_dir_all(&folder).expect("a folder below the target folder");
        std::fs::write(folder.join("left.png"), &PAIR.left).expect("a file");
        std::fs::write(folder.join("right.png"), &PAIR.right).expect("a file");
        Self(folder)
    }

    fn path(&self, name: &str) -> String {
        self.0.join(name).to_str().expect("a plain path").to_owned()
    }

    fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.0.join(name)).unwrap_or_else(|why| panic!("{name}: {why}"))
    }
}

#[tokio::test]
async fn match_writes_its_files_and_they_are_what_the_server_sends() {
    let folder = Folder::new("match-writes");
    let (left, right, out) = (
        folder.path("left.png"),
        folder.path("right.png"),
        folder.path("out"),
    );
    let output =
        run(&["match", &left, &right, "--out", &out, "--max-iterations", "2"]).expect("a program that runs");
    assert_eq!(
        output.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let said = String::from_utf8_lossy(&output.stdout);
    for name in [
        "disparity.png",
        "disparity_color.png",
        "mesh.glb",
        "mesh.ply",
        "report.json",
    ] {
        assert!(said.contains(name), "{name} isn't named in {said}");
    }
    let server = Server::start(&[]);
    let options = || json!({ "max_iterations": 2 });
    assert_eq!(
        png16(&folder.read("out/disparity.png")),
        server.post_pair("image/png", options()).await.png16()
    );
    assert!(folder.read("out/mesh.glb") == server.post_pair("model/gltf-binary", options()).await.body);
    assert!(folder.read("out/mesh.ply") == server.post_pair("application/ply", options()).await.body);
    let picture = image::load_from_memory(&folder.read("out/disparity_color.png")).expect("a PNG");
    assert_eq!((picture.width(), picture.height()), (512, 320));
    let report: serde_json::Value = serde_json::from_slice(&folder.read("out/report.json")).expect("JSON");
    assert_eq!(report["report"]["iterations_run"], 2);
}

#[test]
fn match_of_bad_files_fails_with_a_sentence_and_writes_nothing() {
    let folder = Folder::new("match-bad");
    std::fs::write(folder.0.join("cut.png"), &PAIR.left[..500]).expect("a file");
    let (left, out) = (folder.path("left.png"), folder.path("out"));
    for (right, code, word) in [
        (folder.path("cut.png"), 65, "right"),
        (folder.path("missing.png"), 74, "missing.png"),
    ] {
        let output = run(&["match", &left, &right, "--out", &out]).expect("a program that runs");
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{message}");
        assert!(message.contains(word), "{message}");
        assert!(!folder.0.join("out").exists());
    }
    let right = folder.path("right.png");
    let output = run(&["match", &left, &right, "--out", &out, "--num-disparities", "17"])
        .expect("a program that runs");
    assert_eq!(output.status.code(), Some(64));
    assert!(String::from_utf8_lossy(&output.stderr).contains("16 to 256"));
}
