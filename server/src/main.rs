//! The stereod binary: arguments, configuration, logs, runtime, serve, drain, exit code.

use std::fmt::Display;
use std::io::{Write, stderr, stdout};
use std::process::ExitCode;

use clap::Parser;
use stereod::args::{Cli, Command};
use stereod::config::Config;
use stereod::shutdown::StopSignals;
use stereod::token::NewToken;
use stereod::{Server, StartError, allocator, logs, offline};

/// Bad flags or configuration (sysexits.h: EX_USAGE).
const USAGE: u8 = 64;
/// Stopped before everything was finished (EX_SOFTWARE).
const UNFINISHED: u8 = 70;
/// The system refuses sockets, threads or signals (EX_OSERR).
const SYSTEM: u8 = 71;

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version go to stdout and are no error; nothing can be done if even this can't be written.
            drop(error.print());
            return ExitCode::from(if error.use_stderr() { USAGE } else { 0 });
        }
    };
    if matches!(cli.command, Command::Serve(_)) {
        allocator::give_back();
    }
    run(cli).err().unwrap_or(ExitCode::SUCCESS)
}

/// Says on stderr why the process ends, and with which code.
fn fail<E: Display>(code: u8) -> impl Fn(E) -> ExitCode {
    move |error| {
        // The exit code says it too, should nobody be able to read this.
        let _ = writeln!(stderr(), "stereod: {error}");
        ExitCode::from(code)
    }
}

fn run(cli: Cli) -> Result<(), ExitCode> {
    let runtime = tokio::runtime::Runtime::new().map_err(fail(SYSTEM))?;
    let traces = logs::start(&cli, runtime.handle()).map_err(fail(USAGE))?;
    let done = match cli.command {
        Command::Serve(args) => {
            let config = args.into_config().map_err(fail(USAGE))?;
            runtime.block_on(serve(config))
        }
        Command::Token { name } => {
            let text = NewToken::new().map_err(fail(SYSTEM))?.instructions(&name);
            let written = stdout().write_all(text.as_bytes());
            written.and_then(|()| stdout().flush()).map_err(fail(SYSTEM))
        }
        Command::Match(args) => {
            let matched = runtime.block_on(offline::run(&args));
            matched.map_err(|error| fail(error.exit_code())(error))
        }
    };
    if let Some(traces) = traces {
        traces.finish();
    }
    done
}

async fn serve(config: Config) -> Result<(), ExitCode> {
    // A struct of numbers and strings always serialises.
    let effective = serde_json::to_string(&config).unwrap_or_default();
    tracing::info!(
        version = env!("CARGO_PKG_VERSION"),
        config = effective,
        "effective configuration"
    );
    let mut signals = StopSignals::new().map_err(fail(SYSTEM))?;
    let server = Server::start(config).await.map_err(|error| match error {
        StartError::Config(_) => fail(USAGE)(error),
        _ => fail(SYSTEM)(error),
    })?;
    // For people, and for programs that asked for port 0; a closed stdout is no reason not to serve.
    let admin = server
        .admin_addr
        .map(|addr| format!("stereod admin on http://{addr}\n"));
    let scheme = if server.is_encrypted { "https" } else { "http" };
    let line = format!(
        "{}stereod listening on {scheme}://{}\n",
        admin.unwrap_or_default(),
        server.http_addr
    );
    let _ = stdout()
        .write_all(line.as_bytes())
        .and_then(|()| stdout().flush());
    let signal = tokio::select! {
        signal = signals.next() => signal,
        () = log_readiness(&server) => signals.next().await,
    };
    tracing::info!(signal, "stopping: no new work, finishing what was admitted");
    tokio::select! {
        () = server.shutdown() => {
            tracing::info!("stopped");
            Ok(())
        }
        again = signals.next() => Err(fail(UNFINISHED)(format!("{again} again, not everything was finished"))),
    }
}

async fn log_readiness(server: &stereod::Running) {
    match server.ready().await {
        true => tracing::info!("ready"),
        false => tracing::error!("not ready: a worker could not match its dummy pair"),
    }
}
