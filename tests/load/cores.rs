//! Keeping what is measured apart from what measures: the server's worker alone on its core, where the system lets us choose. Its network
//! threads share the generator's core, so that they don't interrupt the worker; on two cores that is as far apart as it gets.

use std::process::{Command, Stdio};

/// Who runs where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Cores {
    /// The core of the generator and of the server's network threads, as `taskset` takes it; `None` = as the system likes.
    pub(crate) network: Option<String>,
    /// The cores of the server's worker.
    pub(crate) worker: Option<String>,
    /// A sentence about it.
    pub(crate) said: String,
}

impl Cores {
    /// Moves this process to the last core it may use, and leaves the others to the server's worker. Call it before any thread
    /// is started.
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
                "the server's one worker ran on core{plural} {server}, its network threads and the generator on core {mine} (taskset)"
            ),
            network: Some(mine.to_string()),
            worker: Some(server),
        }
    }

    fn mixed(why: &str) -> Self {
        Self {
            network: None,
            worker: None,
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
