//! `stereo info`.

use serde_json::json;
use stereo_client::{Client, Fleet};

use crate::failure::Failure;
use crate::output::{Output, ms, table};
use crate::report::known;
use crate::server::{Place, Server};

pub(crate) async fn run(place: &Place, output: Output) -> Result<(), Failure> {
    match place.connect().await? {
        Server::Http(client) => one(&client, output).await,
        Server::Zenoh(fleet) => all(&fleet, output),
    }
}

async fn one(client: &Client, output: Output) -> Result<(), Failure> {
    let info = client.info().await?;
    let readiness = client.readiness().await?;
    output.json(&json!({ "info": info, "readiness": readiness }))?;
    let limits = &info.limits;
    let state = match &readiness.why {
        Some(why) => format!("{}: {why}", readiness.status),
        None => readiness.status.clone(),
    };
    let mut lines = vec![
        format!("stereod {} called {}, {state}", info.version, info.instance),
        format!("  workers  {}, instruction set {}", info.workers, info.simd),
        format!(
            "  images   {0} to {1} px a side, {2} px in all, {3} bytes a request",
            limits.min_side_px, limits.max_side_px, limits.image_pixels, limits.body_bytes
        ),
        format!(
            "  zenoh    {}, {} connections",
            readiness.zenoh.state, readiness.zenoh.connections
        ),
    ];
    lines.extend(
        readiness
            .zenoh
            .locators
            .iter()
            .map(|locator| format!("           {locator}")),
    );
    lines.extend(
        info.presets
            .iter()
            .map(|preset| format!("  preset   {}: {}", preset.name, preset.rungs.join(", "))),
    );
    output.text(&lines.join("\n"))
}

fn all(fleet: &Fleet, output: Output) -> Result<(), Failure> {
    let servers = servers_json(fleet);
    output.json(&json!({ "servers": servers }))?;
    output.text(&server_lines(fleet).join("\n"))
}

/// The servers of a network, as they last told about themselves.
pub(crate) fn servers_json(fleet: &Fleet) -> Vec<serde_json::Value> {
    let server = |load: &stereo_client::v1::ServerLoad| {
        json!({
            "instance": load.instance, "workers": load.workers, "busy_workers": load.busy_workers, "waiting": load.waiting,
            "backlog_ms": ms(known(load.backlog)), "mandatory_load": load.mandatory_load, "full_load": load.full_load,
            "overload_rung": load.overload_rung, "draining": load.draining, "cameras": load.cameras,
        })
    };
    fleet.servers().iter().map(server).collect()
}

/// The same as a table.
pub(crate) fn server_lines(fleet: &Fleet) -> Vec<String> {
    let head = [
        "server",
        "workers",
        "busy",
        "waiting",
        "backlog ms",
        "load %",
        "cameras",
        "state",
    ];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    rows.extend(fleet.servers().iter().map(|load| {
        let state = match (load.draining, load.overload_rung) {
            (true, _) => "stopping".to_owned(),
            (false, 0) => "ok".to_owned(),
            (false, rung) => format!("overload {rung}"),
        };
        vec![
            load.instance.clone(),
            load.workers.to_string(),
            load.busy_workers.to_string(),
            load.waiting.to_string(),
            format!("{:.1}", ms(known(load.backlog))),
            format!("{:.0}", 100.0 * load.full_load),
            load.cameras.to_string(),
            state,
        ]
    }));
    table(&rows)
}
