//! The command line and the environment: the only file that knows that flags and variables exist.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::builder::BoolishValueParser;
use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::config::{Config, ConfigError, Fault, PolicyName, is_name};

/// Stereo matching as a service: a pair and a deadline in, the best disparity and mesh that fit out.
#[derive(Debug, Parser)]
#[command(name = "stereod", version, arg_required_else_help = true)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// Log filter: a level (error, warn, info, debug, trace), or directives such as `stereod=debug,info`.
    #[arg(
        long,
        global = true,
        env = "STEREOD_LOG",
        default_value = "info",
        value_name = "FILTER"
    )]
    pub log: String,
    /// Form of the log's lines: text, or json with a member for each field.
    #[arg(
        long,
        global = true,
        env = "STEREOD_LOG_FORMAT",
        default_value = "text",
        value_name = "text|json"
    )]
    pub log_format: LogFormat,
    /// Collector of OpenTelemetry that traces are sent to (OTLP over HTTP), such as http://127.0.0.1:4318; takes a build with the
    /// feature `otel`.
    #[arg(long, global = true, env = "STEREOD_OTLP", value_name = "URL")]
    pub otlp: Option<String>,
}

/// How a line of the log is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// For people.
    Text,
    /// For programs: an object a line.
    Json,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Serve over HTTP and Zenoh until SIGTERM or SIGINT.
    Serve(Box<ServeArgs>),
    /// Make a token for a client, and print it and what the server's configuration needs to know it by.
    Token {
        /// Name of the client, 1 to 64 of the characters A-Z a-z 0-9 _ . -
        #[arg(value_parser = client_name)]
        name: String,
    },
    /// Match one pair of image files here, without a network, and write the results to a folder.
    Match(Box<MatchArgs>),
}

/// Flags of `stereod serve`; each one given wins over the file and the defaults.
#[derive(Debug, Default, Args)]
pub struct ServeArgs {
    /// TOML file with any of the settings below; `stereod serve` logs all of them by their keys.
    #[arg(long, env = "STEREOD_CONFIG", value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Address and port to listen on [default: 127.0.0.1:8080]; port 0 lets the system choose one.
    #[arg(long, env = "STEREOD_HTTP", value_name = "ADDR:PORT", value_parser = socket_address)]
    pub http: Option<SocketAddr>,
    /// A second address, for `/metrics` and health, without TLS and tokens [default: none, `/metrics` is at --http].
    #[arg(long, env = "STEREOD_ADMIN", value_name = "ADDR:PORT", value_parser = socket_address)]
    pub admin: Option<SocketAddr>,
    /// The server's certificate chain, a PEM file: serve HTTPS instead of HTTP.
    #[arg(long, env = "STEREOD_TLS_CERT", value_name = "FILE")]
    pub tls_cert: Option<PathBuf>,
    /// The certificate's private key, a PEM file.
    #[arg(long, env = "STEREOD_TLS_KEY", value_name = "FILE")]
    pub tls_key: Option<PathBuf>,
    /// Authorities of clients' certificates, a PEM file: requests need such a certificate or a token.
    #[arg(long, env = "STEREOD_TLS_CLIENT_CA", value_name = "FILE")]
    pub tls_client_ca: Option<PathBuf>,
    /// Threads that compute [default: cores - 1, at least 1].
    #[arg(long, env = "STEREOD_WORKERS", value_name = "N")]
    pub workers: Option<u32>,
    /// Instruction-set level [default: auto = the machine's best]; a named one can only be lower.
    #[arg(long, env = "STEREOD_SIMD", value_name = "LEVEL")]
    pub simd: Option<String>,
    /// Name of this server in reports [default: stereod].
    #[arg(long, env = "STEREOD_INSTANCE", value_name = "NAME")]
    pub instance: Option<String>,
    /// Requests that wait for a worker at one time [default: 64].
    #[arg(long, env = "STEREOD_QUEUE_CAPACITY", value_name = "N")]
    pub queue_capacity: Option<u32>,
    /// Largest body of one request, in bytes [default: 64 MiB].
    #[arg(long, env = "STEREOD_MAX_BODY_BYTES", value_name = "BYTES")]
    pub max_body_bytes: Option<u64>,
    /// Most pixels of one image [default: 4096 x 4096].
    #[arg(long, env = "STEREOD_MAX_IMAGE_PIXELS", value_name = "PIXELS")]
    pub max_image_pixels: Option<u64>,
    /// Bodies of all requests under way, in bytes [default: 512 MiB].
    #[arg(long, env = "STEREOD_MAX_BYTES_IN_FLIGHT", value_name = "BYTES")]
    pub max_bytes_in_flight: Option<u64>,
    /// Connections open at one time [default: 1024].
    #[arg(long, env = "STEREOD_MAX_CONNECTIONS", value_name = "N")]
    pub max_connections: Option<u32>,
    /// Time to send a request's head, and for a connection to rest between two requests [default: 10000].
    #[arg(long, env = "STEREOD_HEADER_TIMEOUT_MS", value_name = "MS")]
    pub header_timeout_ms: Option<u64>,
    /// Time to send a request's body, and to take its answer [default: 30000].
    #[arg(long, env = "STEREOD_BODY_TIMEOUT_MS", value_name = "MS")]
    pub body_timeout_ms: Option<u64>,

    /// Requests and replies of all batches under way, in bytes [default: 128 MiB].
    #[arg(long, env = "STEREOD_MAX_BATCH_BYTES_IN_FLIGHT", value_name = "BYTES")]
    pub max_batch_bytes_in_flight: Option<u64>,

    /// Whether workers that have nothing to do help with the frames of others [default: off].
    #[arg(long, env = "STEREOD_SPLIT_FRAMES", value_name = "on|off", value_parser = BoolishValueParser::new())]
    pub split_frames: Option<bool>,

    /// Time without progress after which a worker is replaced [default: 20000].
    #[arg(long, env = "STEREOD_STUCK_AFTER_MS", value_name = "MS")]
    pub stuck_after_ms: Option<u64>,

    /// Workers that may be replaced before the server says that it isn't ready any more [default: 8].
    #[arg(long, env = "STEREOD_REPLACEMENTS", value_name = "N")]
    pub replacements: Option<u32>,

    /// Zenoh routers to connect to, such as tcp/router:7447, separated by commas: as a client, unless --zenoh-listen or the
    /// --zenoh-config says otherwise.
    #[arg(
        long,
        env = "STEREOD_ZENOH_CONNECT",
        value_name = "ENDPOINTS",
        value_delimiter = ','
    )]
    pub zenoh_connect: Vec<String>,

    /// Where to listen for Zenoh, separated by commas [default: tcp/127.0.0.1:0].
    #[arg(
        long,
        env = "STEREOD_ZENOH_LISTEN",
        value_name = "ENDPOINTS",
        value_delimiter = ','
    )]
    pub zenoh_listen: Vec<String>,

    /// Zenoh's own configuration (JSON5): TLS, passwords, access control, and everything else it knows.
    #[arg(long, env = "STEREOD_ZENOH_CONFIG", value_name = "FILE")]
    pub zenoh_config: Option<PathBuf>,

    /// Serve over HTTP alone.
    #[arg(long, env = "STEREOD_NO_ZENOH")]
    pub no_zenoh: bool,

    /// Not ready while Zenoh is connected to nobody it was told to connect to.
    #[arg(long, env = "STEREOD_REQUIRE_ZENOH")]
    pub require_zenoh: bool,

    /// How requests are ordered, admitted and ended [default: edf]. For comparison only: fifo (arrival order, all rungs, deadlines
    /// not looked at), fifo-timeout (and drops what waited too long), fixed:N (and N rungs for all).
    #[arg(long, env = "STEREOD_POLICY", value_name = "POLICY", hide_short_help = true)]
    pub policy: Option<PolicyName>,

    /// For tests of this program only: a worker panics at the N-th frame (panic@N) or gets stuck there (stuck@N).
    #[arg(long, env = "STEREOD_FAULT", value_name = "FAULT", hide = true)]
    pub fault: Option<Fault>,
}

/// Arguments of `stereod match`.
#[derive(Debug, Args)]
pub struct MatchArgs {
    /// Left image, PNG or JPEG.
    pub left: PathBuf,
    /// Right image of the same size, PNG or JPEG.
    pub right: PathBuf,
    /// Folder for disparity.png, disparity_color.png, mesh.glb, mesh.ply and report.json; made if it doesn't exist.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Algorithm parameters: default, fast or paper.
    #[arg(long)]
    pub preset: Option<String>,
    /// Disparities searched, in pixels: 16 to 256 in steps of 16.
    #[arg(long, value_name = "PX")]
    pub num_disparities: Option<u32>,
    /// Smallest disparity searched, in pixels.
    #[arg(long, value_name = "PX")]
    pub min_disparity: Option<i32>,
    /// Which pixels get a disparity: semi_dense or dense.
    #[arg(long)]
    pub density: Option<String>,
    /// Rungs to run at most, the first included.
    #[arg(long, value_name = "N")]
    pub max_iterations: Option<u32>,
    /// Drop pixels with less confidence, 0 to 1.
    #[arg(long, value_name = "SHARE")]
    pub min_confidence: Option<f64>,
    /// How far the disparity may be from a triangle of the mesh, in pixels, 0.1 to 64.
    #[arg(long, value_name = "PX")]
    pub mesh_tolerance: Option<f64>,
    /// Triangles of the mesh at most, 100 to 1000000.
    #[arg(long, value_name = "N")]
    pub max_triangles: Option<u32>,
    /// Time from start to result, in milliseconds.
    #[arg(long, value_name = "MS", default_value_t = 60_000.0)]
    pub latency_budget_ms: f64,
    /// Calibration file: JSON with focal_px, cx_px, cy_px, baseline_m and doffs_px.
    #[arg(long, value_name = "FILE", conflicts_with = "focal")]
    pub calibration: Option<PathBuf>,
    /// Focal length in pixels; with --cx, --cy and --baseline the mesh is in metres.
    #[arg(long, value_name = "PX", requires_all = ["cx", "cy", "baseline"])]
    pub focal: Option<f64>,
    /// Principal point of the left image, column in pixels.
    #[arg(long, value_name = "PX", requires = "focal")]
    pub cx: Option<f64>,
    /// Principal point of the left image, row in pixels.
    #[arg(long, value_name = "PX", requires = "focal")]
    pub cy: Option<f64>,
    /// Distance of the two cameras in metres.
    #[arg(long, value_name = "M", requires = "focal")]
    pub baseline: Option<f64>,
    /// cx of the right image minus cx of the left one, in pixels [default: 0].
    #[arg(long, value_name = "PX", requires = "focal", allow_negative_numbers = true)]
    pub doffs: Option<f64>,
    /// Instruction-set level: auto, or the name of a lower one than the machine's best.
    #[arg(long, env = "STEREOD_SIMD", default_value = "auto", value_name = "LEVEL")]
    pub simd: String,
}

impl ServeArgs {
    /// The effective configuration: these flags over the file over the defaults, validated.
    ///
    /// # Errors
    /// [`ConfigError`] if the file can't be read or any value is not acceptable.
    pub fn into_config(self) -> Result<Config, ConfigError> {
        let mut config = match &self.config {
            None => Config::default(),
            Some(path) => {
                let name = path.display().to_string();
                let text = std::fs::read_to_string(path).map_err(|error| ConfigError::Unreadable {
                    path: name.clone(),
                    reason: error.to_string(),
                })?;
                Config::from_toml(&text, &name)?
            }
        };
        give(&mut config.http.listen, self.http);
        give(&mut config.http.admin, self.admin.map(Some));
        let tls = &mut config.http.tls;
        for (setting, flag) in [
            (&mut tls.cert, self.tls_cert),
            (&mut tls.key, self.tls_key),
            (&mut tls.client_ca, self.tls_client_ca),
        ] {
            give(setting, flag.map(Some));
        }
        give(&mut config.http.connections, self.max_connections);
        give(
            &mut config.http.header_timeout,
            self.header_timeout_ms.map(Duration::from_millis),
        );
        give(
            &mut config.http.body_timeout,
            self.body_timeout_ms.map(Duration::from_millis),
        );
        for (setting, flag) in [
            (&mut config.zenoh.connect, self.zenoh_connect),
            (&mut config.zenoh.listen, self.zenoh_listen),
        ] {
            give(setting, Some(flag).filter(|endpoints| !endpoints.is_empty()));
        }
        give(&mut config.zenoh.file, self.zenoh_config.map(Some));
        config.zenoh.enabled &= !self.no_zenoh;
        config.zenoh.required |= self.require_zenoh;
        give(&mut config.workers.count, self.workers);
        give(&mut config.workers.simd, self.simd);
        give(&mut config.workers.queue_capacity, self.queue_capacity);
        give(&mut config.workers.policy, self.policy);
        give(&mut config.workers.split_frames, self.split_frames);
        give(
            &mut config.workers.stuck_after,
            self.stuck_after_ms.map(Duration::from_millis),
        );
        give(&mut config.workers.replacements, self.replacements);
        give(&mut config.workers.fault, self.fault.map(Some));
        give(&mut config.instance, self.instance);
        give(&mut config.limits.body_bytes, self.max_body_bytes);
        give(&mut config.limits.image_pixels, self.max_image_pixels);
        give(&mut config.limits.bytes_in_flight, self.max_bytes_in_flight);
        give(
            &mut config.limits.batch_bytes_in_flight,
            self.max_batch_bytes_in_flight,
        );
        config.validate()?;
        Ok(config)
    }
}

fn socket_address(text: &str) -> Result<SocketAddr, String> {
    text.parse()
        .map_err(|_| "give a numeric address and a port, such as 127.0.0.1:8080 or [::]:8080".to_owned())
}

fn client_name(text: &str) -> Result<String, String> {
    match is_name(text) {
        true => Ok(text.to_owned()),
        false => Err("give 1 to 64 of the characters A-Z a-z 0-9 _ . -".to_owned()),
    }
}

fn give<T>(setting: &mut T, flag: Option<T>) {
    if let Some(value) = flag {
        *setting = value;
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    fn serve(flags: &[&str]) -> Box<ServeArgs> {
        match Cli::try_parse_from(["stereod", "serve"].iter().chain(flags))
            .unwrap()
            .command
        {
            Command::Serve(args) => args,
            Command::Match(_) | Command::Token { .. } => unreachable!("`serve` was given"),
        }
    }

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn every_setting_that_has_a_flag_has_a_variable_of_its_name() {
        let cli = Cli::command();
        let serve = cli.find_subcommand("serve").unwrap();
        for arg in serve
            .get_arguments()
            .filter(|arg| arg.get_id() != "help" && arg.get_id() != "log")
        {
            let variable = format!(
                "STEREOD_{}",
                arg.get_long().unwrap().replace('-', "_").to_uppercase()
            );
            assert_eq!(
                arg.get_env().and_then(|env| env.to_str()),
                Some(variable.as_str())
            );
        }
    }

    #[test]
    fn flags_win_over_the_file_and_the_file_over_the_defaults() {
        let file = std::env::temp_dir().join(format!("stereod-args-{}.toml", std::process::id()));
        std::fs::write(&file, "[workers]\ncount = 3\nqueue_capacity = 9\n").unwrap();
        let config = serve(&["--config", file.to_str().unwrap(), "--workers", "5"]).into_config();
        std::fs::remove_file(&file).unwrap();
        let config = config.unwrap();
        assert_eq!(config.workers.count, 5);
        assert_eq!(config.workers.queue_capacity, 9);
        assert_eq!(config.http.connections, Config::default().http.connections);
    }

    #[test]
    fn frames_are_split_only_when_asked_for() {
        let split = |flags: &[&str]| serve(flags).into_config().unwrap().workers.split_frames;
        assert!(!split(&[]));
        assert!(split(&["--split-frames", "on"]));
        assert!(!split(&["--split-frames", "off"]));
    }

    #[test]
    fn a_missing_file_is_named() {
        let error = serve(&["--config", "no/such.toml"])
            .into_config()
            .unwrap_err()
            .to_string();
        assert!(error.contains("no/such.toml"), "{error}");
    }
}
