//! Hosts and the links between them, by `ip` and `tc` of iproute2.

use std::net::SocketAddr;
use std::process::{Command, Stdio};

/// The host that everybody has a link to.
pub(super) const ROUTER: &str = "router";

/// Options of `unshare`: a network, mounts and processes of its own, which end with it.
pub(super) const UNSHARE: [&str; 7] = [
    "--map-root-user",
    "--net",
    "--mount",
    "--pid",
    "--fork",
    "--kill-child",
    "--mount-proc",
];

/// What is done inside before anything else: names of hosts are its own too.
pub(super) const PREPARE: &str =
    "mkdir -p /run/netns && mount -t tmpfs none /run/netns && ip link set lo up && exec \"$0\" \"$@\"";

/// Whether hosts can be made here; if not, why.
pub(super) fn is_possible() -> Result<(), String> {
    let output = Command::new("unshare")
        .args(UNSHARE)
        .args(["sh", "-c", PREPARE, "ip", "netns", "add", "probe"])
        .stdin(Stdio::null())
        .output()
        .map_err(|why| format!("unshare: {why}"))?;
    if output.status.success() {
        return Ok(());
    }
    Err(String::from_utf8_lossy(&output.stderr).trim().to_owned())
}

/// Whether this is a network with anything else in it.
pub(super) fn is_elsewhere() -> bool {
    let output = Command::new("ip").args(["-oneline", "link"]).output();
    output.map_or(true, |output| {
        output.stdout.iter().filter(|&&byte| byte == b'\n').count() != 1
    })
}

/// Where somebody listens.
pub(super) fn address(host: &str, port: u16) -> SocketAddr {
    format!("{host}:{port}").parse().expect("an address")
}

/// All links, each from a host to the router's.
pub(super) struct Lab {
    hosts: Vec<&'static str>,
}

impl Lab {
    /// With the router's host and no other.
    pub(super) fn new() -> Self {
        ip(&["netns", "add", ROUTER]);
        ip(&["-netns", ROUTER, "link", "set", "lo", "up"]);
        Self { hosts: Vec::new() }
    }

    /// A link from the router to `name`: to a host of that name, or to this one.
    pub(super) fn link(&mut self, name: &'static str, host: Option<&str>) {
        self.hosts.push(name);
        let (near, far) = (self.address_of(name), self.router_of(name));
        let on_host: Vec<&str> = host.map_or_else(Vec::new, |host| vec!["-netns", host]);
        if let Some(host) = host {
            ip(&["netns", "add", host]);
            ip(&["-netns", host, "link", "set", "lo", "up"]);
        }
        let pair = [
            "link", "add", name, "type", "veth", "peer", "name", name, "netns", ROUTER,
        ];
        ip(&[&on_host[..], &pair].concat());
        ip(&[
            &on_host[..],
            &["address", "add", &format!("{near}/24"), "dev", name],
        ]
        .concat());
        ip(&[&on_host[..], &["link", "set", name, "up"]].concat());
        let far = format!("{far}/24");
        ip(&["-netns", ROUTER, "address", "add", &far, "dev", name]);
        ip(&["-netns", ROUTER, "link", "set", name, "up"]);
    }

    /// Cuts the link to a host.
    pub(super) fn cut(&self, name: &str) {
        ip(&["-netns", ROUTER, "link", "set", name, "down"]);
    }

    /// Heals it.
    pub(super) fn heal(&self, name: &str) {
        ip(&["-netns", ROUTER, "link", "set", name, "up"]);
    }

    /// Makes what the router sends to a host slow: `rate` as `tc` takes it, with room for a fifth of a second's worth.
    pub(super) fn narrow(&self, name: &str, rate: &str) {
        let shape = ["root", "tbf", "rate", rate, "burst", "64kb", "latency", "200ms"];
        run(
            "tc",
            &[&["-netns", ROUTER, "qdisc", "add", "dev", name], &shape[..]].concat(),
        );
    }

    /// Makes it as fast as before.
    pub(super) fn widen(&self, name: &str) {
        run("tc", &["-netns", ROUTER, "qdisc", "del", "dev", name, "root"]);
    }

    /// The router's address on the link to a host.
    pub(super) fn router_of(&self, name: &str) -> String {
        format!("10.20.{}.1", self.number(name))
    }

    fn address_of(&self, name: &str) -> String {
        format!("10.20.{}.2", self.number(name))
    }

    fn number(&self, name: &str) -> usize {
        let place = self.hosts.iter().position(|&host| host == name);
        place.expect("a host with a link")
    }
}

fn ip(args: &[&str]) {
    run("ip", args);
}

fn run(program: &str, args: &[&str]) {
    let output = Command::new(program).args(args).output().expect("iproute2");
    assert!(
        output.status.success(),
        "{program} {}: {}",
        args.join(" "),
        String::from_utf8_lossy(&output.stderr)
    );
}
