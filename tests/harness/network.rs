//! Networks that aren't good: hosts of their own with links that can be cut, narrowed and made to lose packets, and a relay with a delay.
//!
//! Hosts are network namespaces of Linux. All of them, the one of the program that makes them too, are inside one set of namespaces that
//! goes with that program ([`inside`]), so nothing is left behind on the machine.

mod lab;
mod relay;

use std::process::{Command, Stdio};

pub use self::lab::{Lab, ROUTER};
pub use self::relay::Relay;

/// Options of `unshare`: a network, mounts and processes of its own, which end with it.
const UNSHARE: [&str; 7] = [
    "--map-root-user",
    "--net",
    "--mount",
    "--pid",
    "--fork",
    "--kill-child",
    "--mount-proc",
];

/// What is done inside before anything else: names of hosts are its own too.
const PREPARE: &str =
    "mkdir -p /run/netns && mount -t tmpfs none /run/netns && ip link set lo up && exec \"$0\" \"$@\"";

/// The command that runs `program` inside namespaces of its own: a network with nothing but a loopback, mounts, processes.
#[must_use]
pub fn inside(program: impl AsRef<std::ffi::OsStr>) -> Command {
    let mut command = Command::new("unshare");
    command.args(UNSHARE).args(["sh", "-c", PREPARE]).arg(program);
    command
}

/// Whether hosts can be made here.
///
/// # Errors
/// Why not.
pub fn is_possible() -> Result<(), String> {
    let mut probe = inside("ip");
    let output = probe
        .args(["netns", "add", "probe"])
        .stdin(Stdio::null())
        .output();
    let output = output.map_err(|why| format!("unshare: {why}"))?;
    match output.status.success() {
        true => Ok(()),
        false => Err(String::from_utf8_lossy(&output.stderr).trim().to_owned()),
    }
}

/// Whether this is a network with anything in it but its loopback.
#[must_use]
pub fn is_elsewhere() -> bool {
    let output = Command::new("ip").args(["-oneline", "link"]).output();
    output.map_or(true, |output| {
        output.stdout.iter().filter(|&&byte| byte == b'\n').count() != 1
    })
}
