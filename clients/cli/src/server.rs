//! The server, or the servers: over HTTP or over Zenoh.

use std::str::FromStr;
use std::time::Duration;

use stereo_client::v1::{StereoRequest, StereoResult};
use stereo_client::{Client, ClientError, Fleet};

use crate::failure::{Failure, Kind};

/// How long connecting to a Zenoh network may take.
const CONNECT_WITHIN: Duration = Duration::from_secs(5);

/// How long servers have to be found on a network that is there.
const FOUND_WITHIN: Duration = Duration::from_secs(2);

/// Where a server is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Address {
    /// `http://host:port`
    Http(String),
    /// Endpoints of Zenoh, such as `tcp/host:7447`.
    Zenoh(Vec<String>),
}

impl FromStr for Address {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text.starts_with("http://") {
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

/// Whoever matches pairs.
#[derive(Debug, Clone)]
pub(crate) enum Server {
    Http(Client),
    Zenoh(Fleet),
}

impl Server {
    /// Connects; over HTTP nothing is sent yet.
    pub(crate) async fn connect(address: &Address) -> Result<Self, Failure> {
        match address {
            Address::Http(url) => Ok(Self::Http(Client::new(url)?)),
            Address::Zenoh(endpoints) => {
                let fleet = fleet(endpoints).await?;
                if fleet.look(FOUND_WITHIN).await.is_empty() {
                    return Err(Failure::new(
                        Kind::Unreachable,
                        format!(
                            "no server is on the network at {}: start one with --zenoh-connect or --zenoh-listen",
                            endpoints.join(",")
                        ),
                    ));
                }
                Ok(Self::Zenoh(fleet))
            }
        }
    }

    /// Matches one pair.
    pub(crate) async fn match_pair(&self, request: &StereoRequest) -> Result<StereoResult, ClientError> {
        match self {
            Self::Http(client) => client.match_pair(request).await,
            Self::Zenoh(fleet) => fleet.match_pair(request).await,
        }
    }
}

/// A session with a Zenoh network.
pub(crate) async fn fleet(endpoints: &[String]) -> Result<Fleet, Failure> {
    let endpoints: Vec<&str> = endpoints.iter().map(String::as_str).collect();
    match tokio::time::timeout(CONNECT_WITHIN, Fleet::connect(&endpoints)).await {
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
pub(crate) async fn fleet_of(client: &Client) -> Result<Fleet, Failure> {
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
    fleet(&network.locators).await
}

#[cfg(test)]
mod tests {
    use super::Address;

    #[test]
    fn an_address_says_which_way_to_go() {
        let zenoh = |endpoints: &[&str]| Address::Zenoh(endpoints.iter().map(|&e| e.to_owned()).collect());
        assert_eq!("http://a:1".parse(), Ok(Address::Http("http://a:1".to_owned())));
        assert_eq!("zenoh://a:1".parse(), Ok(zenoh(&["tcp/a:1"])));
        assert_eq!("tcp/a:1,tls/b:2".parse(), Ok(zenoh(&["tcp/a:1", "tls/b:2"])));
        for wrong in ["", "a:1", "https://a", "tcp/", "zenoh://a"] {
            assert!(wrong.parse::<Address>().is_err(), "{wrong}");
        }
    }
}
