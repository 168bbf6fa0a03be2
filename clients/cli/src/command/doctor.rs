//! `stereo doctor`: why does nothing come out? One check after the other, from the server to the cameras' frames.

mod cameras;
mod link;

use std::time::Duration;

use serde_json::json;
use stereo_client::{Client, Fleet, Readiness};

use crate::args::DoctorArgs;
use crate::failure::{Failure, Kind};
use crate::output::Output;
use crate::server::{Address, Place, Server};

/// How long servers have to tell that they are there.
const FOUND_WITHIN: Duration = Duration::from_secs(2);

/// What has been found so far.
struct Findings {
    output: Output,
    failed: usize,
    worst: Option<Kind>,
}

impl Findings {
    fn ok(&self, check: &str, found: &str) -> Result<(), Failure> {
        self.say(check, true, found)
    }

    /// `what` says what is wrong and what to do.
    fn fail(&mut self, kind: Kind, check: &str, what: &str) -> Result<(), Failure> {
        self.failed += 1;
        self.worst = Some(kind.worse(self.worst));
        self.say(check, false, what)
    }

    fn say(&self, check: &str, is_ok: bool, found: &str) -> Result<(), Failure> {
        self.output
            .json(&json!({ "check": check, "ok": is_ok, "found": found }))?;
        let word = match is_ok {
            true => console::style("OK  ").green(),
            false => console::style("FAIL").red().bold(),
        };
        self.output.text(&format!("{word}  {check}: {found}"))
    }
}

pub(crate) async fn run(args: DoctorArgs, place: &Place, output: Output) -> Result<(), Failure> {
    let mut findings = Findings {
        output,
        failed: 0,
        worst: None,
    };
    examine(&args, place, &mut findings).await?;
    output.json(&json!({ "failed": findings.failed }))?;
    match findings.worst {
        None => output.text("nothing is wrong"),
        // The lines above are the answer of a program; people get a last sentence.
        Some(kind) => Err(Failure::new(
            kind,
            format!(
                "{} of the checks failed: begin with the first of them",
                findings.failed
            ),
        )),
    }
}

/// Ends early where nothing further could be found out.
async fn examine(args: &DoctorArgs, place: &Place, findings: &mut Findings) -> Result<(), Failure> {
    let mut http = None;
    let mut network = match &place.address {
        Address::Http(url) => {
            let client = place.client(url)?;
            let Some(readiness) = server(&client, url, findings).await? else {
                return Ok(());
            };
            let locators = readiness.zenoh.locators.clone();
            link::examine(&Server::Http(client.clone()), args, findings).await?;
            http = Some(client);
            zenoh_of(&readiness, findings)?;
            locators
        }
        Address::Zenoh(endpoints) => endpoints.clone(),
    };
    if let Some(Address::Zenoh(endpoints)) = &args.router {
        network.clone_from(endpoints);
    }
    if network.is_empty() {
        return Ok(());
    }
    let Some(fleet) = reach(place, &network, findings).await? else {
        return Ok(());
    };
    if http.is_none() {
        link::examine(&Server::Zenoh(fleet.clone()), args, findings).await?;
    }
    cameras::examine(args, &fleet, http.as_ref(), findings).await
}

/// Whether the server answers and takes frames; none if it does not answer.
async fn server(client: &Client, url: &str, findings: &mut Findings) -> Result<Option<Readiness>, Failure> {
    let readiness = match client.readiness().await {
        Ok(readiness) => readiness,
        Err(error) => {
            findings.fail(Kind::Unreachable, "server reachable", &error.to_string())?;
            return Ok(None);
        }
    };
    let version = client
        .info()
        .await
        .map(|info| format!(", stereod {}", info.version));
    findings.ok(
        "server reachable",
        &format!("{url}{}", version.unwrap_or_default()),
    )?;
    match &readiness.why {
        None => findings.ok("server ready", "it takes frames")?,
        Some(why) => findings.fail(
            Kind::Unreachable,
            "server ready",
            &format!("{why}; see its log, or wait"),
        )?,
    }
    Ok(Some(readiness))
}

/// What the server says about its Zenoh.
fn zenoh_of(readiness: &Readiness, findings: &mut Findings) -> Result<(), Failure> {
    let zenoh = &readiness.zenoh;
    match (zenoh.state.as_str(), &zenoh.why) {
        ("open", None) => findings.ok(
            "server's Zenoh",
            &format!(
                "open, {} connections, at {}",
                zenoh.connections,
                zenoh.locators.join(", ")
            ),
        ),
        ("off", _) => findings.fail(
            Kind::Failed,
            "server's Zenoh",
            "it is switched off, so no camera can be served: start the server without --no-zenoh",
        ),
        (state, why) => findings.fail(
            Kind::Failed,
            "server's Zenoh",
            &format!(
                "{state}: {}",
                why.as_deref()
                    .unwrap_or("it is not open yet, try again in a moment")
            ),
        ),
    }
}

/// Whether the network can be joined, and servers are on it; none if not.
async fn reach(
    place: &Place,
    endpoints: &[String],
    findings: &mut Findings,
) -> Result<Option<Fleet>, Failure> {
    let at = endpoints.join(", ");
    let fleet = match place.fleet(endpoints).await {
        Ok(fleet) => fleet,
        Err(failure) => {
            findings.fail(Kind::Unreachable, "router reachable", &failure.message)?;
            return Ok(None);
        }
    };
    findings.ok("router reachable", &at)?;
    let servers = fleet.look(FOUND_WITHIN).await;
    let names: Vec<&str> = servers.iter().map(|server| server.instance.as_str()).collect();
    if names.is_empty() {
        let what = format!("none is on the network at {at}: start one with --zenoh-connect {at}");
        findings.fail(Kind::Unreachable, "servers alive", &what)?;
        return Ok(None);
    }
    for server in &servers {
        let what = match (server.workers, server.draining, server.overload_rung) {
            (0, ..) => "has not told its load: it is frozen or cut off, restart it",
            (_, true, _) => "is stopping and takes no new work: start another one",
            (_, _, 1..) => "is overloaded: fewer cameras or rates, larger budgets, or another server",
            _ => continue,
        };
        findings.fail(
            Kind::Failed,
            "servers alive",
            &format!("{} {what}", server.instance),
        )?;
    }
    findings.ok("servers alive", &names.join(", "))?;
    Ok(Some(fleet))
}
