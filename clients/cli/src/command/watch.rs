//! `stereo watch`: the cameras of a server and the servers of its network, live.

use std::collections::BTreeMap;
use std::time::Duration;

use serde_json::{Value, json};
use stereo_client::{CameraPresence, CameraStream, Client, ClientError, Fleet};

use super::info::{server_lines, servers_json};
use crate::args::WatchArgs;
use crate::failure::Failure;
use crate::latency::percent;
use crate::output::{Output, table};
use crate::server::{Place, Server};

/// How long servers have to tell their load.
const TOLD_WITHIN: Duration = Duration::from_secs(1);

/// Where it is looked: at a server, at a network, or both.
struct Lookout {
    http: Option<Client>,
    fleet: Option<Fleet>,
}

/// What is there at one moment.
#[derive(Default)]
struct Sight {
    streams: Vec<CameraStream>,
    cameras: Vec<CameraPresence>,
}

pub(crate) async fn run(args: WatchArgs, place: &Place, output: Output) -> Result<(), Failure> {
    let lookout = match place.connect().await? {
        Server::Zenoh(fleet) => Lookout {
            http: None,
            fleet: Some(fleet),
        },
        Server::Http(client) => {
            client.info().await?;
            // Without Zenoh there are no other servers to be shown.
            let fleet = place.fleet_of(&client).await.ok();
            if let Some(fleet) = &fleet {
                fleet.look(TOLD_WITHIN).await;
            }
            Lookout {
                http: Some(client),
                fleet,
            }
        }
    };
    let terminal = console::Term::stdout();
    let is_live = !args.once && !output.is_json && terminal.is_term();
    loop {
        let sight = lookout.look().await?;
        if is_live {
            drop(terminal.clear_screen());
        }
        output.json(&lookout.json(&sight))?;
        output.text(&lookout.lines(&sight).join("\n"))?;
        if args.once {
            return Ok(());
        }
        tokio::select! {
            () = tokio::time::sleep(args.interval) => {}
            _ = tokio::signal::ctrl_c() => return Ok(()),
        }
    }
}

impl Lookout {
    async fn look(&self) -> Result<Sight, ClientError> {
        let mut sight = Sight::default();
        if let Some(http) = &self.http {
            sight.streams = http.streams().await?.streams;
        }
        if let Some(fleet) = &self.fleet {
            sight.cameras = fleet.cameras().await?;
        }
        Ok(sight)
    }

    fn json(&self, sight: &Sight) -> Value {
        let cameras = sight.cameras.iter().map(|camera| {
            json!({ "camera": camera.name, "announced": camera.is_announced, "served_by": camera.served_by })
        });
        json!({
            "streams": sight.streams,
            "cameras": cameras.collect::<Vec<_>>(),
            "servers": self.fleet.as_ref().map(servers_json).unwrap_or_default(),
        })
    }

    fn lines(&self, sight: &Sight) -> Vec<String> {
        let mut lines = camera_lines(sight);
        if let Some(fleet) = &self.fleet {
            lines.push(String::new());
            lines.extend(server_lines(fleet));
        }
        if self.http.is_none() {
            lines.push(
                "rates and latencies of cameras are known to their servers: --server http://HOST:PORT"
                    .to_owned(),
            );
        }
        lines
    }
}

/// A line for each camera that is there or has been.
fn camera_lines(sight: &Sight) -> Vec<String> {
    let streams: BTreeMap<&str, &CameraStream> =
        sight.streams.iter().map(|s| (s.camera.as_str(), s)).collect();
    let present: BTreeMap<&str, &CameraPresence> =
        sight.cameras.iter().map(|c| (c.name.as_str(), c)).collect();
    let mut names: Vec<&str> = streams.keys().chain(present.keys()).copied().collect();
    names.sort_unstable();
    names.dedup();
    if names.is_empty() {
        return vec!["no cameras: play one with `stereo stream FOLDER`, or ask `stereo doctor`".to_owned()];
    }
    let head = [
        "camera",
        "served by",
        "in Hz",
        "out Hz",
        "latency ms",
        "budget ms",
        "in budget %",
        "late",
        "dropped",
        "lost",
        "unpaired",
    ];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    for name in names {
        let stream = streams.get(name).copied();
        let owner = present.get(name).and_then(|camera| camera.served_by.clone());
        let here = stream
            .is_some_and(|stream| stream.served)
            .then(|| "this server".to_owned());
        let mut row = vec![
            name.to_owned(),
            owner.or(here).unwrap_or_else(|| "nobody".to_owned()),
        ];
        row.extend(stream.map_or_else(|| vec!["-".to_owned(); 9], figures));
        rows.push(row);
    }
    table(&rows)
}

fn figures(stream: &CameraStream) -> Vec<String> {
    let (rates, frames) = (&stream.rates, &stream.frames);
    let last = stream.last_result.as_ref().map(|last| &last.report);
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.1}"));
    // What is lost on the way is nobody's promise; what came and was dropped is.
    let done = frames.answered + frames.dropped_total();
    let dropped = match frames.dropped.iter().max_by_key(|(_, count)| **count) {
        Some((reason, _)) => format!("{} ({reason})", frames.dropped_total()),
        None => "0".to_owned(),
    };
    vec![
        number(Some(rates.received_hz)),
        number(Some(rates.answered_hz)),
        number(last.map(|report| report.total_ms)),
        number(last.map(|report| report.budget_ms)),
        number((done > 0).then(|| percent(frames.in_budget(), done))),
        frames.answered_late.to_string(),
        dropped,
        frames.lost.to_string(),
        stream.images.unpaired.values().sum::<u64>().to_string(),
    ]
}
