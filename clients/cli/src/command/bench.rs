//! `stereo bench`: pairs for some seconds, at a rate whatever happens (open loop), or as answers come (closed loop).

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use bytes::Bytes;
use serde_json::json;
use stereo_client::v1::{Image, ImageEncoding, Output as Part, StereoRequest, StereoResult};
use tokio::task::JoinSet;

use crate::args::BenchArgs;
use crate::failure::{Failure, Kind};
use crate::latency::{Latencies, percent};
use crate::options::{Wanted, budget};
use crate::output::{Output, ms, table};
use crate::pairs;
use crate::server::{Place, Server};

/// Pairs under way at most: what more would only fill the memory.
const MOST_UNDER_WAY: usize = 4096;

/// What is known at the end.
struct Figures {
    latencies: Latencies,
    sent: u64,
    /// Due, but not sent, because too many were under way.
    held_back: u64,
    /// Rungs run and asked for.
    rungs: (u64, u64),
    failed: BTreeMap<String, u64>,
    worst: Option<Failure>,
}

pub(crate) async fn run(args: BenchArgs, place: &Place, output: Output) -> Result<(), Failure> {
    let mut wanted = Wanted::from_args(&args.matching, args.left.as_deref().unwrap_or(Path::new("")))?;
    wanted.want_outputs(&[Part::Disparity]);
    let images = match (&args.left, &args.right) {
        (Some(left), Some(right)) => match pairs::find(left, Some(right))?.first() {
            Some(pair) => pair.read()?,
            None => return Err(Failure::usage("there is no pair: give two image files")),
        },
        _ => noise(args.size),
    };
    let request = wanted.request(images);
    let budget = budget(&wanted.options);
    let server = place.connect().await?;
    // Connections are made, and mistakes found, before anything is counted.
    match server.match_pair(&request).await {
        Err(error) if error.status().is_none_or(|status| status.code < 500) => return Err(error.into()),
        _ => {}
    }
    let started = Instant::now();
    let figures = match args.rate {
        Some(rate) => open_loop(&server, &request, rate, args.duration, budget).await,
        None => closed_loop(&server, &request, args.concurrency, args.duration, budget).await,
    };
    report(&args, &figures, budget, started.elapsed(), output)?;
    match (figures.latencies.count(), figures.worst) {
        (0, Some(failure)) => Err(failure),
        (0, None) => Err(Failure::new(
            Kind::Failed,
            "nothing was sent: give a longer --duration",
        )),
        _ => Ok(()),
    }
}

impl Figures {
    fn new(budget: Duration) -> Self {
        Self {
            latencies: Latencies::new(budget),
            sent: 0,
            held_back: 0,
            rungs: (0, 0),
            failed: BTreeMap::new(),
            worst: None,
        }
    }

    fn add(&mut self, due: Instant, ended: Instant, outcome: Result<StereoResult, Failure>) {
        match outcome {
            Ok(result) => {
                self.latencies.add(ended.saturating_duration_since(due));
                if let Some(report) = &result.report {
                    self.rungs.0 += u64::from(report.iterations_run);
                    self.rungs.1 += u64::from(match report.has_converged {
                        true => report.iterations_run,
                        false => report.iterations_asked,
                    });
                }
            }
            Err(failure) => {
                let name = failure.reason.clone().unwrap_or_else(|| "NO_ANSWER".to_owned());
                *self.failed.entry(name).or_default() += 1;
                self.worst = Some(failure);
            }
        }
    }
}

type Ended = (Instant, Instant, Result<StereoResult, Failure>);

async fn send(server: Server, request: StereoRequest, due: Instant) -> Ended {
    let outcome = server.match_pair(&request).await.map_err(Failure::from);
    (due, Instant::now(), outcome)
}

/// Sends on time, whether or not answers come, and counts from then.
async fn open_loop(
    server: &Server,
    request: &StereoRequest,
    rate: f64,
    duration: Duration,
    budget: Duration,
) -> Figures {
    let mut figures = Figures::new(budget);
    let mut running = JoinSet::new();
    let started = Instant::now();
    let mut number = 0_u32;
    loop {
        let offset = Duration::from_secs_f64(f64::from(number) / rate);
        if offset >= duration {
            break;
        }
        let due = started + offset;
        tokio::select! {
            biased;
            () = tokio::time::sleep_until(due.into()) => {
                number += 1;
                if running.len() < MOST_UNDER_WAY {
                    figures.sent += 1;
                    running.spawn(send(server.clone(), request.clone(), due));
                } else {
                    figures.held_back += 1;
                }
            }
            Some(Ok((due, ended, outcome))) = running.join_next() => figures.add(due, ended, outcome),
        }
    }
    drain(figures, running).await
}

/// Keeps so many under way.
async fn closed_loop(
    server: &Server,
    request: &StereoRequest,
    concurrency: u16,
    duration: Duration,
    budget: Duration,
) -> Figures {
    let mut figures = Figures::new(budget);
    let mut running = JoinSet::new();
    let started = Instant::now();
    for _ in 0..concurrency {
        figures.sent += 1;
        running.spawn(send(server.clone(), request.clone(), Instant::now()));
    }
    while let Some(Ok((due, ended, outcome))) = running.join_next().await {
        let is_cut_off = matches!(&outcome, Err(failure) if failure.kind == Kind::Unreachable);
        figures.add(due, ended, outcome);
        if started.elapsed() < duration && !is_cut_off {
            figures.sent += 1;
            running.spawn(send(server.clone(), request.clone(), Instant::now()));
        }
    }
    figures
}

async fn drain(mut figures: Figures, mut running: JoinSet<Ended>) -> Figures {
    while let Some(Ok((due, ended, outcome))) = running.join_next().await {
        figures.add(due, ended, outcome);
    }
    figures
}

fn report(
    args: &BenchArgs,
    figures: &Figures,
    budget: Duration,
    took: Duration,
    output: Output,
) -> Result<(), Failure> {
    let latencies = &figures.latencies;
    let offered = figures.sent + figures.held_back;
    #[expect(
        clippy::cast_precision_loss,
        reason = "a count of pairs, shown with one digit"
    )]
    let answered_hz = latencies.count() as f64 / took.as_secs_f64();
    let in_budget = percent(latencies.in_budget(), offered);
    let rungs = percent(figures.rungs.0, figures.rungs.1);
    output.json(&json!({
        "rate_hz": args.rate, "concurrency": args.rate.is_none().then_some(args.concurrency), "budget_ms": ms(budget),
        "seconds": took.as_secs_f64(), "sent": figures.sent, "held_back": figures.held_back, "answered": latencies.count(),
        "answered_hz": answered_hz, "in_budget_percent": in_budget, "rungs_percent": rungs, "failed": figures.failed,
        "latency_ms": latencies.to_json(),
    }))?;
    let load = match args.rate {
        Some(rate) => format!("{rate} pairs a second"),
        None => format!("{} under way at a time", args.concurrency),
    };
    let failed: Vec<String> = figures
        .failed
        .iter()
        .map(|(why, count)| format!("{count} {why}"))
        .collect();
    let failed = if failed.is_empty() {
        "none".to_owned()
    } else {
        failed.join(", ")
    };
    let mut lines = vec![
        format!("{load}, budget {} ms, {:.1} s", ms(budget), took.as_secs_f64()),
        format!(
            "sent {}, answered {} ({answered_hz:.1}/s), in budget {in_budget:.2} %, rungs run {rungs:.1} %, without a result: {failed}",
            figures.sent,
            latencies.count()
        ),
    ];
    if figures.held_back > 0 {
        lines.push(format!(
            "held back {}: {MOST_UNDER_WAY} were under way already",
            figures.held_back
        ));
    }
    if latencies.count() > 0 {
        lines.extend(table(&latencies.rows()));
    }
    output.text(&lines.join("\n"))
}

/// A pair of noise, smooth enough to be matched, 16 px apart; raw 8-bit gray.
pub(crate) fn noise((width, height): (u32, u32)) -> (Image, Image) {
    /// Disparity of the pair in px.
    const SHIFT: u32 = 16;
    // A hash of the place (finalizer of MurmurHash3).
    let random = |x: u32, y: u32| {
        let mut h = x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca6b);
        h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
        h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
        (h ^ (h >> 16)) & 0xff
    };
    let gray = |x: u32, y: u32| {
        let sum: u32 = (0..2)
            .flat_map(|i| (0..2).map(move |j| (i, j)))
            .map(|(i, j)| random(x + i, y + j))
            .sum();
        u8::try_from(sum / 4).unwrap_or(u8::MAX)
    };
    let image = |shift: u32| {
        let rows = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let data: Vec<u8> = rows.map(|(x, y)| gray(x + shift, y)).collect();
        Image {
            width,
            height,
            encoding: ImageEncoding::Mono8.into(),
            data: Bytes::from(data),
            ..Image::default()
        }
    };
    (image(0), image(SHIFT))
}
