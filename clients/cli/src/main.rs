//! `stereo`: stereod at the command line.
#![forbid(unsafe_code)]

mod args;
mod calibration;
mod command;
mod failure;
mod file;
mod latency;
mod options;
mod output;
mod pairs;
mod report;
mod server;

use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, Parser};

use crate::args::{Cli, Command};
use crate::failure::Failure;
use crate::output::Output;
use crate::server::Place;

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return misused(&error),
    };
    let output = Output { is_json: cli.json };
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build();
    let outcome = match runtime {
        Ok(runtime) => {
            let outcome = runtime.block_on(run(cli, output));
            // What Zenoh still does in the background is of no use any more.
            runtime.shutdown_background();
            outcome
        }
        Err(why) => Err(Failure::failed(format!(
            "threads can't be started ({why}): raise the limit of threads"
        ))),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            output.failure(&failure);
            ExitCode::from(failure.kind.code())
        }
    }
}

/// What clap has to say: help, the version, or a mistake.
fn misused(error: &clap::Error) -> ExitCode {
    let is_json = std::env::args_os().any(|arg| arg == "--json");
    let is_mistake = !matches!(
        error.kind(),
        ErrorKind::DisplayHelp
            | ErrorKind::DisplayVersion
            | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand
    );
    if is_json && is_mistake {
        let text = error.render().to_string();
        let first = text
            .split("\n\n")
            .next()
            .unwrap_or_default()
            .trim_start_matches("error: ");
        Output { is_json }.failure(&Failure::usage(first.trim()));
    } else {
        // Nobody is left to tell if this fails.
        drop(error.print());
    }
    ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2))
}

async fn run(cli: Cli, output: Output) -> Result<(), Failure> {
    if let Command::Completions { shell } = cli.command {
        let mut script = Vec::new();
        clap_complete::generate(shell, &mut Cli::command(), "stereo", &mut script);
        let script = String::from_utf8_lossy(&script);
        output.json(&serde_json::json!({ "shell": shell.to_string(), "script": script }))?;
        return output.text(script.trim_end());
    }
    let server = &Place::new(cli.server)?;
    match cli.command {
        Command::Match(args) => command::matching::run(args, server, output).await,
        Command::Batch(args) => command::batch::run(args, server, output).await,
        Command::Bench(args) => command::bench::run(args, server, output).await,
        Command::Info => command::info::run(server, output).await,
        Command::Completions { .. } => Ok(()),
        Command::Stream(args) => command::stream::run(args, server, output).await,
        Command::Watch(args) => command::watch::run(args, server, output).await,
        Command::Doctor(args) => command::doctor::run(args, server, output).await,
    }
}
