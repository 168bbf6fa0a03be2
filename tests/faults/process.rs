//! What happens to the server's threads and to the server as a process.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use stereo_client::Fleet;
use stereo_tests::process::{Launch, Stereod};
use stereo_tests::zenoh::Router;

use crate::clients::{Clients, Pace, Tally, Target};
use crate::pair;
use crate::scene::{Folder, lines, ready, stop, until, with};
use crate::table::{Recovery, Row};

/// Budget of the pairs.
const BUDGET: Duration = Duration::from_secs(1);
/// Budget of those that a client may try at another server, or again.
const RETRIED: Duration = Duration::from_secs(5);
/// Pairs under way at a time.
const AT_A_TIME: usize = 4;
/// After its last deadline, a server that stops has so long to say goodbye: 2 s for connections, the rest for Zenoh.
const GOODBYE: Duration = Duration::from_secs(6);
const FROZEN: Duration = Duration::from_secs(2);

/// A worker panics.
pub(crate) async fn panic() -> Result<Row> {
    let (server, target) = with(&["--fault", "panic@100"]).await?;
    let clients = Clients::start(&target, &pair::small(BUDGET)?, Pace::Closed(AT_A_TIME));
    let failed = clients.refused("INTERNAL").await?;
    let recovery = clients.served_again(failed).await?;
    clients.have(300).await?;
    let tally = clients.stop().await?;
    ensure!(
        tally.refused_as("INTERNAL") == 1,
        "more than one frame failed: {tally}"
    );
    stop(server).await?;
    Ok(tally.row("a worker panics", Recovery::Took(recovery)))
}

/// A worker makes no progress any more; the server has one alone.
pub(crate) async fn stuck() -> Result<Row> {
    let (server, target) = with(&["--fault", "stuck@100", "--stuck-after-ms", "2000"]).await?;
    let clients = Clients::start(&target, &pair::small(BUDGET)?, Pace::Closed(AT_A_TIME));
    let failed = clients.refused("INTERNAL").await?;
    clients.served_again(failed).await?;
    let recovery = clients.gap_around(failed);
    clients.have(300).await?;
    let tally = clients.stop().await?;
    // With the frame it is stuck at go those that it has begun and laid aside, which are late by then.
    ensure!(
        tally.refused_as("INTERNAL") <= AT_A_TIME as u64,
        "more frames failed than were under way: {tally}"
    );
    stop(server).await?;
    Ok(tally.row(
        "the only worker is stuck (given up after 2 s)",
        Recovery::Took(recovery),
    ))
}

/// SIGKILL, and started again at once on the same port, as by a supervisor.
pub(crate) async fn killed() -> Result<Row> {
    let (server, target) = with(&[]).await?;
    let clients = Clients::start(&target, &pair::small(BUDGET)?, Pace::Closed(AT_A_TIME));
    clients.have(100).await?;
    let address = server.url().trim_start_matches("http://").to_owned();
    let since = Instant::now();
    drop(server);
    let server = Stereod::launch(&Launch {
        http: Some(&address),
        args: &["--workers", "1", "--no-zenoh"],
        ..Launch::default()
    })?;
    let recovery = clients.served_again(since).await?;
    clients.have(200).await?;
    let tally = clients.stop().await?;
    stop(server).await?;
    Ok(Row {
        // Those under way die with the process. Clients can't tell them from those that it had not taken yet, and each tries again at once,
        // on connections kept from before: some rounds of them.
        lost: tally.cut,
        promised: 4 * AT_A_TIME as u64,
        ..tally.row(
            "kill -9 under load, started again at once",
            Recovery::Took(recovery),
        )
    })
}

/// SIGKILL of one of two servers, with a client over Zenoh that tries the other one.
pub(crate) async fn killed_of_two() -> Result<Row> {
    let router = Router::start().await?;
    let mut servers = Vec::new();
    for name in ["one", "two"] {
        let args = [
            "--workers",
            "1",
            "--instance",
            name,
            "--zenoh-connect",
            router.endpoint(),
        ];
        let launch = Launch {
            args: &args,
            ..Launch::default()
        };
        servers.push(ready(&launch).await?.0);
    }
    let fleet = Fleet::connect(&[router.endpoint()]).await?;
    until("two servers", || Ok(fleet.servers().len() == 2)).await?;
    let target = Target::Zenoh(fleet);
    let clients = Clients::start(&target, &pair::small(RETRIED)?, Pace::Closed(AT_A_TIME));
    clients.have(100).await?;
    let since = Instant::now();
    drop(servers.pop());
    let recovery = clients.served_again(since).await?;
    clients.have(300).await?;
    let tally = clients.stop().await?;
    for server in servers {
        stop(server).await?;
    }
    router.stop().await?;
    Ok(tally.row(
        "kill -9 of one of two servers, client over Zenoh",
        Recovery::Took(recovery),
    ))
}

/// SIGTERM while twice as much comes as can be done.
pub(crate) async fn stopped() -> Result<Row> {
    let folder = Folder::new()?;
    let log = folder.file("log");
    let (server, target) = ready(&Launch {
        log: Some(&log),
        args: &["--workers", "1", "--no-zenoh", "--log-format", "json"],
        ..Launch::default()
    })
    .await?;
    let pair = pair::vga(BUDGET)?;
    let alone = Clients::start(&target, &pair, Pace::Closed(2));
    alone.have(20).await?;
    let since = Instant::now();
    alone.have(70).await?;
    let one = since.elapsed() / 50;
    let before = alone.stop().await?;
    let clients = Clients::start(&target, &pair, Pace::Every(one / 2));
    clients.have(200).await?;
    let took = stop(server).await?;
    let tally = clients.stop().await?;
    let limit = BUDGET + GOODBYE;
    ensure!(
        took < limit,
        "it took {took:?} to stop, at most {limit:?} would do"
    );
    let lost = not_told(&lines(&log)?, &before, &tally)?;
    Ok(Row {
        saw: format!("{tally}; all results that were made arrived"),
        lost,
        ..tally.row("SIGTERM under twice the load", Recovery::Ended(took))
    })
}

/// Frames that the server counts as admitted and of which no client knows what became.
fn not_told(log: &[serde_json::Value], before: &Tally, tally: &Tally) -> Result<u64> {
    let last = log.iter().rev().find(|line| line["dropped"].is_u64());
    let last = last.context("no last words in the server's log")?;
    let count = |name: &str| {
        last[name]
            .as_u64()
            .with_context(|| format!("no number {name} in {last}"))
    };
    let (answered, dropped) = (count("answered")?, count("dropped")?);
    let results = before.results + tally.results;
    // Refused at the door, without having been admitted.
    let turned_away =
        ["DRAINING", "DEADLINE_INFEASIBLE", "QUEUE_FULL"].map(|reason| tally.refused_as(reason));
    let refused = before.all_refused() + tally.all_refused() - turned_away.iter().sum::<u64>();
    Ok(answered.saturating_sub(results) + dropped.saturating_sub(refused))
}

/// SIGSTOP, and SIGCONT 2 s later.
pub(crate) async fn frozen() -> Result<Row> {
    let (mut server, target) = with(&[]).await?;
    let clients = Clients::start(
        &target,
        &pair::small(BUDGET)?,
        Pace::Every(Duration::from_millis(20)),
    );
    clients.have(50).await?;
    server.signal("STOP")?;
    tokio::time::sleep(FROZEN).await;
    server.signal("CONT")?;
    let since = Instant::now();
    let recovery = clients.served_again(since).await?;
    clients.have(150).await?;
    let tally = clients.stop().await?;
    stop(server).await?;
    Ok(tally.row("SIGSTOP for 2 s, then SIGCONT", Recovery::Took(recovery)))
}
