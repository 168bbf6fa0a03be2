//! `load --suite soak`: mixed load on the real server for a given time. Fails if its memory, its descriptors, its threads or its tasks
//! grow, if fewer frames are in budget than at first, if anything is answered as nothing should be, or if something is left afterwards.

mod mixture;
mod report;
mod sample;
mod tally;
mod verdict;

use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use indicatif::ProgressBar;
use stereo_tests::process::{Launch, Stereod};
use stereo_tests::{machine, readme};
use tokio::time::{Instant, sleep, sleep_until};

use self::mixture::Mixture;
use self::report::Report;
use self::sample::Sample;
use self::tally::Tally;
use crate::args::Args;
use crate::zenoh::endpoint;
use crate::{NOT_KEPT, STARTED_WITHIN, progress_bar, wait_until_ready};

/// Time between two looks at the server.
const LOOK_EVERY: Duration = Duration::from_secs(5);
/// How long connections and sessions may take to end after the load: longer than the server lets them rest.
const GONE_WITHIN: Duration = Duration::from_secs(30);

/// Loads a server for `--seconds`; the exit code says whether it held.
#[expect(clippy::print_stdout, reason = "the verdict is what this program is for")]
pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    let time = jiff::Timestamp::now().strftime("%Y-%m-%dT%H%M%SZ").to_string();
    let server = Stereod::launch(&Launch {
        program: args.stereod.as_deref(),
        args: &["--workers", "1"],
        ..Launch::default()
    })?;
    wait_until_ready(server.url(), STARTED_WITHIN)?;
    let tally = Arc::new(Tally::default());
    let bar = progress_bar(
        Duration::try_from_secs_f64(args.seconds)?.as_secs(),
        "{bar:30} {elapsed} of {len} s  {msg}",
    )?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()?;
    let (samples, left) = runtime.block_on(soak(&server, args.seconds, &tally, &bar))?;
    bar.finish_and_clear();
    let status = server.stop()?;
    ensure!(status.success(), "the server ended with {status}");
    let mut verdict = verdict::judge(&samples)?;
    verdict.failures.extend(left);
    let machine = machine::describe();
    let report = Report {
        time: &time,
        machine: &machine,
        samples: &samples,
        verdict: &verdict,
    };
    let table = report.markdown();
    println!("{table}");
    for (why, times) in tally.why_broken() {
        println!("{times} times: {why}");
    }
    let (csv, picture) = (report.csv(), report.picture()?);
    save(&args.out, &format!("{time}-soak"), &csv, &picture)?;
    if let Some(path) = &args.write {
        let beside = path.parent().unwrap_or(Path::new("")).join("tests/data");
        save(&beside, "soak", &csv, &picture)?;
        let with_picture = format!("![A server through the soak](tests/data/soak.svg)\n\n{table}");
        readme::write_table(path, "soak", &with_picture)?;
    }
    Ok(match verdict.failures.is_empty() {
        true => ExitCode::SUCCESS,
        false => ExitCode::from(NOT_KEPT),
    })
}

/// Writes both files.
fn save(folder: &Path, name: &str, csv: &str, picture: &str) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("can't make {}", folder.display()))?;
    for (ending, content) in [("csv", csv), ("svg", picture)] {
        let path = folder.join(format!("{name}.{ending}"));
        std::fs::write(&path, content).with_context(|| format!("can't write {}", path.display()))?;
    }
    Ok(())
}

/// The looks at the server, and what is left of the load after it.
async fn soak(
    server: &Stereod,
    seconds: f64,
    tally: &Arc<Tally>,
    bar: &ProgressBar,
) -> Result<(Vec<Sample>, Vec<String>)> {
    let http = stereo_tests::http::builder().no_proxy().build()?;
    let endpoint = endpoint(server.url()).await?;
    let look = async |seconds: f64| Sample::take(server, &http, seconds, tally.counts()).await;
    let before = look(0.0).await?;
    let mut samples = vec![before];
    let mut mixture = Mixture::start(server.url(), &endpoint, tally)?;
    let start = Instant::now();
    let end = start + Duration::try_from_secs_f64(seconds)?;
    let mut next = start;
    while next < end {
        next += LOOK_EVERY;
        sleep_until(next.min(end)).await;
        if let Some(why) = mixture.ended() {
            return Err(why.context("the load broke off"));
        }
        let sample = look(start.elapsed().as_secs_f64()).await?;
        bar.set_position(start.elapsed().as_secs());
        let [megabytes, descriptors] = [sample.resident_bytes / 1_000_000, sample.descriptors];
        bar.set_message(format!(
            "{megabytes} MB, {descriptors} descriptors, {} tasks",
            sample.tasks
        ));
        samples.push(sample);
    }
    mixture.stop().await?;
    // Connections rest for a while before they end.
    let patience = Instant::now() + GONE_WITHIN;
    loop {
        let left = verdict::remains(&before, &look(start.elapsed().as_secs_f64()).await?);
        if left.is_empty() || Instant::now() > patience {
            return Ok((samples, left));
        }
        sleep(Duration::from_millis(200)).await;
    }
}
