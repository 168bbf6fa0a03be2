//! `faults`: what becomes of requests when something fails, on the real server. Each fault is really provoked, under load; a table says
//! what the clients saw, how long it took until pairs were answered again, and what was lost.
//!
//! ```text
//! fault -> scene (server, hosts) -> clients (a steady load) -> row, and what it broke of what is promised
//! ```

mod clients;
mod fault;
mod links;
mod memory;
mod network;
mod pair;
mod process;
mod scene;
mod system;
mod table;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Parser;
use stereo_tests::network as hosts;
use stereo_tests::process::binary;
use stereo_tests::{machine, readme};

use crate::fault::Fault;
use crate::table::Row;

/// The exit code where a promise was broken.
const BROKEN: u8 = 2;

/// Provokes faults on the real server and says what became of its clients.
#[derive(Debug, Parser)]
struct Args {
    /// Only these, separated by commas.
    #[arg(long, value_enum, value_delimiter = ',')]
    only: Vec<Fault>,
    /// Write the table into this Markdown file.
    #[arg(long, value_name = "FILE")]
    write: Option<PathBuf>,
    /// This program is inside namespaces of its own already, which it makes by itself.
    #[arg(long, hide = true)]
    inside: bool,
}

fn main() -> Result<ExitCode> {
    let args = Args::parse();
    // Cargo would be no use inside.
    binary()?;
    if !args.inside && hosts::is_possible().is_ok() {
        let program = std::env::current_exe().context("this program's path is unknown")?;
        let status = hosts::inside(program)
            .args(std::env::args_os().skip(1))
            .arg("--inside")
            .status()?;
        let code = status.code().and_then(|code| u8::try_from(code).ok());
        return Ok(code.unwrap_or(1).into());
    }
    tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()?
        .block_on(run(&args))
}

#[expect(clippy::print_stdout, reason = "the table is what this program is for")]
async fn run(args: &Args) -> Result<ExitCode> {
    let faults = match args.only.as_slice() {
        [] => Fault::all(),
        only => only.to_vec(),
    };
    let mut rows = Vec::new();
    for fault in faults {
        if let Err(why) = fault.is_possible(args.inside) {
            println!("skipped: {} ({why})", fault.name());
            continue;
        }
        let row = fault.provoke().await.with_context(|| fault.name())?;
        println!("{}", row.markdown());
        rows.push(row);
    }
    let text = table::markdown(&rows, &machine::describe());
    println!("\n{text}");
    if let Some(path) = &args.write {
        readme::write_table(path, "faults", &text)?;
    }
    let broken: Vec<String> = rows.iter().filter_map(Row::broken_promise).collect();
    for why in &broken {
        println!("broken: {why}");
    }
    Ok(match broken.is_empty() {
        true => ExitCode::SUCCESS,
        false => BROKEN.into(),
    })
}
