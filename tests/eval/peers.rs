//! OpenCV's matchers, run by a small Python program beside this one. Pixels go in and disparities come out through its
//! pipes, so that every method gets the same bytes in the same run.

use std::cell::RefCell;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::rc::Rc;

use anyhow::{Context, Result};
use serde::Deserialize;
use stereo_tests::gray::GrayImage;

use crate::method::Run;

/// The program; it is passed to Python as text, so that this binary works from any folder.
const PROGRAM: &str = include_str!("peers.py");

/// The running Python program.
pub(crate) struct Peers {
    child: Child,
    requests: Option<ChildStdin>,
    replies: BufReader<ChildStdout>,
    opencv_version: String,
}

#[derive(Deserialize)]
struct Hello {
    opencv: String,
}

#[derive(Deserialize)]
struct Reply {
    cpu_ms: f64,
    wall_ms: f64,
}

impl Peers {
    /// Starts the program and waits until it has loaded OpenCV.
    pub(crate) fn start(python: &Path) -> Result<Rc<RefCell<Self>>> {
        let mut child = Command::new(python)
            .args(["-c", PROGRAM])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| {
                format!(
                    "can't run {}: the peers need Python with opencv-python-headless (`make target/venv/ready` sets \
                     one up, or give --python)",
                    python.display()
                )
            })?;
        let requests = child.stdin.take();
        let replies = BufReader::new(child.stdout.take().context("the program's output is piped")?);
        let mut peers = Self {
            child,
            requests,
            replies,
            opencv_version: String::new(),
        };
        let hello: Hello = peers
            .line()
            .context("the Python program for the peers didn't start")?;
        peers.opencv_version = hello.opencv;
        Ok(Rc::new(RefCell::new(peers)))
    }

    pub(crate) fn opencv_version(&self) -> &str {
        &self.opencv_version
    }

    /// The fastest of `repeat` runs of the peer `name`.
    pub(crate) fn best_of(
        &mut self,
        name: &str,
        repeat: u32,
        (left, right): (&GrayImage, &GrayImage),
        disparities: u16,
    ) -> Result<Run> {
        let requests = self.requests.as_mut().context("the program is running")?;
        let head = serde_json::json!({
            "peer": name,
            "repeat": repeat,
            "disparities": disparities,
            "width": left.width_px(),
            "height": left.height_px(),
        });
        writeln!(requests, "{head}")?;
        requests.write_all(left.pixels())?;
        requests.write_all(right.pixels())?;
        requests.flush()?;
        let reply: Reply = self.line().with_context(|| format!("the peer {name} failed"))?;
        let mut bytes = vec![0; 2 * left.pixels().len()];
        self.replies
            .read_exact(&mut bytes)
            .context("the disparities ended early")?;
        // OpenCV's fixed point: 1/16 px, negative = none.
        let disparity_px = bytes
            .chunks_exact(2)
            .map(|b| f32::from(i16::from_le_bytes([b[0], b[1]])) / 16.0)
            .collect();
        Ok(Run {
            disparity_px,
            estimates: Vec::new(),
            match_ms: reply.cpu_ms,
            wall_ms: reply.wall_ms,
        })
    }

    fn line<T: serde::de::DeserializeOwned>(&mut self) -> Result<T> {
        let mut line = String::new();
        self.replies.read_line(&mut line)?;
        serde_json::from_str(&line).context("no answer from the program (its own message is above)")
    }
}

impl Drop for Peers {
    fn drop(&mut self) {
        // The end of its input ends the program.
        self.requests = None;
        if let Err(error) = self.child.wait() {
            eprintln!("can't wait for the peers' Python program: {error}");
        }
    }
}
