//! `stereo stream`: a folder of pairs as a camera over Zenoh, and what becomes of its frames.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use stereo_client::v1::{Image, Output as Part, StereoResult};
use stereo_client::{Camera, CameraStream, Client, Fleet};

use crate::args::StreamArgs;
use crate::failure::{Failure, Kind};
use crate::latency::{Latencies, percent};
use crate::options::{Wanted, budget};
use crate::output::{Output, ms, table};
use crate::pairs::{self, Pair};
use crate::report::report_json;
use crate::server::{Address, Place};

/// How long a server has to take a new camera.
const SERVED_WITHIN: Duration = Duration::from_secs(5);
/// How long the results of the last frames are waited for, besides their budget.
const GRACE: Duration = Duration::from_secs(2);
/// Files of a folder that are kept in memory, in bytes, so that the disk does not set the pace.
const MOST_KEPT: usize = 1 << 30;

/// What is known at the end.
struct Figures {
    latencies: Latencies,
    /// When each frame was due, until its result is there.
    under_way: HashMap<u64, Instant>,
    sent: u64,
    started: Instant,
    last_sent: Instant,
}

pub(crate) async fn run(args: StreamArgs, place: &Place, output: Output) -> Result<(), Failure> {
    let pairs = pairs::find(&args.folder, None)?;
    let mut wanted = Wanted::from_args(&args.matching, pairs::first_left(&pairs))?;
    wanted.want_outputs(&[Part::Disparity]);
    let (fleet, http) = match &place.address {
        Address::Zenoh(endpoints) => (place.fleet(endpoints).await?, None),
        Address::Http(url) => {
            let client = place.client(url)?;
            (place.fleet_of(&client).await?, Some(client))
        }
    };
    let camera = fleet.camera(&args.camera).await?;
    // What is sent before is lost.
    camera.until_served(SERVED_WITHIN).await?;
    let before = seen(http.as_ref(), &args.camera).await;
    let figures = play(&args, &wanted, &pairs, &fleet, &camera, output).await?;
    let after = seen(http.as_ref(), &args.camera).await;
    report(
        &args,
        &figures,
        drops(before.as_ref(), after.as_ref()).as_ref(),
        output,
    )?;
    if figures.latencies.count() == 0 {
        return Err(Failure::new(
            Kind::Refused,
            format!(
                "no frame has a result: ask `stereo doctor --camera {}` while it plays",
                args.camera
            ),
        ));
    }
    Ok(())
}

/// Sends all frames on time, and takes the results as they come.
async fn play(
    args: &StreamArgs,
    wanted: &Wanted,
    pairs: &[Pair],
    fleet: &Fleet,
    camera: &Camera,
    output: Output,
) -> Result<Figures, Failure> {
    let count = pairs.len() as u64 * args.repeat;
    let is_last = |number: u64| args.repeat > 0 && number >= count;
    let results = fleet.results(&args.camera).await?;
    let budget = budget(&wanted.options);
    let bar = output.progress((args.repeat > 0).then_some(count));
    let mut kept = Kept::default();
    let started = Instant::now();
    let mut figures = Figures {
        latencies: Latencies::new(budget),
        under_way: HashMap::new(),
        sent: 0,
        started,
        last_sent: started,
    };
    let mut stop = std::pin::pin!(tokio::signal::ctrl_c());
    let mut is_stopped = false;
    loop {
        let is_over = is_stopped || is_last(figures.sent);
        if is_over && figures.under_way.is_empty() {
            break;
        }
        let due = started + Duration::from_secs_f64(offset_s(figures.sent, args.rate));
        let wake = if is_over {
            figures.last_sent + budget + GRACE
        } else {
            due
        };
        tokio::select! {
            result = results.next() => note(&mut figures, &result?, output)?,
            _ = &mut stop, if !is_stopped => is_stopped = true,
            () = tokio::time::sleep_until(wake.into()) => {
                if is_over {
                    break;
                }
                let index = usize::try_from(figures.sent % pairs.len() as u64).unwrap_or(0);
                let mut request = wanted.request(kept.read(pairs, index)?);
                request.sequence = Some(figures.sent);
                request.camera_id.clone_from(&args.camera);
                // Those whose results can't come any more.
                figures.under_way.retain(|_, due| due.elapsed() < budget + GRACE);
                figures.last_sent = Instant::now();
                figures.under_way.insert(figures.sent, due);
                camera.send(&request).await?;
                figures.sent += 1;
                bar.inc(1);
                bar.set_message(format!("{} results", figures.latencies.count()));
            }
        }
    }
    bar.finish_and_clear();
    Ok(figures)
}

#[expect(clippy::cast_precision_loss, reason = "a count of frames")]
fn offset_s(number: u64, rate: f64) -> f64 {
    number as f64 / rate
}

fn note(figures: &mut Figures, result: &StereoResult, output: Output) -> Result<(), Failure> {
    let due = result
        .sequence
        .and_then(|number| figures.under_way.remove(&number));
    // Those of somebody else's frames, or of an earlier stream, are not ours.
    let Some(due) = due else { return Ok(()) };
    let latency = due.elapsed();
    figures.latencies.add(latency);
    output.json(&json!({
        "sequence": result.sequence, "latency_ms": ms(latency), "report": result.report.as_ref().map(report_json),
    }))
}

/// Pairs that have been read, as far as there is room.
#[derive(Default)]
struct Kept {
    images: HashMap<usize, (Image, Image)>,
    bytes: usize,
}

impl Kept {
    fn read(&mut self, pairs: &[Pair], index: usize) -> Result<(Image, Image), Failure> {
        if let Some(images) = self.images.get(&index) {
            return Ok(images.clone());
        }
        let images = pairs[index].read()?;
        self.bytes += images.0.data.len() + images.1.data.len();
        if self.bytes <= MOST_KEPT {
            self.images.insert(index, images.clone());
        }
        Ok(images)
    }
}

/// What the server says about the camera, if it can be asked.
async fn seen(http: Option<&Client>, camera: &str) -> Option<CameraStream> {
    let streams = http?.streams().await.ok()?.streams;
    streams.into_iter().find(|stream| stream.camera == camera)
}

/// Frames lost and dropped since `before`, by reason.
fn drops(before: Option<&CameraStream>, after: Option<&CameraStream>) -> Option<Value> {
    let after = &after?.frames;
    let earlier = before.map(|before| &before.frames);
    let mut counts = serde_json::Map::new();
    for (reason, &count) in &after.dropped {
        let count = count
            - earlier
                .and_then(|earlier| earlier.dropped.get(reason))
                .unwrap_or(&0)
                .min(&count);
        if count > 0 {
            counts.insert(reason.clone(), json!(count));
        }
    }
    let lost = after
        .lost
        .saturating_sub(earlier.map_or(0, |earlier| earlier.lost));
    if lost > 0 {
        counts.insert("lost on the way".to_owned(), json!(lost));
    }
    Some(Value::Object(counts))
}

fn report(
    args: &StreamArgs,
    figures: &Figures,
    drops: Option<&Value>,
    output: Output,
) -> Result<(), Failure> {
    let (latencies, sent) = (&figures.latencies, figures.sent);
    let without = sent.saturating_sub(latencies.count());
    let seconds = (figures.last_sent - figures.started).as_secs_f64();
    #[expect(clippy::cast_precision_loss, reason = "a count of frames")]
    let rate_hz = if seconds > 0.0 {
        (sent.saturating_sub(1)) as f64 / seconds
    } else {
        0.0
    };
    let in_budget = percent(latencies.in_budget(), sent);
    output.json(&json!({
        "camera": args.camera, "sent": sent, "rate_hz": rate_hz, "results": latencies.count(), "without_result": without,
        "dropped": drops, "in_budget_percent": in_budget, "latency_ms": latencies.to_json(),
    }))?;
    let reasons: Vec<String> = drops
        .and_then(Value::as_object)
        .map(|counts| {
            counts
                .iter()
                .map(|(why, count)| format!("{count} {why}"))
                .collect()
        })
        .unwrap_or_default();
    let reasons = if reasons.is_empty() {
        String::new()
    } else {
        format!(" ({})", reasons.join(", "))
    };
    let mut lines = vec![format!(
        "{}: {sent} frames at {rate_hz:.1} Hz, {} results, {without} without{reasons}, in budget {in_budget:.2} %",
        args.camera,
        latencies.count()
    )];
    if latencies.count() > 0 {
        lines.extend(table(&latencies.rows()));
    }
    output.text(&lines.join("\n"))
}
