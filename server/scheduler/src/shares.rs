//! Who may use how much: a token bucket for each client, filled at its share of the workers.
//!
//! The share of a client is its weight among the clients that were active within the last second. What a client asks for within
//! its share is promised like anything else; what goes beyond is let in only where it leaves room for the others' shares.

use std::collections::{BTreeSet, HashMap};
use std::time::Duration;

use crate::spec::ClientId;

/// A client that was silent for this long has no share, and the others have more.
const ACTIVE: Duration = Duration::from_secs(1);
/// A client may use this much of its share at once.
const BURST_S: f64 = 0.25;
/// It may in any case send this many jobs at once.
const BURST_JOBS: f64 = 4.0;

#[derive(Debug)]
struct Client {
    weight: u64,
    is_active: bool,
    /// When anything of it came last.
    seen_at: Duration,
    /// When it asked for a job with a deadline last.
    asked_at: Duration,
    /// Worker-seconds it may use; more than any bucket holds until it has asked once.
    tokens: f64,
    waiting: usize,
    /// Virtual time up to which its background work was served.
    background_tag: Duration,
}

/// What a client may do now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Allowance {
    /// The job is within its share.
    pub(crate) is_within: bool,
    /// Its share of everything, 0..=1.
    pub(crate) share: f64,
    /// How long until a job like this would be within the share.
    pub(crate) within_s: f64,
}

/// The clients, at most `capacity` of them.
#[derive(Debug)]
pub(crate) struct Shares {
    clients: HashMap<ClientId, Client>,
    /// All of them, the one that is silent for longest first.
    by_silence: BTreeSet<(Duration, ClientId)>,
    active: BTreeSet<(Duration, ClientId)>,
    active_weight: u64,
    capacity: usize,
    workers: f64,
}

impl Shares {
    pub(crate) fn new(capacity: usize, workers: f64) -> Self {
        Self {
            clients: HashMap::new(),
            by_silence: BTreeSet::new(),
            active: BTreeSet::new(),
            active_weight: 0,
            capacity: capacity.max(1),
            workers,
        }
    }

    /// `client` asks for a job that takes `cost_s` of a worker.
    pub(crate) fn ask(&mut self, now: Duration, client: ClientId, weight: u32, cost_s: f64) -> Allowance {
        self.retire(now);
        self.refill(now, client, weight, cost_s);
        let (share, rate) = self.rate(client);
        let is_alone = self.active.len() == 1;
        let tokens = self.clients.get(&client).map_or(0.0, |known| known.tokens);
        let missing = (cost_s - tokens).max(0.0);
        Allowance {
            is_within: is_alone || missing <= 0.0,
            share,
            within_s: missing / rate,
        }
    }

    /// A job of `client` is admitted; `charged_s` is what it uses of the share.
    pub(crate) fn admit(&mut self, client: ClientId, charged_s: f64) {
        if let Some(known) = self.clients.get_mut(&client) {
            known.tokens -= charged_s;
            known.waiting += 1;
        }
    }

    /// A waiting job of `client` has left the queue; `returned_s` of its share was not used after all.
    pub(crate) fn leave(&mut self, client: ClientId, returned_s: f64) {
        if let Some(known) = self.clients.get_mut(&client) {
            known.tokens += returned_s;
            known.waiting = known.waiting.saturating_sub(1);
        }
    }

    /// `returned_s` of the share of `client` was not used after all.
    pub(crate) fn refund(&mut self, client: ClientId, returned_s: f64) {
        if let Some(known) = self.clients.get_mut(&client) {
            known.tokens += returned_s;
        }
    }

    /// How many jobs of `client` wait.
    pub(crate) fn waiting(&self, client: ClientId) -> usize {
        self.clients.get(&client).map_or(0, |known| known.waiting)
    }

    /// Start tag of the client's next background job, which takes `cost`, when the service is at `virtual_now` (start-time fair
    /// queueing; Goyal 1996).
    pub(crate) fn background_tag(
        &mut self,
        now: Duration,
        client: ClientId,
        weight: u32,
        cost: Duration,
        virtual_now: Duration,
    ) -> Duration {
        self.touch(now, client, weight);
        let Some(known) = self.clients.get_mut(&client) else {
            return virtual_now;
        };
        let start = known.background_tag.max(virtual_now);
        known.background_tag = start + cost / weight.max(1);
        start
    }

    pub(crate) fn active(&mut self, now: Duration) -> usize {
        self.retire(now);
        self.active.len()
    }

    /// The client's share of everything, and what it may use by the second.
    fn rate(&self, client: ClientId) -> (f64, f64) {
        let weight = self.clients.get(&client).map_or(1, |known| known.weight);
        #[expect(clippy::cast_precision_loss, reason = "weights are 32-bit numbers, and few")]
        let share = weight as f64 / self.active_weight.max(weight) as f64;
        (share, share * self.workers)
    }

    /// Takes their share from clients that have been silent.
    fn retire(&mut self, now: Duration) {
        while let Some(&(asked_at, client)) = self.active.first()
            && now.saturating_sub(asked_at) > ACTIVE
        {
            self.active.pop_first();
            if let Some(known) = self.clients.get_mut(&client) {
                known.is_active = false;
                self.active_weight -= known.weight;
            }
        }
    }

    /// Notes that `client` is active, and fills its bucket.
    fn refill(&mut self, now: Duration, client: ClientId, weight: u32, cost_s: f64) {
        self.touch(now, client, weight);
        let weight = u64::from(weight.max(1));
        let Some(known) = self.clients.get_mut(&client) else {
            return;
        };
        if known.is_active {
            self.active_weight -= known.weight;
            self.active.remove(&(known.asked_at, client));
        }
        let silent_for = now.saturating_sub(known.asked_at);
        known.is_active = true;
        known.weight = weight;
        known.asked_at = known.asked_at.max(now);
        self.active_weight += weight;
        self.active.insert((known.asked_at, client));

        let (_, rate) = self.rate(client);
        if let Some(known) = self.clients.get_mut(&client) {
            let full = (rate * BURST_S).max(BURST_JOBS * cost_s);
            known.tokens = (known.tokens + rate * silent_for.as_secs_f64()).min(full);
        }
    }

    /// Finds or makes the entry of `client`; if there is no room, the one that is silent for longest is forgotten.
    fn touch(&mut self, now: Duration, client: ClientId, weight: u32) {
        if let Some(known) = self.clients.get_mut(&client) {
            self.by_silence.remove(&(known.seen_at, client));
            known.seen_at = known.seen_at.max(now);
            self.by_silence.insert((known.seen_at, client));
            return;
        }
        if self.clients.len() >= self.capacity
            && let Some((_, silent)) = self.by_silence.pop_first()
            && let Some(known) = self.clients.remove(&silent)
            && known.is_active
        {
            self.active.remove(&(known.asked_at, silent));
            self.active_weight -= known.weight;
        }
        self.by_silence.insert((now, client));
        self.clients.insert(
            client,
            Client {
                weight: u64::from(weight.max(1)),
                is_active: false,
                seen_at: now,
                asked_at: now,
                tokens: f64::INFINITY,
                waiting: 0,
                background_tag: Duration::ZERO,
            },
        );
    }
}
