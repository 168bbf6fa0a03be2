//! The network that frames come over, as `/readyz` shows it.

use serde::Serialize;
use utoipa::ToSchema;

/// What is known about Zenoh.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Network {
    /// Where it stands.
    pub(crate) state: NetworkState,
    /// Why it doesn't stand better, and what to do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) why: Option<String>,
    /// Where this server can be reached: where it listens, or at the router that it is a client of.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) locators: Vec<String>,
    /// The live servers of the fleet, this one included.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) servers: Vec<String>,
    /// Others it is connected to: routers, peers and clients.
    pub(crate) connections: usize,
    /// Whether it was told to connect to somebody.
    #[serde(skip)]
    pub(crate) has_endpoints: bool,
    /// Whether the server isn't ready without it.
    #[serde(skip)]
    pub(crate) is_required: bool,
}

/// Where a network stands.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum NetworkState {
    /// Switched off.
    #[default]
    Off,
    /// The session is not open yet.
    Opening,
    /// The session is open.
    Open,
}

impl Network {
    /// Why the server isn't ready because of it.
    pub(crate) fn obstacle(&self) -> Option<String> {
        if !self.is_required {
            return None;
        }
        match self.state {
            NetworkState::Off => Some("Zenoh is required but switched off".to_owned()),
            NetworkState::Opening => Some(match &self.why {
                Some(why) => format!("the Zenoh session is not open: {why}"),
                None if self.has_endpoints => {
                    "the Zenoh session is not open yet: start the router, or correct --zenoh-connect"
                        .to_owned()
                }
                None => "the Zenoh session is not open yet".to_owned(),
            }),
            NetworkState::Open if self.has_endpoints && self.connections == 0 => {
                Some("Zenoh is connected to nobody: start the router, or correct --zenoh-connect".to_owned())
            }
            NetworkState::Open => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_network_is_an_obstacle_only_if_it_is_required_and_not_there() {
        let mut network = Network {
            state: NetworkState::Open,
            has_endpoints: true,
            ..Network::default()
        };
        assert_eq!(network.obstacle(), None);
        network.is_required = true;
        assert!(network.obstacle().is_some_and(|why| why.contains("router")));
        network.connections = 1;
        assert_eq!(network.obstacle(), None);
        network.state = NetworkState::Opening;
        network.why = Some("the port is taken".to_owned());
        assert!(
            network
                .obstacle()
                .is_some_and(|why| why.contains("the port is taken"))
        );
    }
}
