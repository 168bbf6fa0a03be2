//! `stereod match`: one pair of files through the same waist as every frame, without a network.

mod options;
mod summary;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use indicatif::{ProgressBar, ProgressStyle};
use stereo::Shape;
use stereo_proto::v1::StereoRequest;
use thiserror::Error;

use crate::StartError;
use crate::args::MatchArgs;
use crate::clients::Caller;
use crate::config::{Config, WorkersConfig};
use crate::decode::{Side, inspect};
use crate::encode::memory::Encoded;
use crate::job::{FrameReply, FrameRequest, PriorityClass, ReplyFormat};
use crate::service::{Delivery, OnRung, Service};
use crate::status::ServiceError;
use crate::wire::{FormParts, Intake, frame_request, request_from_form};

/// What is written to the folder, and by which encoder.
const OUTPUTS: [(&str, ReplyFormat); 5] = [
    ("disparity.png", ReplyFormat::DisparityPng),
    ("disparity_color.png", ReplyFormat::ColorPng),
    ("mesh.glb", ReplyFormat::Glb),
    ("mesh.ply", ReplyFormat::Ply),
    ("report.json", ReplyFormat::Json),
];

/// Why nothing was matched or written.
#[derive(Debug, Error)]
pub enum OfflineError {
    /// An option is out of its range or contradicts another.
    #[error("{0}")]
    Usage(ServiceError),
    /// The calibration file says something else.
    #[error(
        "{path} is no calibration ({why}): it must be JSON with focal_px, cx_px, cy_px, baseline_m and, if the principal points differ, doffs_px"
    )]
    Calibration {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        why: serde_json::Error,
    },
    /// The images can't be read as a pair.
    #[error("{0}")]
    Data(ServiceError),
    /// A file can't be read or written.
    #[error("can't {action} {path}: {why}")]
    Io {
        /// `read` or `write`.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system said.
        why: std::io::Error,
    },
    /// The worker can't be started.
    #[error(transparent)]
    Start(#[from] StartError),
    /// Any other refusal.
    #[error("{0}")]
    Refused(ServiceError),
}

impl OfflineError {
    /// The process's exit code, by the names of sysexits.h.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Usage(_) | Self::Start(StartError::Config(_)) => 64,
            Self::Data(_) | Self::Calibration { .. } => 65,
            Self::Refused(_) => 70,
            Self::Start(_) => 71,
            Self::Io { .. } => 74,
        }
    }
}

/// Matches the pair, writes the files and prints where they are and what they took.
///
/// # Errors
/// [`OfflineError`]; nothing is written unless everything was made.
pub async fn run(args: &MatchArgs) -> Result<(), OfflineError> {
    let service = start(args)?;
    // A worker that could not match its dummy pair says so in the log, and will say it again about this pair.
    service.primed().await;
    let frame = request(args)?;
    let asked = frame.options.max_iterations;
    let names = frame.options.params.rung_names();
    let bar = progress_bar(asked.map_or(names.len(), |asked| names.len().min(asked.into())));
    let delivery = Delivery {
        on_rung: Some(advance(bar.clone(), names)),
        ..Delivery::default()
    };
    let outcome = service.submit_with(frame, delivery).await;
    bar.finish_and_clear();
    let reply = outcome.map_err(|error| match error {
        ServiceError::Invalid(_) | ServiceError::Unmatchable(_) | ServiceError::TooLarge(_) => {
            OfflineError::Data(error)
        }
        error => OfflineError::Refused(error),
    })?;
    let written = write(&args.out, &reply)?;
    summary::print(&reply.report, &written).map_err(|why| io("write", Path::new("standard output"))(why))?;
    service.drain().await;
    Ok(())
}

/// One worker, no sockets.
fn start(args: &MatchArgs) -> Result<Arc<Service>, OfflineError> {
    let workers = WorkersConfig {
        count: 1,
        simd: args.simd.clone(),
        ..WorkersConfig::default()
    };
    let config = Config {
        instance: "stereod-match".to_owned(),
        workers,
        ..Config::default()
    };
    Ok(Arc::new(Service::start(&config)?))
}

/// The request that the same files and options would be over HTTP, checked by the same code.
fn request(args: &MatchArgs) -> Result<FrameRequest, OfflineError> {
    let json = options::json(args)?;
    let options = request_from_form(FormParts {
        options: Some(json),
        ..FormParts::default()
    })
    .map_err(OfflineError::Usage)?;
    let [left, right] = [read(&args.left)?, read(&args.right)?];
    let has_shape = has_one_shape(&left, &right).map_err(OfflineError::Data)?;
    let images = FormParts {
        left: Some(left),
        right: Some(right),
        options: None,
    };
    let images = request_from_form(images).map_err(OfflineError::Data)?;
    let message = StereoRequest {
        left: images.left,
        right: images.right,
        ..options
    };
    let intake = Intake {
        received_at: Instant::now(),
        latency_budget: None,
        request_id: String::new(),
        formats: OUTPUTS.iter().map(|&(_, format)| format).collect(),
        max_image_px: Config::default().limits.image_pixels,
        caller: Caller::Stranger(String::new()),
        priority: PriorityClass::default(),
    };
    let fault = if has_shape {
        OfflineError::Usage
    } else {
        OfflineError::Data
    };
    frame_request(message, intake).map_err(fault)
}

/// Whether the images are of one size that can be matched: what is wrong with the request then is one of its options.
fn has_one_shape(left: &[u8], right: &[u8]) -> Result<bool, ServiceError> {
    let (_, width_px, height_px) = inspect(Side::Left, left)?;
    let (_, right_width_px, right_height_px) = inspect(Side::Right, right)?;
    let is_matchable = Shape::new(width_px as usize, height_px as usize).is_ok();
    Ok(is_matchable && (width_px, height_px) == (right_width_px, right_height_px))
}

/// A bar over the rungs; drawn only on a terminal.
fn progress_bar(rungs: usize) -> ProgressBar {
    let bar = ProgressBar::new(rungs as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:24} rung {pos} of {len} {msg} {elapsed_precise}") {
        bar.set_style(style);
    }
    bar
}

fn advance(bar: ProgressBar, names: Vec<&'static str>) -> OnRung {
    Box::new(move |quality| {
        bar.set_position(quality.rung.into());
        bar.set_message(
            names
                .get(usize::from(quality.rung).saturating_sub(1))
                .copied()
                .unwrap_or_default(),
        );
    })
}

fn read(path: &Path) -> Result<Bytes, OfflineError> {
    std::fs::read(path).map(Bytes::from).map_err(io("read", path))
}

/// Writes the files and returns their paths.
fn write(folder: &Path, reply: &FrameReply) -> Result<Vec<PathBuf>, OfflineError> {
    std::fs::create_dir_all(folder).map_err(io("make the folder", folder))?;
    let write = |(&(name, _), body): (&(&str, ReplyFormat), &Encoded)| {
        let path = folder.join(name);
        std::fs::write(&path, &**body).map_err(io("write", &path))?;
        Ok(path)
    };
    OUTPUTS.iter().zip(&reply.bodies).map(write).collect()
}

fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> OfflineError {
    let path = path.to_owned();
    move |why| OfflineError::Io { action, path, why }
}

#[cfg(test)]
mod tests;
