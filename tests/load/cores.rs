//! Keeping server and generator apart: each on cores of its own, where the system lets us choose.

use std::process::{Command, Stdio};

/// Who runs where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Cores {
    /// The server's cores as `taskset` takes them; `None` = as the system likes.
    pub(crate) server: Option<String>,
    /// A sentence about it.
    pub(crate) said: String,
}

impl Cores {
    /// Moves this process to the last core it may use, and leaves the others to the server. Call it before any thread is
    /// started.
    pub(crate) fn split() -> Self {
        let allowed = std::fs::read_to_string("/proc/self/status")
            .ok()
            .and_then(|status| {
                let list = status
                    .lines()
                    .find_map(|line| line.strip_prefix("Cpus_allowed_list:"))?;
                parse(list)
            })
            .unwrap_or_default();
        let Some((mine, server @ [_, ..])) = allowed.split_last() else {
            return Self::mixed("there is one core only");
        };
        let moved = Command::new("taskset")
            .args(["--all-tasks", "--cpu-list", "--pid", &mine.to_string()])
            .arg(std::process::id().to_string())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        if !moved.is_ok_and(|status| status.success()) {
            return Self::mixed("taskset doesn't work here");
        }
        let server: Vec<String> = server.iter().map(u32::to_string).collect();
        let server = server.join(",");
        let plural = if server.contains(',') { "s" } else { "" };
        Self {
            said: format!(
                "the server (one worker and its network threads) ran on core{plural} {server}, the generator on core {mine} (taskset)"
            ),
            server: Some(server),
        }
    }

    fn mixed(why: &str) -> Self {
        Self {
            server: None,
            said: format!("server and generator shared the cores, as {why}"),
        }
    }
}

/// A list such as `0-3,8`.
fn parse(list: &str) -> Option<Vec<u32>> {
    let mut cores = Vec::new();
    for range in list.trim().split(',') {
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        cores.extend(first.parse::<u32>().ok()?..=last.parse().ok()?);
    }
    Some(cores)
}

#[cfg(test)]
mod tests {
    use super::parse;

    #[test]
    fn lists_of_cores_are_read() {
        assert_eq!(parse("\t0-1\n"), Some(vec![0, 1]));
        assert_eq!(parse("3"), Some(vec![3]));
        assert_eq!(parse("0-2,8,10-11"), Some(vec![0, 1, 2, 8, 10, 11]));
        assert_eq!(parse("none"), None);
    }
}
