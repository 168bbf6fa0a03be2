//! The command line and the environment: the only file that knows that flags and variables exist.

use std::path::PathBuf;
use std::time::Duration;

use clap::builder::NonEmptyStringValueParser;
use clap::{Args, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;

use crate::failure::EXIT_CODES;
use crate::server::Address;

/// Stereo matching at the command line: a pair and a latency budget in, disparity and mesh out.
#[derive(Debug, Parser)]
#[command(name = "stereo", version, arg_required_else_help = true, after_help = EXIT_CODES)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
    /// Print JSON, one object a line, and nothing else. Failures are objects too, with `error` and `exit_code`.
    #[arg(long, global = true)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) server: ServerArgs,
}

/// Where the server is, and how it is reached.
#[derive(Debug, Args)]
#[command(next_help_heading = "Server")]
pub(crate) struct ServerArgs {
    /// Where it is: http://HOST:PORT, https://HOST:PORT, or zenoh://HOST:PORT for all servers of a Zenoh network.
    #[arg(
        long,
        global = true,
        env = "STEREO_SERVER",
        default_value = "http://127.0.0.1:8080",
        value_name = "ADDRESS"
    )]
    pub(crate) server: Address,
    /// Token for HTTP, as `stereod token` prints it, or @FILE with it.
    #[arg(
        long,
        global = true,
        env = "STEREO_TOKEN",
        hide_env_values = true,
        value_name = "TOKEN|@FILE"
    )]
    pub(crate) token: Option<String>,
    /// Certificate (PEM) of the authority that the server's is signed by [default: those that this system trusts].
    #[arg(long, global = true, env = "STEREO_CA", value_name = "FILE")]
    pub(crate) ca: Option<PathBuf>,
    /// Certificate (PEM) of this client, for servers that ask for one; with its key, or that in --key.
    #[arg(long, global = true, env = "STEREO_CERT", value_name = "FILE")]
    pub(crate) cert: Option<PathBuf>,
    /// Private key (PEM) of --cert.
    #[arg(long, global = true, env = "STEREO_KEY", value_name = "FILE")]
    pub(crate) key: Option<PathBuf>,
    /// Zenoh's own configuration (JSON5), for its TLS and passwords.
    #[arg(long, global = true, env = "STEREO_ZENOH_CONFIG", value_name = "FILE")]
    pub(crate) zenoh_config: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Match a pair or a folder of pairs, each within its budget, and write what comes back.
    Match(MatchArgs),
    /// Match folders of pairs as one batch: in the background, as fast as the server can, in constant memory (HTTP).
    Batch(BatchArgs),
    /// Play a folder of pairs as a camera over Zenoh.
    Stream(StreamArgs),
    /// Show cameras and servers, live: rates, latencies, drops.
    Watch(WatchArgs),
    /// Say what a server is and what it can do.
    Info,
    /// Send pairs for some seconds, and say how long the answers took.
    Bench(BenchArgs),
    /// Find out why nothing comes out: checks, step by step, from the server to the cameras' frames.
    Doctor(DoctorArgs),
    /// Print a script that completes this program's arguments in a shell.
    #[command(
        after_help = "For example: stereo completions bash > ~/.local/share/bash-completion/completions/stereo"
    )]
    Completions {
        /// For which shell.
        shell: Shell,
    },
}

/// What is wanted of each pair.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Matching")]
pub(crate) struct MatchingArgs {
    /// Latency budget of a pair, such as 50ms or 1.5s [default: the server's, 100ms].
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub(crate) budget: Option<Duration>,
    /// Algorithm parameters: default, fast or paper.
    #[arg(long, value_parser = NonEmptyStringValueParser::new())]
    pub(crate) preset: Option<String>,
    /// A disparity for every pixel, instead of those with texture.
    #[arg(long)]
    pub(crate) dense: bool,
    /// Disparities searched, in pixels: 16 to 256 in steps of 16 [default: 128].
    #[arg(long, value_name = "PX")]
    pub(crate) num_disparities: Option<u32>,
    /// Smallest disparity searched, in pixels [default: 0].
    #[arg(long, value_name = "PX", allow_negative_numbers = true)]
    pub(crate) min_disparity: Option<i32>,
    /// Drops pixels with less confidence, 0 to 1 [default: 0].
    #[arg(long, value_name = "SHARE")]
    pub(crate) min_confidence: Option<f32>,
    /// Rungs of the ladder at most [default: all].
    #[arg(long, value_name = "N")]
    pub(crate) max_iterations: Option<u32>,
    /// Let the server match at half resolution rather than refuse.
    #[arg(long)]
    pub(crate) allow_downscale: bool,
    /// Calibration, for metres: JSON (focal_px, cx_px, cy_px, baseline_m, doffs_px), KITTI's or Middlebury's text, or ROS' camera_info of
    /// the right camera (given twice: left and right).
    #[arg(long, value_name = "FILE")]
    pub(crate) calibration: Vec<PathBuf>,
    /// Any other option, as JSON with the names it has over HTTP, or @FILE with that; flags win.
    #[arg(long, value_name = "JSON|@FILE")]
    pub(crate) options: Option<String>,
}

/// What is written, and where.
#[derive(Debug, Args)]
#[command(next_help_heading = "Files")]
pub(crate) struct FilesArgs {
    /// A file, whose ending says its kind, or a folder, which is made if it isn't there. Nothing is written without.
    #[arg(long, short, value_name = "FILE|DIR")]
    pub(crate) output: Option<PathBuf>,
    /// Kinds of files [default: by the file's ending; png and color in a folder].
    #[arg(long, short, value_delimiter = ',', value_name = "KIND")]
    pub(crate) format: Vec<Format>,
}

/// Kinds of files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Format {
    /// Disparity as a 16-bit PNG, px x 256, 0 = none (KITTI's convention).
    Png,
    /// Disparity in colours, as a PNG.
    Color,
    /// Disparity in px as floats, infinite = none (Middlebury's convention).
    Pfm,
    /// Disparity in px as a NumPy array of floats, NaN = none.
    Npy,
    /// Mesh with the left image's colours.
    Ply,
    /// Mesh with the left image as its texture (binary glTF).
    Glb,
}

#[derive(Debug, Args)]
pub(crate) struct MatchArgs {
    /// Left image (PNG or JPEG), a folder of left images, or a folder of pairs.
    pub(crate) left: PathBuf,
    /// Right image, or a folder with right images of the same names.
    pub(crate) right: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) matching: MatchingArgs,
    #[command(flatten)]
    pub(crate) files: FilesArgs,
}

#[derive(Debug, Args)]
pub(crate) struct BatchArgs {
    /// Folders of pairs: left/ and right/, image_2/ and image_3/, image_0/ and image_1/, or x_left.png and x_right.png.
    #[arg(required = true, value_name = "FOLDER")]
    pub(crate) folders: Vec<PathBuf>,
    #[command(flatten)]
    pub(crate) matching: MatchingArgs,
    #[command(flatten)]
    pub(crate) files: FilesArgs,
}

#[derive(Debug, Args)]
pub(crate) struct StreamArgs {
    /// Folder of pairs, in their natural order.
    pub(crate) folder: PathBuf,
    /// The camera's name.
    #[arg(long, default_value = "stereo-cli", value_name = "NAME", value_parser = camera_name)]
    pub(crate) camera: String,
    /// Frames a second.
    #[arg(long, default_value_t = 30.0, value_name = "HZ", value_parser = rate)]
    pub(crate) rate: f64,
    /// How many times the folder is played; 0 = until Ctrl-C.
    #[arg(long, default_value_t = 1, value_name = "N")]
    pub(crate) repeat: u64,
    #[command(flatten)]
    pub(crate) matching: MatchingArgs,
}

#[derive(Debug, Args)]
pub(crate) struct WatchArgs {
    /// Show what is there now, once.
    #[arg(long)]
    pub(crate) once: bool,
    /// Time between two looks.
    #[arg(long, default_value = "1s", value_name = "TIME", value_parser = duration)]
    pub(crate) interval: Duration,
}

#[derive(Debug, Args)]
pub(crate) struct BenchArgs {
    /// Left image; without images, a pair of noise is sent.
    #[arg(requires = "right")]
    pub(crate) left: Option<PathBuf>,
    /// Right image.
    pub(crate) right: Option<PathBuf>,
    /// Size of the pair of noise, raw 8-bit gray.
    #[arg(long, default_value = "640x480", value_name = "WIDTHxHEIGHT", value_parser = size, conflicts_with = "left")]
    pub(crate) size: (u32, u32),
    /// Pairs a second, whether or not answers come: latency counts from when a pair was due.
    #[arg(long, value_name = "HZ", value_parser = rate, conflicts_with = "concurrency")]
    pub(crate) rate: Option<f64>,
    /// Pairs under way at a time, the next one as soon as one is answered.
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub(crate) concurrency: u16,
    /// For how long pairs are sent.
    #[arg(long, default_value = "5s", value_name = "TIME", value_parser = duration)]
    pub(crate) duration: Duration,
    #[command(flatten)]
    pub(crate) matching: MatchingArgs,
}

#[derive(Debug, Args)]
pub(crate) struct DoctorArgs {
    /// The camera that should give results; without, every camera there is.
    #[arg(long, value_name = "NAME", value_parser = camera_name)]
    pub(crate) camera: Option<String>,
    /// Address of the Zenoh router that cameras use [default: where the server listens].
    #[arg(long, value_name = "ADDRESS")]
    pub(crate) router: Option<Address>,
    /// Size of the cameras' images, for the check of the link.
    #[arg(long, default_value = "640x480", value_name = "WIDTHxHEIGHT", value_parser = size)]
    pub(crate) size: (u32, u32),
    /// Frames a second of a camera, for the check of the link.
    #[arg(long, default_value_t = 30.0, value_name = "HZ", value_parser = rate)]
    pub(crate) rate: f64,
    /// Latency budget of a frame.
    #[arg(long, default_value = "100ms", value_name = "TIME", value_parser = duration)]
    pub(crate) budget: Duration,
    /// For how long the frames of cameras are counted.
    #[arg(long, default_value = "2s", value_name = "TIME", value_parser = duration)]
    pub(crate) watch: Duration,
}

/// `50ms`, `1.5s`, `2m`.
fn duration(text: &str) -> Result<Duration, String> {
    let help = "give a time above 0 with its unit, such as 50ms, 1.5s or 2m";
    let digits = text
        .find(|c: char| !c.is_ascii_digit() && c != '.')
        .unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let seconds = match unit {
        "ms" => 1e-3,
        "s" => 1.0,
        "m" => 60.0,
        _ => return Err(help.to_owned()),
    };
    let number: f64 = number.parse().map_err(|_| help.to_owned())?;
    let time = Duration::try_from_secs_f64(number * seconds).map_err(|why| why.to_string())?;
    if time.is_zero() {
        Err(help.to_owned())
    } else {
        Ok(time)
    }
}

fn rate(text: &str) -> Result<f64, String> {
    let rate: Option<f64> = text.parse().ok();
    rate.filter(|rate| (0.01..=10_000.0).contains(rate))
        .ok_or_else(|| "give a rate of 0.01 to 10000 a second".to_owned())
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let sides = text
        .split_once('x')
        .and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    sides
        .filter(|(width, height)| (32..=4096).contains(width) && (32..=4096).contains(height))
        .ok_or_else(|| "give width and height of 32 to 4096 px, such as 640x480".to_owned())
}

fn camera_name(text: &str) -> Result<String, String> {
    let is_valid = |c: char| c.is_ascii_alphanumeric() || "_.-".contains(c);
    if (1..=64).contains(&text.len()) && text.chars().all(is_valid) {
        Ok(text.to_owned())
    } else {
        Err("a camera's name has 1 to 64 letters, digits, `_`, `.` and `-`".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn times_have_units() {
        assert_eq!(duration("50ms"), Ok(Duration::from_millis(50)));
        assert_eq!(duration("1.5s"), Ok(Duration::from_millis(1500)));
        assert_eq!(duration("2m"), Ok(Duration::from_mins(2)));
        for wrong in ["50", "ms", "0s", "-1s", "1h", "1e99s", ""] {
            assert!(duration(wrong).is_err(), "{wrong}");
        }
    }
}
