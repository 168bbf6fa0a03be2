//! The rules of the house that can be checked: who may depend on whom.

use std::collections::BTreeSet;
use std::process::Command;

/// The crates that `package` depends on directly to be built, itself included.
fn libraries(package: &str) -> BTreeSet<String> {
    let output = Command::new("cargo")
        .args(["tree", "--package", package, "--edges", "normal", "--depth", "1"])
        .args(["--prefix", "none", "--format", "{lib}", "--offline", "--locked"])
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .output()
        .expect("cargo runs, it started this test");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let lines = String::from_utf8(output.stdout).expect("crate names are ASCII");
    lines
        .lines()
        .map(|line| line.trim().to_owned())
        .filter(|line| !line.is_empty())
        .collect()
}

fn assert_depends_only_on(package: &str, allowed: &[&str]) {
    let strangers: Vec<String> = libraries(package)
        .into_iter()
        .filter(|library| !allowed.contains(&library.as_str()))
        .collect();
    assert!(strangers.is_empty(), "{package} must not depend on {strangers:?}");
}

#[test]
fn the_core_depends_on_spade_and_thiserror_only() {
    assert_depends_only_on("stereo", &["stereo", "spade", "thiserror"]);
}

#[test]
fn the_scheduler_depends_on_nothing() {
    assert_depends_only_on("stereo-scheduler", &["stereo_scheduler"]);
}

#[test]
fn the_wire_depends_on_prost_and_bytes_only() {
    assert_depends_only_on("stereo-proto", &["stereo_proto", "prost", "prost_types", "bytes"]);
}

#[test]
fn file_formats_depend_on_nothing_of_ours() {
    assert_depends_only_on(
        "stereo-surface",
        &["stereo_surface", "bytemuck", "serde_json", "thiserror"],
    );
}

#[test]
fn clients_depend_on_the_wire_and_on_nothing_of_the_server() {
    for package in ["stereo-client", "stereo-cli"] {
        // The command line has no library: its own name is in the list as that of its binary, if at all.
        let libraries = libraries(package);
        for forbidden in ["stereo", "stereo_scheduler", "stereod", "stereo_tests"] {
            assert!(
                !libraries.contains(forbidden),
                "{package} must not depend on {forbidden}"
            );
        }
    }
}

#[test]
fn nothing_depends_on_the_tests() {
    for package in [
        "stereo",
        "stereo-scheduler",
        "stereo-proto",
        "stereo-client",
        "stereo-cli",
        "stereod",
    ] {
        assert!(
            !libraries(package).contains("stereo_tests"),
            "{package} must not depend on stereo-tests"
        );
    }
}
