//! The server, or the servers: over HTTP or over Zenoh.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use stereo_client::v1::{StereoRequest, StereoResult};
use stereo_client::{Access, Client, ClientError, Fleet};

use crate::args::ServerArgs;
use crate::failure::{Failure, Kind};

/// How long connecting to a Zenoh network may take.
const CONNECT_WITHIN: Duration = Duration::from_secs(5);

/// How long servers have to be found on a network that is there.
const FOUND_WITHIN: Duration = Duration::from_secs(2);

/// Where a server is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Address {
    /// `http://host:port` or `https://host:port`
    Http(String),
    /// Endpoints of Zenoh, such as `tcp/host:7447`.
    Zenoh(Vec<String>),
}

impl FromStr for Address {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text.starts_with("http://") || text.starts_with("https://") {
            return Ok(Self::Http(text.to_owned()));
        }
        let endpoint = |part: &str| {
            let endpoint = match part.strip_prefix("zenoh://") {
                Some(place) => format!("tcp/{place}"),
                None => part.to_owned(),
            };
            let is_endpoint = endpoint.split_once('/').is_some_and(|(protocol, place)| {
                ["tcp", "tls", "udp", "quic", "ws"].contains(&protocol) && place.contains(':')
            });
            is_endpoint.then_some(endpoint)
        };
        let endpoints: Option<Vec<String>> = text.split(',').map(endpoint).collect();
        endpoints.map(Self::Zenoh).ok_or_else(|| {
            "give an address such as http://127.0.0.1:8080, or zenoh://127.0.0.1:7447 for all servers of a network"
                .to_owned()
        })
    }
}

/// An address, and what its servers ask of their clients.
#[derive(Debug)]
pub(crate) struct Place {
    pub(crate) address: Address,
    access: Access,
    zenoh_config: Option<PathBuf>,
}

impl Place {
    /// What the command line says; files are read here, once.
    pub(crate) fn new(args: ServerArgs) -> Result<Self, Failure> {
        let token = match args
            .token
            .as_deref()
            .map(|token| (token, token.strip_prefix('@')))
        {
            Some((_, Some(file))) => {
                let text = read("--token", Path::new(file))?;
                Some(String::from_utf8_lossy(&text).trim().to_owned())
            }
            Some((token, None)) => Some(token.to_owned()),
            None => None,
        };
        let identity_pem = match (&args.cert, &args.key) {
            (None, None) => None,
            (Some(cert), None) => Some(read("--cert", cert)?),
            (Some(cert), Some(key)) => Some([read("--cert", cert)?, read("--key", key)?].join(&b'\n')),
            (None, Some(_)) => {
                return Err(Failure::usage(
                    "--key is of no use alone: give the certificate that it belongs to with --cert",
                ));
            }
        };
        let ca_pem = args.ca.as_deref().map(|ca| read("--ca", ca)).transpose()?;
        Ok(Self {
            address: args.server,
            access: Access {
                token,
                ca_pem: ca_pem.map(Into::into),
                identity_pem: identity_pem.map(Into::into),
            },
            zenoh_config: args.zenoh_config,
        })
    }

    /// A client of one server; nothing is sent yet.
    pub(crate) fn client(&self, url: &str) -> Result<Client, Failure> {
        Ok(Client::with_access(url, &self.access)?)
    }

    /// Whoever matches pairs there; over HTTP nothing is sent yet.
    pub(crate) async fn connect(&self) -> Result<Server, Failure> {
        match &self.address {
            Address::Http(url) => Ok(Server::Http(self.client(url)?)),
            Address::Zenoh(endpoints) => {
                let fleet = self.fleet(endpoints).await?;
                if fleet.look(FOUND_WITHIN).await.is_empty() {
                    return Err(Failure::new(
                        Kind::Unreachable,
                        format!(
                            "no server is on the network at {}: start one with --zenoh-connect or --zenoh-listen",
                            endpoints.join(",")
                        ),
                    ));
                }
                Ok(Server::Zenoh(fleet))
            }
        }
    }

    /// A session with a Zenoh network.
    pub(crate) async fn fleet(&self, endpoints: &[String]) -> Result<Fleet, Failure> {
        let endpoints: Vec<&str> = endpoints.iter().map(String::as_str).collect();
        let connecting = async {
            match &self.zenoh_config {
                None => Fleet::connect(&endpoints).await,
                Some(config) => Fleet::connect_with(&endpoints, config).await,
            }
        };
        match tokio::time::timeout(CONNECT_WITHIN, connecting).await {
            Ok(fleet) => Ok(fleet?),
            Err(_) => Err(Failure::new(
                Kind::Unreachable,
                format!(
                    "no answer from {} within {CONNECT_WITHIN:?}: start the router, or correct the address",
                    endpoints.join(",")
                ),
            )),
        }
    }

    /// A session with the Zenoh network of a server, wherever that listens.
    pub(crate) async fn fleet_of(&self, client: &Client) -> Result<Fleet, Failure> {
        let network = client.readiness().await?.zenoh;
        if network.locators.is_empty() {
            let why = network.why.map(|why| format!(": {why}")).unwrap_or_default();
            return Err(Failure::new(
                Kind::Unreachable,
                format!(
                    "the server's Zenoh is {}{why}; start it without --no-zenoh, or give the network's address with --server \
                     zenoh://HOST:PORT",
                    network.state
                ),
            ));
        }
        self.fleet(&network.locators).await
    }
}

fn read(flag: &str, path: &Path) -> Result<Vec<u8>, Failure> {
    std::fs::read(path).map_err(|why| {
        Failure::usage(format!(
            "{flag} {} can't be read ({why}): name a file",
            path.display()
        ))
    })
}

/// Whoever matches pairs.
#[derive(Debug, Clone)]
pub(crate) enum Server {
    Http(Client),
    Zenoh(Fleet),
}

impl Server {
    /// Matches one pair.
    pub(crate) async fn match_pair(&self, request: &StereoRequest) -> Result<StereoResult, ClientError> {
        match self {
            Self::Http(client) => client.match_pair(request).await,
            Self::Zenoh(fleet) => fleet.match_pair(request).await,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Address;

    #[test]
    fn an_address_says_which_way_to_go() {
        let zenoh = |endpoints: &[&str]| Address::Zenoh(endpoints.iter().map(|&e| e.to_owned()).collect());
        assert_eq!("http://a:1".parse(), Ok(Address::Http("http://a:1".to_owned())));
        assert_eq!("https://a".parse(), Ok(Address::Http("https://a".to_owned())));
        assert_eq!("zenoh://a:1".parse(), Ok(zenoh(&["tcp/a:1"])));
        assert_eq!("tcp/a:1,tls/b:2".parse(), Ok(zenoh(&["tcp/a:1", "tls/b:2"])));
        for wrong in ["", "a:1", "ftp://a", "tcp/", "zenoh://a"] {
            assert!(wrong.parse::<Address>().is_err(), "{wrong}");
        }
    }
}
