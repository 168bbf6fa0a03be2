//! Whether a pair of the cameras' size is matched in time, and whether the link carries their rate.

use std::time::{Duration, Instant};

use stereo_client::ClientError;
use stereo_client::v1::{Output as Part, Reason, StereoRequest};

use super::{Findings, Kind};
use crate::args::DoctorArgs;
use crate::command::bench::noise;
use crate::failure::Failure;
use crate::options::Wanted;
use crate::output::ms;
use crate::report::known;
use crate::server::Server;

/// Pairs that are sent; the fastest counts, which is what the link can do.
const PAIRS: usize = 5;

/// What the fastest pair needed.
struct Fastest {
    whole: Duration,
    /// On the way to the server and back.
    travel: Duration,
}

pub(super) async fn examine(
    server: &Server,
    args: &DoctorArgs,
    findings: &mut Findings,
) -> Result<(), Failure> {
    let (width, height) = args.size;
    let what = format!("{width} x {height} px, budget {} ms", ms(args.budget));
    let mut wanted = Wanted::default();
    wanted.options.latency_budget = args.budget.try_into().ok();
    wanted.want_outputs(&[Part::Disparity]);
    let (left, right) = noise(args.size);
    let bytes = left.data.len() + right.data.len();
    let request = wanted.request((left, right));
    let mut fastest: Option<Fastest> = None;
    let mut last = None;
    for _ in 0..PAIRS {
        match one(server, &request).await {
            Ok(pair) => {
                let is_faster = fastest.as_ref().is_none_or(|fastest| pair.whole < fastest.whole);
                fastest = if is_faster { Some(pair) } else { fastest };
            }
            Err(error) => last = Some(error),
        }
    }
    let Some(fastest) = fastest else {
        let why = last.map_or_else(|| "no answer".to_owned(), |error| advice(&error));
        return findings.fail(Kind::Refused, "a pair in budget", &format!("{what}: {why}"));
    };
    let took = ms(fastest.whole);
    if fastest.whole > args.budget {
        findings.fail(
            Kind::Refused,
            "a pair in budget",
            &format!(
                "{what}: the answer was here after {took:.1} ms: give a larger budget, or send smaller images"
            ),
        )?;
    } else {
        findings.ok("a pair in budget", &format!("{what}: {took:.1} ms"))?;
    }
    carries(args, bytes, fastest.travel, findings)
}

/// Whether the link carries the rate with pairs of so many bytes.
fn carries(
    args: &DoctorArgs,
    bytes: usize,
    travel: Duration,
    findings: &mut Findings,
) -> Result<(), Failure> {
    let check = "link fast enough";
    let most_hz = 1.0 / travel.as_secs_f64().max(1e-6);
    let found = format!(
        "{bytes} bytes a pair travel in {:.2} ms, so {most_hz:.0} a second fit",
        ms(travel)
    );
    if most_hz >= args.rate {
        findings.ok(check, &format!("{found}, {} are wanted", args.rate))
    } else {
        findings.fail(
            Kind::Failed,
            check,
            &format!(
                "{found}, but {} are wanted: send JPEG or smaller images, or fewer frames",
                args.rate
            ),
        )
    }
}

async fn one(server: &Server, request: &StereoRequest) -> Result<Fastest, ClientError> {
    let started = Instant::now();
    let result = server.match_pair(request).await?;
    let whole = started.elapsed();
    let report = result.report.unwrap_or_default();
    // The server's time begins with the first byte and ends before the reply is sent: receiving is the link's time.
    let inside = known(report.total).saturating_sub(known(report.received));
    Ok(Fastest {
        whole,
        travel: whole.saturating_sub(inside),
    })
}

fn advice(error: &ClientError) -> String {
    let is_late = error
        .status()
        .is_some_and(|status| matches!(status.reason(), Reason::DeadlineInfeasible | Reason::Expired));
    match is_late {
        true => format!("{error}: give a larger budget (--budget), or send smaller images (--size)"),
        false => error.to_string(),
    }
}
