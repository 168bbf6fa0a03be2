//! Where logs and traces go.

use std::io::{IsTerminal, stderr};

use tokio::runtime::Handle;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer, fmt};

use crate::args::{Cli, LogFormat};
use crate::traces::Traces;

/// Writes logs to stderr, and sends traces if a collector is named, from now on. What comes back delivers the last traces.
///
/// # Errors
/// The flag that is not acceptable, and why.
pub fn start(cli: &Cli, runtime: &Handle) -> Result<Option<Traces>, String> {
    let filter = EnvFilter::try_new(&cli.log).map_err(|why| format!("--log {}: {why}", cli.log))?;
    let collector = cli.otlp.as_deref();
    let traces =
        collector.map(|endpoint| Traces::start(endpoint, runtime).map_err(|why| format!("--otlp {why}")));
    let traces = traces.transpose()?;
    // Where the log can't be written, its disk full or its reader gone, nobody can be told so: trying to would panic.
    let lines = fmt::layer().with_writer(stderr).log_internal_errors(false);
    let lines = match cli.log_format {
        LogFormat::Text => lines.with_ansi(stderr().is_terminal()).boxed(),
        LogFormat::Json => lines.json().flatten_event(true).with_span_list(false).boxed(),
    };
    tracing_subscriber::registry()
        .with(lines.with_filter(filter))
        .with(traces.as_ref().map(Traces::layer))
        .init();
    Ok(traces)
}
