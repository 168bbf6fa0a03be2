//! `load --suite rejections`: how long the real server takes to refuse hostile input, from connecting to the last byte of the refusal.
//! First while it has nothing else to do, then while its worker is never idle.

mod attack;
mod exchange;

use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use bytes::Bytes;
use stereo_tests::process::{Launch, Stereod, run as run_binary};
use stereo_tests::{machine, readme};

use self::attack::{Attack, attacks};
use self::exchange::Answer;
use crate::args::{Args, Codec, Size};
use crate::frames::Frames;
use crate::{NOT_KEPT, STARTED_WITHIN, wait_until_ready};

/// Inputs of each kind.
const COUNT: usize = 1000;
/// Inputs of each kind before any counts.
const WARM_UP: usize = 20;
/// The 99th percentile of all has to be below.
const FLOOR: Duration = Duration::from_millis(5);

/// What came of one kind of input.
struct Row {
    name: &'static str,
    /// Of the refused ones.
    codes: Vec<u16>,
    idle: Vec<Duration>,
    busy: Vec<Duration>,
    accepted: usize,
}

/// Measures, and says whether the floor was kept.
#[expect(clippy::print_stdout, reason = "the table is what this program is for")]
pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    let (token, config) = client()?;
    let file = std::env::temp_dir().join(format!("stereod-rejections-{}.toml", std::process::id()));
    std::fs::write(&file, config)?;
    let server = start(args, &file);
    std::fs::remove_file(&file)?;
    let server = server?;
    wait_until_ready(server.url(), STARTED_WITHIN)?;
    let pair = Frames::render(Size::VGA);
    let good = exchange::post(
        &token,
        "application/x-protobuf",
        &pair.pair(Size::VGA, Codec::Raw)?,
    );
    let address = server.url().trim_start_matches("http://");
    let answer = exchange::exchange(address, &good).context("the server doesn't take good input")?;
    ensure!(answer.code == 200, "good input was refused: {}", answer.code);

    let mut rows = Vec::new();
    for attack in attacks(&token, &pair)? {
        rows.push(measure(address, attack, &good)?);
    }
    let status = server.stop()?;
    ensure!(status.success(), "the server ended with {status}");
    let (text, is_kept) = table(&mut rows);
    let text = format!("{text}\n\n{}.", machine::describe());
    println!("{text}");
    if let Some(path) = &args.write {
        readme::write_table(path, "rejections", &text)?;
    }
    Ok(if is_kept {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(NOT_KEPT)
    })
}

fn start(args: &Args, config: &std::path::Path) -> Result<Stereod> {
    let config = config.to_str().context("a path that is no text")?;
    Stereod::launch(&Launch {
        program: args.stereod.as_deref(),
        args: &["--workers", "1", "--no-zenoh", "--config", config],
        ..Launch::default()
    })
}

/// A token, and a configuration that knows it.
fn client() -> Result<(String, String)> {
    let printed = String::from_utf8(run_binary(&["token", "lab"])?.stdout)?;
    let token = printed.lines().find(|line| line.starts_with("stereod_"));
    let section = printed
        .split_once("[clients.lab]")
        .context("no section for the configuration")?
        .1;
    Ok((
        token.context("no token")?.to_owned(),
        format!("[clients.lab]{section}"),
    ))
}

/// All inputs of a kind, with an idle worker and with a busy one.
fn measure(address: &str, mut attack: Attack, good: &Bytes) -> Result<Row> {
    let mut row = Row {
        name: attack.name,
        codes: Vec::new(),
        idle: Vec::new(),
        busy: Vec::new(),
        accepted: 0,
    };
    for count in 0..WARM_UP + COUNT {
        let took = row.try_one(address, &mut attack)?;
        row.idle.extend(took.filter(|_| count >= WARM_UP));
    }
    let is_over = AtomicBool::new(false);
    thread::scope(|scope| {
        let load = thread::Builder::new().name("load".to_owned());
        let load = load.spawn_scoped(scope, || keep_busy(address, good, &is_over))?;
        let measured = (0..COUNT).try_for_each(|_| {
            let took = row.try_one(address, &mut attack)?;
            row.busy.extend(took);
            anyhow::Ok(())
        });
        is_over.store(true, Ordering::Relaxed);
        load.join()
            .map_err(|_| anyhow::anyhow!("the load has panicked"))??;
        measured
    })?;
    ensure!(!row.idle.is_empty(), "{}: nothing was refused", row.name);
    Ok(row)
}

/// Good pairs, one after another.
fn keep_busy(address: &str, good: &Bytes, is_over: &AtomicBool) -> Result<()> {
    while !is_over.load(Ordering::Relaxed) {
        let answer = exchange::exchange(address, good)?;
        ensure!(
            matches!(answer.code, 200 | 504),
            "good input was refused: {}",
            answer.code
        );
    }
    Ok(())
}

impl Row {
    /// Sends one input; how long its refusal took, if it was one.
    fn try_one(&mut self, address: &str, attack: &mut Attack) -> Result<Option<Duration>> {
        let Answer { code, took } = exchange::exchange(address, &(attack.next)())
            .with_context(|| format!("{}: no answer", self.name))?;
        ensure!(code != 500, "{}: a fault of the server", self.name);
        if code < 400 {
            self.accepted += 1;
            return Ok(None);
        }
        if !self.codes.contains(&code) {
            self.codes.push(code);
            self.codes.sort_unstable();
        }
        Ok(Some(took))
    }
}

/// The table, and whether the floor was kept.
fn table(rows: &mut [Row]) -> (String, bool) {
    let mut text = "| hostile input | refused with | of | p50 | p99 | longest | p99 beside a busy worker |\n\
                    |---|---|---|---|---|---|---|"
        .to_owned();
    let mut all = Row {
        name: "all of them",
        codes: Vec::new(),
        idle: rows.iter().flat_map(|row| row.idle.clone()).collect(),
        busy: rows.iter().flat_map(|row| row.busy.clone()).collect(),
        accepted: rows.iter().map(|row| row.accepted).sum(),
    };
    for row in rows.iter_mut().chain([&mut all]) {
        let codes = Vec::from_iter(row.codes.iter().map(u16::to_string)).join(", ");
        let refused = row.idle.len() + row.busy.len();
        row.idle.sort_unstable();
        row.busy.sort_unstable();
        text += &format!(
            "\n| {} | {codes} | {refused} of {} | {:.2} ms | {:.2} ms | {:.2} ms | {:.2} ms |",
            row.name,
            refused + row.accepted,
            ms(percentile(&row.idle, 50)),
            ms(percentile(&row.idle, 99)),
            ms(percentile(&row.idle, 100)),
            ms(percentile(&row.busy, 99)),
        );
    }
    (text, percentile(&all.idle, 99) < FLOOR)
}

/// The value that `percent` of the sorted ones don't exceed.
fn percentile(sorted: &[Duration], percent: usize) -> Duration {
    let index = (sorted.len() * percent).div_ceil(100).saturating_sub(1);
    sorted.get(index).copied().unwrap_or_default()
}

fn ms(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_percentile_is_the_value_that_so_many_do_not_exceed() {
        let sorted = Vec::from_iter((1..=1000).map(Duration::from_micros));
        assert_eq!(percentile(&sorted, 50), Duration::from_micros(500));
        assert_eq!(percentile(&sorted, 99), Duration::from_micros(990));
        assert_eq!(percentile(&sorted, 100), Duration::from_micros(1000));
        assert_eq!(percentile(&sorted[..1], 99), Duration::from_micros(1));
    }

    #[test]
    fn the_floor_is_that_of_all_inputs_together() {
        let row = |micros| Row {
            name: "noise",
            codes: vec![400],
            idle: vec![Duration::from_micros(micros); 100],
            busy: Vec::new(),
            accepted: 0,
        };
        assert!(table(&mut [row(400), row(4999)]).1);
        assert!(!table(&mut [row(400), row(5001)]).1);
    }
}
