//! Hosts and the links between them, by `ip` and `tc` of iproute2, and `iptables`.

use std::process::Command;

use anyhow::{Context, Result, ensure};

/// The host that everybody has a link to.
pub const ROUTER: &str = "router";

/// All links, each from a host to the router's.
#[derive(Debug)]
pub struct Lab {
    links: Vec<Link>,
}

#[derive(Debug)]
struct Link {
    name: &'static str,
    /// The host at its end; `None` = this one.
    host: Option<String>,
}

impl Lab {
    /// With the router's host and no other.
    ///
    /// # Errors
    /// If that can't be made here.
    pub fn new() -> Result<Self> {
        ip(&["netns", "add", ROUTER])?;
        ip(&["-netns", ROUTER, "link", "set", "lo", "up"])?;
        Ok(Self { links: Vec::new() })
    }

    /// A link from the router to `name`: to a host of that name, or to this one.
    ///
    /// # Errors
    /// If that can't be made.
    pub fn link(&mut self, name: &'static str, host: Option<&str>) -> Result<()> {
        self.links.push(Link {
            name,
            host: host.map(str::to_owned),
        });
        let near = format!("10.20.{}.2/24", self.number(name)?);
        let far = format!("{}/24", self.router_of(name)?);
        let on_host: Vec<&str> = host.map_or_else(Vec::new, |host| vec!["-netns", host]);
        if let Some(host) = host {
            ip(&["netns", "add", host])?;
            ip(&["-netns", host, "link", "set", "lo", "up"])?;
        }
        let pair = [
            "link", "add", name, "type", "veth", "peer", "name", name, "netns", ROUTER,
        ];
        ip(&[&on_host[..], &pair].concat())?;
        ip(&[&on_host[..], &["address", "add", &near, "dev", name]].concat())?;
        ip(&[&on_host[..], &["link", "set", name, "up"]].concat())?;
        ip(&["-netns", ROUTER, "address", "add", &far, "dev", name])?;
        ip(&["-netns", ROUTER, "link", "set", name, "up"])
    }

    /// Cuts the link to a host.
    ///
    /// # Errors
    /// If there is none.
    pub fn cut(&self, name: &str) -> Result<()> {
        ip(&["-netns", ROUTER, "link", "set", name, "down"])
    }

    /// Heals it.
    ///
    /// # Errors
    /// If there is none.
    pub fn heal(&self, name: &str) -> Result<()> {
        ip(&["-netns", ROUTER, "link", "set", name, "up"])
    }

    /// Makes what the router sends to a host slow: `rate` as `tc` takes it, with room for a fifth of a second's worth.
    ///
    /// # Errors
    /// If that can't be done.
    pub fn narrow(&self, name: &str, rate: &str) -> Result<()> {
        shape(Some(ROUTER), name, rate)
    }

    /// Makes both ways of a link slow.
    ///
    /// # Errors
    /// If that can't be done.
    pub fn narrow_both_ways(&self, name: &str, rate: &str) -> Result<()> {
        shape(Some(ROUTER), name, rate)?;
        shape(self.host_of(name)?, name, rate)
    }

    /// Makes what the router sends as fast as before.
    ///
    /// # Errors
    /// If it was not slow.
    pub fn widen(&self, name: &str) -> Result<()> {
        unshape(Some(ROUTER), name)
    }

    /// Makes both ways as fast as before.
    ///
    /// # Errors
    /// If they were not slow.
    pub fn widen_both_ways(&self, name: &str) -> Result<()> {
        unshape(Some(ROUTER), name)?;
        unshape(self.host_of(name)?, name)
    }

    /// Loses this share of the packets of a link, each way, at random.
    ///
    /// # Errors
    /// If that can't be done.
    pub fn lose(&self, name: &str, share: f64) -> Result<()> {
        self.drop_packets("--append", name, share)
    }

    /// Loses them no longer.
    ///
    /// # Errors
    /// If this share was not lost.
    pub fn keep(&self, name: &str, share: f64) -> Result<()> {
        self.drop_packets("--delete", name, share)
    }

    fn drop_packets(&self, what: &str, name: &str, share: f64) -> Result<()> {
        let share = share.to_string();
        for host in [Some(ROUTER), self.host_of(name)?] {
            // Where they arrive: what a host can't send, it knows, and sends again at once.
            let rule = [
                what,
                "INPUT",
                "--in-interface",
                name,
                "--match",
                "statistic",
                "--mode",
                "random",
                "--probability",
                &share,
                "--jump",
                "DROP",
            ];
            on(host, "iptables", &rule)?;
        }
        Ok(())
    }

    /// The router's address on the link to a host.
    ///
    /// # Errors
    /// If there is no such link.
    pub fn router_of(&self, name: &str) -> Result<String> {
        Ok(format!("10.20.{}.1", self.number(name)?))
    }

    fn number(&self, name: &str) -> Result<usize> {
        let place = self.links.iter().position(|link| link.name == name);
        place.with_context(|| format!("no link has the name {name}"))
    }

    fn host_of(&self, name: &str) -> Result<Option<&str>> {
        Ok(self.links[self.number(name)?].host.as_deref())
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        // All of it goes with this program otherwise.
        for Link { name, host } in &self.links {
            drop(on(host.as_deref(), "ip", &["link", "del", name]));
            if let Some(host) = host {
                drop(ip(&["netns", "del", host]));
            }
        }
        drop(ip(&["netns", "del", ROUTER]));
    }
}

fn shape(host: Option<&str>, link: &str, rate: &str) -> Result<()> {
    let shape = [
        "qdisc", "add", "dev", link, "root", "tbf", "rate", rate, "burst", "64kb", "latency", "200ms",
    ];
    on(host, "tc", &shape)
}

fn unshape(host: Option<&str>, link: &str) -> Result<()> {
    on(host, "tc", &["qdisc", "del", "dev", link, "root"])
}

/// Runs a program on a host; `None` = this one.
fn on(host: Option<&str>, program: &str, args: &[&str]) -> Result<()> {
    match host {
        Some(host) => ip(&[&["netns", "exec", host, program], args].concat()),
        None => run(program, args),
    }
}

fn ip(args: &[&str]) -> Result<()> {
    run("ip", args)
}

fn run(program: &str, args: &[&str]) -> Result<()> {
    let output = Command::new(program).args(args).output();
    let output = output.with_context(|| format!("can't run {program}"))?;
    ensure!(
        output.status.success(),
        "{program} {}: {}",
        args.join(" "),
        String::from_utf8_lossy(&output.stderr).trim()
    );
    Ok(())
}
