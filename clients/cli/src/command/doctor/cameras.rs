//! Whether cameras are announced and served, and whether their frames arrive, find their other half, and are answered in budget.

use std::collections::BTreeMap;

use stereo_client::{CameraPresence, CameraStream, Client, Fleet, Unpaired};

use super::{Findings, Kind};
use crate::args::DoctorArgs;
use crate::failure::Failure;
use crate::latency::percent;
use crate::output::ms;

pub(super) async fn examine(
    args: &DoctorArgs,
    fleet: &Fleet,
    http: Option<&Client>,
    findings: &mut Findings,
) -> Result<(), Failure> {
    let mut cameras = fleet.cameras().await?;
    if let Some(name) = &args.camera {
        cameras.retain(|camera| camera.name == *name);
    }
    if cameras.is_empty() {
        let name = args.camera.as_deref().unwrap_or("NAME");
        let what = format!(
            "no camera{} is on the network: it has to declare the liveliness token stereo/v1/camera/{name}; `stereo stream FOLDER \
             --camera {name}` is one that does",
            args.camera
                .as_ref()
                .map(|name| format!(" called {name}"))
                .unwrap_or_default()
        );
        return findings.fail(Kind::Failed, "camera announced", &what);
    }
    for camera in &cameras {
        presence(camera, findings)?;
    }
    let Some(http) = http else {
        return findings.ok(
            "frames",
            "not looked at: servers tell over HTTP what becomes of frames, so give --server http://HOST:PORT and --router",
        );
    };
    let before = streams(http).await?;
    tokio::time::sleep(args.watch).await;
    let after = streams(http).await?;
    for camera in cameras.iter().filter(|camera| camera.served_by.is_some()) {
        match after.get(&camera.name) {
            Some(after) if after.served => frames(args, before.get(&camera.name), after, findings)?,
            _ => findings.ok(
                &format!("frames of {}", camera.name),
                &format!(
                    "not looked at: {} serves it, ask there",
                    camera.served_by.as_deref().unwrap_or("another server")
                ),
            )?,
        }
    }
    Ok(())
}

fn presence(camera: &CameraPresence, findings: &mut Findings) -> Result<(), Failure> {
    let name = &camera.name;
    if !camera.is_announced {
        return findings.fail(
            Kind::Failed,
            "camera announced",
            &format!("{name} is not: its liveliness token stereo/v1/camera/{name} is gone, so it has stopped or is cut off; restart it"),
        );
    }
    findings.ok("camera announced", name)?;
    match &camera.served_by {
        Some(server) => findings.ok("camera served", &format!("{name} by {server}")),
        None => findings.fail(
            Kind::Failed,
            "camera served",
            &format!("{name} is not: start another server, or look into the servers' logs for its name"),
        ),
    }
}

async fn streams(http: &Client) -> Result<BTreeMap<String, CameraStream>, Failure> {
    let streams = http.streams().await?.streams.into_iter();
    Ok(streams.map(|stream| (stream.camera.clone(), stream)).collect())
}

/// What happened to a camera's frames between two looks.
fn frames(
    args: &DoctorArgs,
    before: Option<&CameraStream>,
    after: &CameraStream,
    findings: &mut Findings,
) -> Result<(), Failure> {
    let name = &after.camera;
    let since = |count: fn(&CameraStream) -> u64| count(after).saturating_sub(before.map_or(0, count));
    let images = since(|s| s.images.received);
    let paired = since(|s| s.images.paired);
    let arrived = since(|s| s.frames.received);
    let outcome = Outcome {
        answered: since(|s| s.frames.answered),
        late: since(|s| s.frames.answered_late),
        dropped: since(|s| s.frames.dropped_total()),
    };
    let lost = since(|s| s.frames.lost);
    let watched = format!("in {} ms", ms(args.watch));

    let check = format!("frames of {name} arrive");
    if arrived + images == 0 {
        let what = format!(
            "none came {watched}: let it put `StereoRequest`s under stereo/v1/frames/{name}, or images under \
             stereo/v1/frames/{name}/left and /right"
        );
        return findings.fail(Kind::Failed, &check, &what);
    }
    if lost > 0 {
        let what = format!(
            "{arrived} came {watched}, {lost} were lost on the way: the link is too slow for them, send JPEG, smaller images or \
             fewer frames"
        );
        findings.fail(Kind::Failed, &check, &what)?;
    } else {
        let found = match images {
            0 => format!("{arrived} {watched}"),
            _ => format!("{images} single images {watched}, {arrived} pairs of them"),
        };
        findings.ok(&check, &found)?;
    }
    if images > 0 {
        let check = format!("images of {name} paired");
        let unpaired = since(|s| s.images.unpaired.values().sum());
        if paired == 0 || unpaired > paired {
            let what = format!(
                "{images} images came {watched}, {paired} found their other half, {unpaired} did not{}: give both the same \
                 sequence, or timestamps closer than the camera's tolerance",
                after.images.last_unpaired.last().map(told).unwrap_or_default()
            );
            findings.fail(Kind::Failed, &check, &what)?;
        } else {
            findings.ok(&check, &format!("{paired} of {images}"))?;
        }
    }
    if arrived == 0 {
        // Without pairs there is nothing that could be late.
        return Ok(());
    }
    in_budget(after, outcome, findings)
}

/// An image that is in no pair, as the end of a sentence's part.
fn told(unpaired: &Unpaired) -> String {
    let number = unpaired.sequence.map(|number| format!(" {number}"));
    let nearest = unpaired
        .nearest_ms
        .map(|ms| format!(", the nearest of the other side {ms:.1} ms away"));
    format!(
        " (the last, {}{}: {}{})",
        unpaired.side,
        number.unwrap_or_default(),
        unpaired.why,
        nearest.unwrap_or_default()
    )
}

/// What became of frames between two looks; those answered late are answered.
struct Outcome {
    answered: u64,
    late: u64,
    dropped: u64,
}

fn in_budget(stream: &CameraStream, outcome: Outcome, findings: &mut Findings) -> Result<(), Failure> {
    let Outcome {
        answered,
        late,
        dropped,
    } = outcome;
    let check = format!("frames of {} in budget", stream.camera);
    let last = match &stream.last_result {
        Some(last) => format!(
            "; the last took {:.1} ms of {:.0} ms",
            last.report.total_ms, last.report.budget_ms
        ),
        None => String::new(),
    };
    if dropped == 0 && late == 0 && answered > 0 {
        return findings.ok(&check, &format!("all {answered} answered{last}"));
    }
    let reasons: Vec<String> = stream
        .frames
        .dropped
        .iter()
        .map(|(reason, count)| format!("{count} {reason}"))
        .collect();
    let error = match &stream.last_error {
        Some(detail) => format!("; the last: {detail}"),
        None => String::new(),
    };
    let what = format!(
        "{answered} answered, {late} of them late, {dropped} dropped ({:.0} % in budget; dropped so far: {}){last}{error}: larger \
         budgets, smaller images, lower rates or another server help against late and superseded ones",
        percent(answered - late.min(answered), answered + dropped),
        if reasons.is_empty() {
            "none".to_owned()
        } else {
            reasons.join(", ")
        }
    );
    findings.fail(Kind::Failed, &check, &what)
}
