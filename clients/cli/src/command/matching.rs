//! `stereo match`: pairs one after the other, each within its budget.

use std::path::PathBuf;

use serde_json::{Value, json};
use stereo_client::v1::StereoResult;

use crate::args::MatchArgs;
use crate::failure::{Failure, Kind};
use crate::file::Target;
use crate::options::Wanted;
use crate::output::{Output, complain};
use crate::pairs::{self, Pair};
use crate::report::{report_json, summary};
use crate::server::{Place, Server};

pub(crate) async fn run(args: MatchArgs, place: &Place, output: Output) -> Result<(), Failure> {
    let pairs = pairs::find(&args.left, args.right.as_deref())?;
    let mut wanted = Wanted::from_args(&args.matching, pairs::first_left(&pairs))?;
    let target = Target::new(&args.files, pairs.len())?;
    wanted.want_outputs(&target.parts());
    let server = place.connect().await?;
    if let [pair] = pairs.as_slice() {
        let (result, files) = one(pair, &server, &wanted, &target).await?;
        return done(output, pair, &result, &files);
    }
    let bar = output.progress(Some(pairs.len() as u64));
    let mut worst = None;
    for pair in &pairs {
        bar.set_message(pair.name.clone());
        match one(pair, &server, &wanted, &target).await {
            Ok((result, files)) => bar.suspend(|| done(output, pair, &result, &files))?,
            Err(failure) => {
                worst = Some(failure.kind.worse(worst));
                bar.suspend(|| not_done(output, &pair.name, &failure))?;
                // The next one would fail as well.
                if failure.kind == Kind::Unreachable {
                    break;
                }
            }
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    match worst {
        None => Ok(()),
        Some(kind) => Err(Failure::new(
            kind,
            format!("not all of {} pairs were matched: see above", pairs.len()),
        )),
    }
}

async fn one(
    pair: &Pair,
    server: &Server,
    wanted: &Wanted,
    target: &Target,
) -> Result<(StereoResult, Vec<PathBuf>), Failure> {
    let request = wanted.request(pair.read()?);
    let result = server.match_pair(&request).await?;
    let files = target.write(&pair.name, &request.left.unwrap_or_default(), &result)?;
    Ok((result, files))
}

/// Says what came of a pair.
pub(crate) fn done(
    output: Output,
    pair: &Pair,
    result: &StereoResult,
    files: &[PathBuf],
) -> Result<(), Failure> {
    let names: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
    let report: Option<Value> = result.report.as_ref().map(report_json);
    output.json(&json!({ "pair": pair.name, "report": report, "files": names }))?;
    let written = match names.as_slice() {
        [] => String::new(),
        names => format!(" -> {}", names.join(", ")),
    };
    output.text(&format!("{}: {}{written}", pair.name, summary(result)))
}

/// Says why nothing came of a pair.
pub(crate) fn not_done(output: Output, name: &str, failure: &Failure) -> Result<(), Failure> {
    if output.is_json {
        let mut line = failure.to_json();
        line["pair"] = json!(name);
        return output.json(&line);
    }
    complain(&Failure {
        message: format!("{name}: {}", failure.message),
        ..failure.clone()
    });
    Ok(())
}
