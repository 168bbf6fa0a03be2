//! Links that lose, delay and throttle.

use std::net::SocketAddr;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use stereo_client::v1;
use stereo_tests::network::{Lab, ROUTER, Relay};
use stereo_tests::process::{Launch, Stereod};

use crate::clients::{Clients, Pace, Target};
use crate::pair;
use crate::scene::{stop, with};
use crate::table::{Recovery, Row};

/// Longer than a packet is sent again and again.
const BUDGET: Duration = Duration::from_secs(5);
const EVERY: Duration = Duration::from_millis(50);
const LINK: &str = "far";

/// A server on another host, and the link to it.
struct Far {
    lab: Lab,
    server: Stereod,
    target: Target,
}

impl Far {
    async fn start() -> Result<Self> {
        let mut lab = Lab::new()?;
        lab.link(LINK, None)?;
        let server = Stereod::launch(&Launch {
            host: Some(ROUTER),
            http: Some("0.0.0.0:0"),
            args: &["--workers", "1", "--no-zenoh"],
            ..Launch::default()
        })?;
        let url = url_on(&lab, &server, LINK)?;
        let client = stereo_client::Client::new(&url)?;
        client.ready(Duration::from_secs(60)).await?;
        let target = Target::Http(client);
        Ok(Self { lab, server, target })
    }

    /// The link gets bad and good again under pairs that keep coming.
    async fn suffer(
        self,
        fault: &str,
        pair: &v1::StereoRequest,
        every: Duration,
        bad: impl Fn(&Lab) -> Result<()>,
        good: impl Fn(&Lab) -> Result<()>,
    ) -> Result<Row> {
        let Self { lab, server, target } = self;
        bad(&lab)?;
        let clients = Clients::start(&target, pair, Pace::Every(every));
        clients.have(100).await?;
        good(&lab)?;
        let recovery = clients.served_again(Instant::now()).await?;
        let tally = clients.stop().await?;
        stop(server).await?;
        Ok(Row {
            saw: format!("{tally}; {}", tally.percentiles()),
            ..tally.row(fault, Recovery::Took(recovery))
        })
    }
}

/// Where a server that listens everywhere on the router's host is found over a link.
pub(crate) fn url_on(lab: &Lab, server: &Stereod, link: &str) -> Result<String> {
    let port = server.url().rsplit(':').next().context("a port")?;
    Ok(format!("http://{}:{port}", lab.router_of(link)?))
}

/// Whether packets can be lost here.
pub(crate) fn can_lose() -> Result<(), String> {
    let asked = Command::new("iptables")
        .arg("--version")
        .stdin(Stdio::null())
        .output();
    asked.map(drop).map_err(|why| format!("iptables: {why}"))
}

/// Packets are lost, each way.
pub(crate) async fn loss(share: f64, fault: &str) -> Result<Row> {
    let far = Far::start().await?;
    let pair = pair::small(BUDGET)?;
    far.suffer(
        fault,
        &pair,
        EVERY,
        |lab| lab.lose(LINK, share),
        |lab| lab.keep(LINK, share),
    )
    .await
}

/// A narrow link, each way, with pairs as JPEG.
pub(crate) async fn narrow(rate: &str, fault: &str) -> Result<Row> {
    let far = Far::start().await?;
    let mut pair = pair::small_jpeg(BUDGET)?;
    let options = pair.options.get_or_insert_default();
    options.outputs = vec![v1::Output::Disparity.into()];
    options.set_disparity_encoding(v1::DisparityEncoding::Png16);
    far.suffer(
        fault,
        &pair,
        2 * EVERY,
        |lab| lab.narrow_both_ways(LINK, rate),
        |lab| lab.widen_both_ways(LINK),
    )
    .await
}

/// Whatever goes to or from the server is late by up to `most`.
pub(crate) async fn jitter(most: Duration) -> Result<Row> {
    let (server, _) = with(&[]).await?;
    let address: SocketAddr = server.url().trim_start_matches("http://").parse()?;
    let relay = Relay::start(address).await?;
    relay.set_jitter(most);
    let target = Target::http(&format!("http://{}", relay.address()))?;
    let clients = Clients::start(&target, &pair::small(BUDGET)?, Pace::Every(EVERY));
    clients.have(100).await?;
    relay.set_jitter(Duration::ZERO);
    let recovery = clients.served_again(Instant::now()).await?;
    let tally = clients.stop().await?;
    stop(server).await?;
    let fault = format!("jitter of {} ms, each way", most.as_millis());
    Ok(Row {
        saw: format!("{tally}; {}", tally.percentiles()),
        ..tally.row(&fault, Recovery::Took(recovery))
    })
}
