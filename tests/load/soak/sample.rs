//! What is looked at, again and again.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use stereo_tests::process::Stereod;

use super::tally::Counts;

/// The server at one moment.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Sample {
    /// Since the load's start.
    pub(super) seconds: f64,
    /// Resident memory of the process.
    pub(super) resident_bytes: u64,
    /// Open descriptors, threads, and tasks of the server's own runtime.
    pub(super) descriptors: u64,
    pub(super) threads: u64,
    pub(super) tasks: u64,
    /// Bodies and replies that are held.
    pub(super) in_flight_bytes: u64,
    /// What was sent until now, and what became of it.
    pub(super) counts: Counts,
    /// Frames of cameras that ended, and those that got a result in time.
    pub(super) camera_frames: u64,
    pub(super) camera_answers: u64,
}

impl Sample {
    /// Looks at `server`.
    pub(super) async fn take(
        server: &Stereod,
        http: &reqwest::Client,
        seconds: f64,
        counts: Counts,
    ) -> Result<Self> {
        let text = http
            .get(format!("{}/metrics", server.url()))
            .send()
            .await?
            .text()
            .await?;
        let metrics = Metrics::read(&text);
        Ok(Self {
            seconds,
            resident_bytes: server.memory_bytes()?,
            descriptors: server.descriptors()?,
            threads: server.threads()?,
            tasks: metrics.get("stereod_tasks")?,
            in_flight_bytes: metrics.get("stereod_in_flight_bytes")?
                + metrics.get("stereod_batch_in_flight_bytes")?,
            counts,
            camera_frames: metrics.sum("stereod_stream_frames_total{"),
            camera_answers: metrics.get("stereod_stream_frames_total{outcome=\"OK\"}")?,
        })
    }

    /// Frames with a deadline until now, and those that were in budget.
    pub(super) fn deadlines(&self) -> (u64, u64) {
        (
            self.counts.offered + self.camera_frames,
            self.counts.in_budget + self.camera_answers,
        )
    }
}

/// Series and their values.
struct Metrics<'a>(BTreeMap<&'a str, f64>);

impl<'a> Metrics<'a> {
    fn read(text: &'a str) -> Self {
        let series = text.lines().filter(|line| !line.starts_with('#'));
        let values = series.filter_map(|line| line.rsplit_once(' '));
        Self(
            values
                .filter_map(|(name, value)| Some((name, value.parse().ok()?)))
                .collect(),
        )
    }

    fn get(&self, name: &str) -> Result<u64> {
        let value = self
            .0
            .get(name)
            .with_context(|| format!("the server has no metric {name}"))?;
        Ok(whole(*value))
    }

    fn sum(&self, prefix: &str) -> u64 {
        let with_prefix = self.0.iter().filter(|(name, _)| name.starts_with(prefix));
        with_prefix.map(|(_, value)| whole(*value)).sum()
    }
}

/// Counts and bytes are whole and not negative.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "counts and bytes are whole and not negative"
)]
fn whole(value: f64) -> u64 {
    value as u64
}

#[cfg(test)]
mod tests {
    use super::Metrics;

    #[test]
    fn series_are_read_with_their_labels() {
        let text = "# TYPE x counter\nx_total{a=\"1\"} 2\nx_total{a=\"2\"} 3\ny 4.0\n# EOF\n";
        let metrics = Metrics::read(text);
        assert_eq!(metrics.get("y").expect("there"), 4);
        assert_eq!(metrics.sum("x_total{"), 5);
        assert!(metrics.get("z").is_err());
    }
}
