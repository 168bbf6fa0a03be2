//! Servers over Zenoh: each request goes to the one that has most room of two, is tried again at another if that one fails, and may be
//! sent to a second one when the first is slow.

mod camera;
mod presence;
mod roster;

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use futures_util::StreamExt;
use futures_util::stream::FuturesUnordered;
use prost::Message;
use stereo_proto::v1::{Reason, ServerLoad, Status, StereoRequest, StereoResult};
use zenoh::Session;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::pubsub::Subscriber;
use zenoh::query::ConsolidationMode;

pub use self::camera::{Camera, Results};
pub use self::presence::CameraPresence;
use self::roster::Roster;
use crate::ClientError;
use crate::compression::decompress;

/// The budget of a request that gives none, as the server has it.
const DEFAULT_BUDGET: Duration = Duration::from_millis(100);
/// How much longer than the budget an answer is waited for: it has to travel.
const GRACE: Duration = Duration::from_secs(2);
/// Time to look again for a server, while there is none.
const LOOK_AGAIN: Duration = Duration::from_millis(20);
/// Time to look whether the server that was asked is still there.
const STILL_THERE: Duration = Duration::from_millis(100);
/// Servers that are asked at a time at most.
const MOST_ASKED: usize = 8;
/// Encoding of a request.
const REQUEST: &str = "application/protobuf;stereo.v1.StereoRequest";

/// What Zenoh says, without the place in its sources.
fn without_place(why: &str) -> String {
    why.split(" at /")
        .next()
        .unwrap_or_default()
        .trim_end_matches(['!', ' ', '.'])
        .to_owned()
}

/// Talks to all servers that a Zenoh session reaches; cheap to clone.
#[derive(Debug, Clone)]
pub struct Fleet {
    session: Session,
    roster: Arc<Roster>,
    hedge: Option<f64>,
    _listening: Arc<[Subscriber<()>; 2]>,
}

impl Fleet {
    /// Connects to routers or servers, such as `tcp/router:7447`, as a Zenoh client.
    ///
    /// # Errors
    /// [`ClientError::BadUrl`] if an endpoint is none, [`ClientError::Unreachable`] if none of them answers.
    pub async fn connect(endpoints: &[&str]) -> Result<Self, ClientError> {
        let url = endpoints.join(",");
        let bad = |why: String| ClientError::BadUrl {
            url: url.clone(),
            why,
        };
        let config = serde_json::json!({
            "mode": "client",
            "connect": { "endpoints": endpoints },
            "scouting": { "multicast": { "enabled": false } },
            // Pieces of large messages that may wait for the link: with Zenoh's own 2, sender and link take turns.
            "transport": { "link": { "tx": { "queue": { "size": { "data": 16 } } } },
            // Queries over implicit shared memory can be lost under load.
            "shared_memory": { "transport_optimization": { "messages": ["put"] } } },
        });
        let config = zenoh::Config::from_json5(&config.to_string()).map_err(|why| bad(why.to_string()))?;
        Self::open(url, config).await
    }

    /// As [`connect`](Self::connect), with TLS, passwords and whatever else stands in a file of Zenoh's own configuration (JSON5); the
    /// endpoints win over its own.
    ///
    /// # Errors
    /// As [`connect`](Self::connect), and [`ClientError::BadAccess`] if Zenoh does not take the file.
    pub async fn connect_with(endpoints: &[&str], config: &Path) -> Result<Self, ClientError> {
        let bad = |why: zenoh::Error| ClientError::BadAccess {
            what: "configuration of Zenoh",
            why: format!(
                "{}: see Zenoh's own documentation",
                without_place(&why.to_string())
            ),
        };
        let endpoints_json = serde_json::json!(endpoints).to_string();
        let mut config = zenoh::Config::from_file(config).map_err(bad)?;
        config
            .insert_json5("mode", "\"client\"")
            .and_then(|()| config.insert_json5("connect/endpoints", &endpoints_json))
            .map_err(bad)?;
        Self::open(endpoints.join(","), config).await
    }

    async fn open(url: String, config: zenoh::Config) -> Result<Self, ClientError> {
        let session = zenoh::open(config)
            .await
            .map_err(|why| ClientError::Unreachable {
                url,
                why: without_place(&why.to_string()),
            })?;
        Self::over(session).await
    }

    /// Uses a session that there is already. Closing it is left to whoever opened it.
    ///
    /// # Errors
    /// [`ClientError::Network`] if it is closed.
    pub async fn over(session: Session) -> Result<Self, ClientError> {
        let (roster, listening) = Roster::follow(&session).await?;
        Ok(Self {
            session,
            roster,
            hedge: None,
            _listening: Arc::new(listening),
        })
    }

    /// Sends a request to a second server when the first has not answered after `share` of the budget, 0 to 1. Whichever answers first
    /// counts. Costs work twice; worth it where a lost deadline costs more.
    #[must_use]
    pub fn with_hedging(mut self, share: f64) -> Self {
        self.hedge = Some(share.clamp(0.0, 1.0));
        self
    }

    /// The servers that are there, as they last told about themselves.
    #[must_use]
    pub fn servers(&self) -> Vec<ServerLoad> {
        self.roster.servers()
    }

    /// Waits until a server is there that has told its load, as each does five times a second: the loads of all, none after `timeout`.
    /// Just after [`connect`](Self::connect), nothing may have come yet.
    pub async fn look(&self, timeout: Duration) -> Vec<ServerLoad> {
        let until = Instant::now() + timeout;
        loop {
            let servers = self.servers();
            // One that has no workers has not told its load.
            let all_told = !servers.is_empty() && servers.iter().all(|server| server.workers > 0);
            if all_told || Instant::now() >= until {
                return servers;
            }
            tokio::time::sleep(LOOK_AGAIN).await;
        }
    }

    /// Asks the network which cameras are there, and who serves each.
    ///
    /// # Errors
    /// [`ClientError::Network`] if the session is closed.
    pub async fn cameras(&self) -> Result<Vec<CameraPresence>, ClientError> {
        presence::cameras(&self.session).await
    }

    /// The session, for whatever this client doesn't do.
    #[must_use]
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// Matches one pair at whichever server has room. What another server may do better is tried there, as long as the budget lasts.
    ///
    /// # Errors
    /// [`ClientError::Refused`] with the last server's status, [`ClientError::Unavailable`] if none answered in time.
    pub async fn match_pair(&self, request: &StereoRequest) -> Result<StereoResult, ClientError> {
        let started = Instant::now();
        let options = request.options.as_ref();
        let budget = options
            .and_then(|options| options.latency_budget)
            .and_then(|budget| budget.try_into().ok())
            .unwrap_or(DEFAULT_BUDGET);
        let deadline = started + budget;
        let payload = ZBytes::from(request.encode_to_vec());
        let mut hedge_at = self.hedge.map(|share| started + budget.mul_f64(share));
        let mut tried: Vec<String> = Vec::new();
        let mut running = FuturesUnordered::new();
        // What they wait for: the server, and when it was asked.
        let mut waiting: Vec<(String, Instant)> = Vec::new();
        let mut again_at = started;
        let mut last = ClientError::Unavailable {
            waited: budget,
            why: "no server is there".to_owned(),
        };
        loop {
            let now = Instant::now();
            let left = deadline.saturating_duration_since(now);
            // Where the router goes at the wrong moment, Zenoh may go on waiting for an answer that will not come.
            let needs_one = waiting
                .iter()
                .all(|(server, asked_at)| self.roster.may_have_lost(server, *asked_at));
            if needs_one && !tried.is_empty() && !self.roster.has_other(&tried) {
                if waiting.is_empty() && matches!(last, ClientError::Refused(_)) {
                    return Err(last);
                }
                // Whoever comes back gets another chance, in a moment.
                tried.clear();
                again_at = now + LOOK_AGAIN;
            }
            let is_hedge_due = hedge_at.is_some_and(|at| at <= now);
            let is_due = is_hedge_due || needs_one && again_at <= now;
            if is_due
                && !left.is_zero()
                && waiting.len() < MOST_ASKED
                && let Some(server) = self.roster.choose(&tried, left)
            {
                if !needs_one {
                    hedge_at = None;
                }
                let asked = (server.clone(), Instant::now());
                tried.push(server.clone());
                waiting.push(asked.clone());
                let answer = self.ask(server, payload.clone(), left);
                running.push(async { (asked, answer.await) });
            }
            if waiting.is_empty() && left.is_zero() {
                return Err(last);
            }
            let look_at = match needs_one {
                true => now + LOOK_AGAIN,
                false => now + STILL_THERE,
            };
            let wake = match waiting.is_empty() {
                true => look_at.min(deadline),
                false => [hedge_at, Some(look_at)]
                    .into_iter()
                    .flatten()
                    .filter(|&at| at > now && at < deadline)
                    .min()
                    .unwrap_or(deadline + GRACE),
            };
            tokio::select! {
                Some((asked, outcome)) = running.next() => {
                    waiting.retain(|other| *other != asked);
                    match outcome {
                        Ok(result) => return Ok(result),
                        Err(error) if is_worth_another(&error) => last = error,
                        Err(error) => return Err(error),
                    }
                }
                () = tokio::time::sleep_until(wake.into()) => {
                    if Instant::now() >= deadline + GRACE {
                        return Err(last);
                    }
                }
            }
        }
    }

    /// Asks one server.
    async fn ask(
        &self,
        server: String,
        payload: ZBytes,
        left: Duration,
    ) -> Result<StereoResult, ClientError> {
        let selector = format!(
            "stereo/v1/compute/{server}?budget_ms={}",
            left.as_secs_f64() * 1e3
        );
        let replies = self
            .session
            .get(selector)
            .payload(payload)
            .encoding(Encoding::from(REQUEST))
            // Not held back to be sent together with others.
            .express(true)
            // One server answers, once: a reply needn't wait for what might come after it.
            .consolidation(ConsolidationMode::None)
            .timeout(left + GRACE)
            .await
            .map_err(|why| ClientError::Network(why.to_string()))?;
        // No server, a dead one and a forbidden one all look the same.
        let reply = replies.recv_async().await.map_err(|_| ClientError::Unavailable {
            waited: left,
            why: format!("{server} did not answer"),
        })?;
        match reply.into_result() {
            Ok(sample) => {
                // Copied: shared memory that a client holds when it is killed never comes back to the server.
                let mut result = StereoResult::decode(&*sample.payload().to_bytes())
                    .map_err(|why| ClientError::Malformed(why.to_string()))?;
                decompress(&mut result)?;
                Ok(result)
            }
            Err(error) => match Status::decode(&*error.payload().to_bytes()) {
                Ok(status) if status.reason != 0 => Err(ClientError::Refused(status)),
                // Zenoh's own, such as "Timeout".
                _ => Err(ClientError::Unavailable {
                    waited: left,
                    why: format!("{server} did not answer in time"),
                }),
            },
        }
    }

    /// A camera of this name: servers know that it is there as long as it is kept.
    ///
    /// # Errors
    /// [`ClientError::Network`] if the session is closed or the name can't be part of a key.
    pub async fn camera(&self, name: &str) -> Result<Camera, ClientError> {
        Camera::declare(&self.session, name).await
    }

    /// The results of a camera, the newest first: whoever reads too slowly misses some.
    ///
    /// # Errors
    /// As [`camera`](Self::camera).
    pub async fn results(&self, camera: &str) -> Result<Results, ClientError> {
        Results::subscribe(&self.session, camera).await
    }
}

/// Whether another server might do better.
fn is_worth_another(error: &ClientError) -> bool {
    match error {
        ClientError::Unavailable { .. } => true,
        ClientError::Refused(status) => matches!(
            status.reason(),
            Reason::QueueFull
                | Reason::Draining
                | Reason::DeadlineInfeasible
                | Reason::Expired
                | Reason::Quota
                | Reason::Internal
        ),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_another_server_may_do_better_is_tried_again() {
        let refused = |reason: Reason| {
            ClientError::Refused(Status {
                reason: reason.into(),
                ..Status::default()
            })
        };
        for reason in [Reason::Draining, Reason::QueueFull, Reason::DeadlineInfeasible] {
            assert!(is_worth_another(&refused(reason)), "{reason:?}");
        }
        for reason in [Reason::Invalid, Reason::TooLarge, Reason::Forbidden] {
            assert!(!is_worth_another(&refused(reason)), "{reason:?}");
        }
        assert!(!is_worth_another(&ClientError::Malformed("x".to_owned())));
    }
}
