//! A router as a process of its own.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use anyhow::{Context, Result, ensure};

use crate::process::{send_signal, target_dir};

/// A router in another process. Dropped, it is killed.
#[derive(Debug)]
pub struct RouterProcess {
    child: Child,
    endpoint: String,
}

impl RouterProcess {
    /// Starts one that listens on `endpoint`, on another host if that is the name of a network namespace.
    ///
    /// # Errors
    /// If the program `router` of this package has not been built, or can't listen there.
    pub fn start(endpoint: &str, host: Option<&str>) -> Result<Self> {
        let program = target_dir()?.join("release/router");
        ensure!(
            program.is_file(),
            "there is no {}: build it with `cargo build --release --workspace --bins`",
            program.display()
        );
        let mut command = match host {
            Some(host) => {
                let mut command = Command::new("ip");
                command.args(["netns", "exec", host]).arg(program);
                command
            }
            None => Command::new(program),
        };
        let mut child = command
            .arg(endpoint)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .context("can't start a router")?;
        let mut line = String::new();
        BufReader::new(child.stdout.take().context("its output is piped")?).read_line(&mut line)?;
        let router = Self {
            child,
            endpoint: line.trim().to_owned(),
        };
        ensure!(
            !router.endpoint.is_empty(),
            "the router can't listen on {endpoint}"
        );
        Ok(router)
    }

    /// Where it listens: `tcp/127.0.0.1:PORT`.
    #[must_use]
    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// Sends it a signal, such as `STOP`, which freezes it, or `CONT`.
    ///
    /// # Errors
    /// If the signal can't be sent.
    pub fn signal(&self, name: &str) -> Result<()> {
        send_signal(self.child.id(), name)
    }
}

impl Drop for RouterProcess {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}
