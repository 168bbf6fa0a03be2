//! The real `stereod` binary as a child process: started on a port of its own, stopped and reaped when dropped.

use std::ffi::OsStr;
use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, ExitStatus, Output, Stdio};
use std::sync::OnceLock;
use std::time::SystemTime;

use anyhow::{Context, Result, bail};

/// Cargo's target folder, in which this program lies.
///
/// # Errors
/// If this program doesn't lie in one.
pub fn target_dir() -> Result<PathBuf> {
    let program = std::env::current_exe().context("this program's path is unknown")?;
    let release = program.ancestors().find(|folder| folder.ends_with("release"));
    release
        .and_then(Path::parent)
        .map(PathBuf::from)
        .with_context(|| format!("{} isn't in a folder of release builds", program.display()))
}

/// What the server is built from, below the workspace's root.
const SOURCES: [&str; 8] = [
    "server/build.rs",
    "server/src",
    "server/stereo/src",
    "server/scheduler/src",
    "proto/src",
    "surface/src",
    "clients/console/dist",
    "Cargo.lock",
];

/// What the command line is built from.
const CLIENT_SOURCES: [&str; 5] = [
    "clients/cli/src",
    "clients/rust/src",
    "proto/src",
    "surface/src",
    "Cargo.lock",
];

/// The server's release binary. `cargo test --workspace` has built it; if it isn't there or older than its sources, which
/// happens when less than the workspace is built, cargo is asked for it once a process.
///
/// # Errors
/// If it can't be built.
pub fn binary() -> Result<&'static Path> {
    static BINARY: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    once(&BINARY, "stereod", &SOURCES)
}

/// The same of the command line, `stereo`.
///
/// # Errors
/// If it can't be built.
pub fn client_binary() -> Result<&'static Path> {
    static BINARY: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    once(&BINARY, "stereo", &CLIENT_SOURCES)
}

fn once(
    binary: &'static OnceLock<Result<PathBuf, String>>,
    name: &str,
    sources: &[&str],
) -> Result<&'static Path> {
    match binary.get_or_init(|| current_binary(name, sources).map_err(|why| format!("{why:#}"))) {
        Ok(path) => Ok(path),
        Err(why) => bail!("{why}"),
    }
}

fn current_binary(name: &str, sources: &[&str]) -> Result<PathBuf> {
    let target = target_dir()?;
    let binary = target.join("release").join(name);
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    let built = binary.metadata().and_then(|file| file.modified());
    if built.is_ok_and(|built| sources.iter().all(|source| is_older(&root.join(source), built))) {
        return Ok(binary);
    }
    // Not quietly: it takes minutes, in which nothing else is said.
    let status = Command::new("cargo")
        .args(["build", "--release", "--workspace", "--bin", name])
        .arg("--target-dir")
        .arg(&target)
        .current_dir(root)
        .status()
        .with_context(|| format!("can't run cargo to build {name}"))?;
    if !status.success() {
        bail!("`cargo build --release --workspace --bin {name}` failed: {status}");
    }
    Ok(binary)
}

/// Whether a file, or everything in a folder, was last changed before `time`.
fn is_older(path: &Path, time: SystemTime) -> bool {
    if let Ok(entries) = std::fs::read_dir(path) {
        return entries.flatten().all(|entry| is_older(&entry.path(), time));
    }
    path.metadata()
        .and_then(|file| file.modified())
        .is_ok_and(|changed| changed <= time)
}

/// Runs the binary to its end.
///
/// # Errors
/// If it can't be built or started.
pub fn run(args: &[&str]) -> Result<Output> {
    Command::new(binary()?)
        .args(args)
        .stdin(Stdio::null())
        .output()
        .context("can't run stereod")
}

/// How a server is started.
#[derive(Debug, Clone, Copy, Default)]
pub struct Launch<'a> {
    /// The program; `None` = the release binary of this workspace.
    pub program: Option<&'a Path>,
    /// The cores it may run on, as `taskset --cpu-list` takes them; `None` = all.
    pub cores: Option<&'a str>,
    /// The network namespace it runs in, as `ip netns` names it: another host; `None` = this one.
    pub host: Option<&'a str>,
    /// Words before the program which then become it, such as `prlimit --nofile=64` or `env NAME=value`.
    pub via: &'a [&'a str],
    /// The address to listen on; `None` = a free port of 127.0.0.1.
    pub http: Option<&'a str>,
    /// The file that its log goes to, from `info` on; `None` = errors alone, to where this process has its own.
    pub log: Option<&'a Path>,
    /// Arguments of `stereod serve`, besides the address and the log level.
    pub args: &'a [&'a str],
    /// Whether Ctrl-C in the terminal is for this process alone, which then stops the server.
    pub is_apart: bool,
}

/// Moves the threads of a process whose names start with `name` to `cores`; false if there is none or it can't be done.
fn pin_threads(process: u32, name: &str, cores: &str) -> bool {
    let Ok(threads) = std::fs::read_dir(format!("/proc/{process}/task")) else {
        return false;
    };
    let is_named = |thread: &std::fs::DirEntry| {
        let given = std::fs::read_to_string(thread.path().join("comm"));
        given.is_ok_and(|given| given.starts_with(name))
    };
    let mut found = threads.flatten().filter(is_named).peekable();
    found.peek().is_some()
        && found.all(|thread| {
            let mut command = Command::new("taskset");
            command
                .args(["--cpu-list", "--pid", cores])
                .arg(thread.file_name());
            let output = command.stdin(Stdio::null()).output();
            output.is_ok_and(|output| output.status.success())
        })
}

/// A running server.
#[derive(Debug)]
pub struct Stereod {
    child: Child,
    // Kept open: the server may print more.
    _stdout: BufReader<ChildStdout>,
    url: String,
    admin_url: Option<String>,
}

impl Stereod {
    /// Starts `stereod serve` on a free port of 127.0.0.1 and waits until it listens.
    ///
    /// # Errors
    /// If the binary can't be built or started, or ends before it listens.
    pub fn start(args: &[&str]) -> Result<Self> {
        Self::launch(&Launch {
            args,
            ..Launch::default()
        })
    }

    /// As [`start`](Self::start), with a say in which program runs where.
    ///
    /// # Errors
    /// If the program can't be built or started, or ends before it listens.
    pub fn launch(launch: &Launch<'_>) -> Result<Self> {
        let Launch {
            program,
            cores,
            host,
            via,
            http,
            log,
            args,
            is_apart,
        } = *launch;
        let program = match program {
            Some(program) => program,
            None => binary()?,
        };
        // `ip` and `taskset` become the program they start, so the child's id is the server's.
        let mut words: Vec<&OsStr> = Vec::new();
        if let Some(host) = host {
            words.extend(["ip", "netns", "exec", host].map(OsStr::new));
        }
        if let Some(cores) = cores {
            words.extend(["taskset", "--cpu-list", cores].map(OsStr::new));
        }
        words.extend(via.iter().map(OsStr::new));
        words.push(program.as_os_str());
        let mut command = Command::new(words[0]);
        command.args(&words[1..]);
        if is_apart {
            command.process_group(0);
        }
        let level = if log.is_some() { "info" } else { "error" };
        if let Some(log) = log {
            let file = std::fs::File::options().create(true).append(true).open(log);
            command.stderr(file.with_context(|| format!("can't write {}", log.display()))?);
        }
        let mut child = command
            .args(["serve", "--http", http.unwrap_or("127.0.0.1:0"), "--log", level])
            .args(args)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("can't start {}", program.display()))?;
        let mut stdout = BufReader::new(child.stdout.take().context("its output is piped")?);
        let mut line = String::new();
        let mut admin_url = None;
        loop {
            line.clear();
            if stdout.read_line(&mut line)? == 0 {
                bail!(
                    "stereod {} ended before it listened: {}",
                    args.join(" "),
                    child.wait()?
                );
            }
            if let Some((_, url)) = line.split_once("admin on ") {
                admin_url = Some(url.trim().to_owned());
            }
            if let Some((_, url)) = line.split_once("listening on ") {
                return Ok(Self {
                    child,
                    _stdout: stdout,
                    url: url.trim().to_owned(),
                    admin_url,
                });
            }
        }
    }

    /// Moves the threads of its workers to `cores`, as `taskset --cpu-list` takes them. Call it once the server is ready: a thread has no
    /// name before it runs for the first time.
    ///
    /// # Errors
    /// If there are none or they can't be moved.
    pub fn pin_workers(&self, cores: &str) -> Result<()> {
        if !pin_threads(self.child.id(), "stereo-worker", cores) {
            bail!("the threads of the workers can't be moved to core {cores} with taskset");
        }
        Ok(())
    }

    /// Where it listens: `http://127.0.0.1:PORT`, or `https` with a certificate.
    #[must_use]
    pub fn url(&self) -> &str {
        &self.url
    }

    /// The same of its second address, if it was given one (`--admin`).
    #[must_use]
    pub fn admin_url(&self) -> Option<&str> {
        self.admin_url.as_deref()
    }

    /// The process's number, by which the system knows it.
    #[must_use]
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// The most memory it has ever had in use at one time, in bytes (Linux's `VmHWM`); `None` where the system doesn't say.
    #[must_use]
    pub fn memory_peak_bytes(&self) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
        let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
        Some(kib * 1024)
    }

    /// Memory it has in use now (resident set), in bytes.
    ///
    /// # Errors
    /// If the system doesn't say.
    pub fn memory_bytes(&self) -> Result<u64> {
        let kib = self.status("VmRSS:")?;
        Ok(1024 * kib.trim_end_matches("kB").trim().parse::<u64>()?)
    }

    /// Threads it has now.
    ///
    /// # Errors
    /// If the system doesn't say.
    pub fn threads(&self) -> Result<u64> {
        Ok(self.status("Threads:")?.parse()?)
    }

    /// Descriptors it has open now: files, sockets and the like.
    ///
    /// # Errors
    /// If the system doesn't say.
    pub fn descriptors(&self) -> Result<u64> {
        let path = format!("/proc/{}/fd", self.child.id());
        let open = std::fs::read_dir(&path).with_context(|| format!("can't read {path}"))?;
        Ok(open.count() as u64)
    }

    /// How many of these clients, by their own addresses, the process is connected with over IPv4: those that it has closed are none,
    /// whether or not they know.
    ///
    /// # Errors
    /// If the system doesn't say.
    pub fn connected(&self, clients: &[SocketAddr]) -> Result<usize> {
        let path = format!("/proc/{}/net/tcp", self.child.id());
        let table = std::fs::read_to_string(&path).with_context(|| format!("can't read {path}"))?;
        let is_client = |remote: &str| {
            clients.iter().any(|client| match client {
                SocketAddr::V4(client) => {
                    let host = u32::from_ne_bytes(client.ip().octets());
                    remote == format!("{host:08X}:{:04X}", client.port())
                }
                SocketAddr::V6(_) => false,
            })
        };
        // Number, local and remote address, state: 01 = established, 08 = closed by the other side alone.
        let is_open = |line: &&str| {
            let columns = Vec::from_iter(line.split_whitespace().take(4));
            matches!(columns[..], [_, _, remote, "01" | "08"] if is_client(remote))
        };
        Ok(table.lines().filter(is_open).count())
    }

    /// A line of what the system says about the process.
    fn status(&self, name: &str) -> Result<String> {
        let path = format!("/proc/{}/status", self.child.id());
        let status = std::fs::read_to_string(&path).with_context(|| format!("can't read {path}"))?;
        let line = status.lines().find_map(|line| line.strip_prefix(name));
        Ok(line
            .with_context(|| format!("no {name} in {path}"))?
            .trim()
            .to_owned())
    }

    /// Memory that it could write to, whether or not it ever did (Linux's `VmData`), in bytes: what a limit of data memory counts.
    ///
    /// # Errors
    /// If the system doesn't say.
    pub fn data_bytes(&self) -> Result<u64> {
        let kib = self.status("VmData:")?;
        Ok(1024 * kib.trim_end_matches("kB").trim().parse::<u64>()?)
    }

    /// Processor time that it has used, in clock ticks of the system, of which there are 100 a second.
    ///
    /// # Errors
    /// If the system doesn't say.
    pub fn cpu_ticks(&self) -> Result<u64> {
        let path = format!("/proc/{}/stat", self.child.id());
        let line = std::fs::read_to_string(&path).with_context(|| format!("can't read {path}"))?;
        // The name may have spaces; what follows it has none.
        let rest = line.rsplit_once(')').context("no name of the program")?.1;
        let ticks = |field: usize| -> Result<u64> {
            let word = rest.split_whitespace().nth(field).context("too few fields")?;
            Ok(word.parse()?)
        };
        Ok(ticks(11)? + ticks(12)?)
    }

    /// Waits until it has ended by itself, or by what was done to it.
    ///
    /// # Errors
    /// If the system can't say.
    pub fn ended(mut self) -> Result<ExitStatus> {
        self.child.wait().context("can't wait for stereod")
    }

    /// Asks it to stop, as a service manager does (SIGTERM), and waits until it has.
    ///
    /// # Errors
    /// If the signal can't be sent.
    pub fn stop(mut self) -> Result<ExitStatus> {
        self.signal("TERM")?;
        self.child.wait().context("can't wait for stereod")
    }

    /// Sends it a signal, such as `STOP`, which freezes it, or `CONT`.
    ///
    /// # Errors
    /// If the signal can't be sent.
    pub fn signal(&mut self, name: &str) -> Result<()> {
        send_signal(self.child.id(), name).with_context(|| format!("stereod: {:?}", self.child.try_wait()))
    }
}

/// Sends a signal to a process that this one has started.
pub(crate) fn send_signal(process: u32, name: &str) -> Result<()> {
    // The shell's own `kill`: sending a signal from here would need unsafe code or a further crate.
    let sent = Command::new("sh")
        .args(["-c", "kill -\"$1\" \"$0\"", &process.to_string(), name])
        .status()
        .context("can't run sh to send a signal")?;
    if !sent.success() {
        bail!("process {process} was gone before SIG{name}");
    }
    Ok(())
}

impl Drop for Stereod {
    fn drop(&mut self) {
        // After `stop` it has been waited for: both do nothing then.
        drop(self.child.kill());
        drop(self.child.wait());
    }
}
