//! Where figures come from: commit, processor, SIMD level.

use std::process::Command;

/// One line about this build and this machine.
#[must_use]
pub fn describe() -> String {
    format!(
        "commit {}, {}, SIMD level {}",
        commit(),
        cpu(),
        stereo::Level::detect().name()
    )
}

/// How many programs wanted to run in the last minute, in the mean; `None` where the system doesn't say.
#[must_use]
pub fn load_average() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/loadavg").ok()?;
    text.split_whitespace().next()?.parse().ok()
}

/// The commit, marked as dirty if anything differs from it but documents and pictures, which the benches write themselves.
fn commit() -> String {
    let git = |args: &[&str]| {
        let output = Command::new("git").args(args).output().ok()?;
        let text = String::from_utf8_lossy(&output.stdout).trim().to_owned();
        output.status.success().then_some(text)
    };
    let Some(commit) = git(&["rev-parse", "--short", "HEAD"]) else {
        return "unknown".to_owned();
    };
    let changed = git(&[
        "status",
        "--porcelain",
        "--",
        ":/",
        ":(top,exclude)*.md",
        ":(top,exclude)*.svg",
    ]);
    if changed.is_some_and(|files| files.is_empty()) {
        commit
    } else {
        format!("{commit}-dirty")
    }
}

fn cpu() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    model.map_or_else(
        || std::env::consts::ARCH.to_owned(),
        |(_, name)| name.trim().to_owned(),
    )
}
