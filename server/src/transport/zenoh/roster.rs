//! Which servers and cameras are there, and which server a camera belongs to.
//!
//! A camera is served by exactly one server: of all live ones, the one with the largest hash of camera and server (rendezvous
//! hashing), which every server works out for itself, and which moves as few cameras as possible when a server comes or goes. A
//! frozen server keeps its liveliness token for a while, so one that has not told its load lately doesn't count either.
//!
//! A token's end and its next beginning may come by two ways and in the wrong order, and one of them may be lost. So a server that
//! tells its load is there whatever was heard of its token, and cameras are corrected now and then by what the network says of all.

use std::collections::{BTreeSet, HashMap};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::Notify;
use zenoh::sample::{Sample, SampleKind};

use super::keys;

/// A server that has not told its load for so long is frozen or cut off.
pub(super) const SILENCE: Duration = Duration::from_secs(2);
/// Names of cameras and servers that are remembered at one time.
const MOST_NAMES: usize = 4096;

/// Who is there, as callbacks have heard it.
pub(super) struct Roster {
    /// Cameras that are there whether or not they announce themselves.
    configured: BTreeSet<String>,
    state: Mutex<State>,
    pub(super) changed: Notify,
}

#[derive(Default)]
struct State {
    cameras: BTreeSet<String>,
    /// When each server was last heard.
    servers: HashMap<String, Instant>,
}

impl Roster {
    pub(super) fn new(configured: BTreeSet<String>) -> Self {
        let state = State {
            cameras: configured.clone(),
            ..State::default()
        };
        Self {
            configured,
            state: Mutex::new(state),
            changed: Notify::new(),
        }
    }

    /// A camera's token has come or gone.
    pub(super) fn camera(&self, sample: &Sample) {
        let Some(name) = keys::name(sample.key_expr().as_str()) else {
            return;
        };
        if self.configured.contains(name) {
            return;
        }
        let mut state = self.lock();
        match sample.kind() {
            SampleKind::Put if state.cameras.len() < MOST_NAMES => state.cameras.insert(name.to_owned()),
            SampleKind::Put => false,
            SampleKind::Delete => state.cameras.remove(name),
        };
        drop(state);
        self.changed.notify_one();
    }

    /// A server's token has come or gone.
    pub(super) fn server(&self, sample: &Sample) {
        let Some(name) = keys::name(sample.key_expr().as_str()) else {
            return;
        };
        let mut state = self.lock();
        match sample.kind() {
            SampleKind::Put => drop(state.heard(name, Instant::now())),
            SampleKind::Delete => drop(state.servers.remove(name)),
        }
        drop(state);
        self.changed.notify_one();
    }

    /// A server has told its load.
    pub(super) fn heard(&self, sample: &Sample) {
        if let Some(name) = keys::name(sample.key_expr().as_str())
            && self.lock().heard(name, Instant::now())
        {
            self.changed.notify_one();
        }
    }

    /// The cameras that are there are `present`, says the network; one that is `missing` already and still is goes.
    pub(super) fn correct(&self, present: &BTreeSet<String>, missing: &mut BTreeSet<String>) {
        if self.lock().correct(present, &self.configured, missing) {
            self.changed.notify_one();
        }
    }

    /// This server was frozen itself: nobody else could be heard, and nobody is blamed for it.
    pub(super) fn excuse_all(&self, now: Instant) {
        for last in self.lock().servers.values_mut() {
            *last = now;
        }
    }

    /// Whether `own` is the server of a camera.
    pub(super) fn is_owner(&self, own: &str, camera: &str) -> bool {
        self.with_live(own, Instant::now(), |_, servers| {
            owner(camera, servers) == Some(own)
        })
    }

    /// Looks at the cameras and the live servers.
    pub(super) fn with_live<T>(
        &self,
        own: &str,
        now: Instant,
        look: impl FnOnce(&BTreeSet<String>, &BTreeSet<&str>) -> T,
    ) -> T {
        let state = self.lock();
        look(&state.cameras, &state.live(own, now))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Nothing that is called while it is held panics.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// The servers that count: this one, and those heard lately.
    fn live<'a>(&'a self, own: &'a str, now: Instant) -> BTreeSet<&'a str> {
        let heard = self
            .servers
            .iter()
            .filter(|(_, last)| now.saturating_duration_since(**last) < SILENCE)
            .map(|(name, _)| name.as_str());
        heard.chain([own]).collect()
    }

    /// A server is there; whether that is news.
    fn heard(&mut self, name: &str, now: Instant) -> bool {
        if let Some(last) = self.servers.get_mut(name) {
            let is_news = now.saturating_duration_since(*last) >= SILENCE;
            *last = now;
            return is_news;
        }
        if self.servers.len() >= MOST_NAMES {
            self.servers
                .retain(|_, last| now.saturating_duration_since(*last) < SILENCE);
        }
        let has_room = self.servers.len() < MOST_NAMES;
        if has_room {
            self.servers.insert(name.to_owned(), now);
        }
        has_room
    }

    /// Adds the cameras that are `present`, takes away those that were `missing` before and still are; whether that changes anything.
    fn correct(
        &mut self,
        present: &BTreeSet<String>,
        configured: &BTreeSet<String>,
        missing: &mut BTreeSet<String>,
    ) -> bool {
        let room = MOST_NAMES.saturating_sub(self.cameras.len());
        let added: Vec<String> = present.difference(&self.cameras).take(room).cloned().collect();
        let absent: BTreeSet<String> = self
            .cameras
            .iter()
            .filter(|&camera| !present.contains(camera) && !configured.contains(camera))
            .cloned()
            .collect();
        // Word of one that has just come may be on its way here and not yet there: once is not enough.
        let removed = absent
            .intersection(missing)
            .filter(|&camera| self.cameras.remove(camera))
            .count();
        let is_changed = !added.is_empty() || removed > 0;
        self.cameras.extend(added);
        *missing = absent;
        is_changed
    }
}

/// The server of a camera.
pub(super) fn owner<'a>(camera: &str, servers: &BTreeSet<&'a str>) -> Option<&'a str> {
    servers
        .iter()
        .copied()
        .max_by_key(|server| (weight(camera, server), *server))
}

/// A hash that is the same in every build: FNV-1a, and a mixer so that short names spread.
fn weight(camera: &str, server: &str) -> u64 {
    let mut hash: u64 = 0xcbf2_9ce4_8422_2325;
    for byte in camera.bytes().chain([0]).chain(server.bytes()) {
        hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    }
    hash ^= hash >> 30;
    hash = hash.wrapping_mul(0xbf58_476d_1ce4_e5b9);
    hash ^= hash >> 27;
    hash = hash.wrapping_mul(0x94d0_49bb_1331_11eb);
    hash ^ (hash >> 31)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    const SERVERS: [&str; 4] = ["a", "b", "stereod-3", "robot_base.local"];

    #[test]
    fn cameras_spread_over_the_servers() {
        let servers: BTreeSet<&str> = SERVERS.into_iter().collect();
        let mut counts = BTreeMap::new();
        for camera in 0..4000 {
            *counts
                .entry(owner(&format!("cam{camera}"), &servers).unwrap())
                .or_insert(0) += 1;
        }
        assert!(
            counts.values().all(|count| (850..1150).contains(count)),
            "{counts:?}"
        );
    }

    #[test]
    fn only_the_cameras_of_a_server_that_goes_move() {
        let all: BTreeSet<&str> = SERVERS.into_iter().collect();
        let mut fewer = all.clone();
        fewer.remove("b");
        for camera in 0..1000 {
            let camera = format!("cam{camera}");
            let before = owner(&camera, &all).unwrap();
            let after = owner(&camera, &fewer).unwrap();
            assert!(
                before == after || before == "b",
                "{camera} moved from {before} to {after}"
            );
        }
    }

    #[test]
    fn the_hash_is_the_same_in_every_build() {
        assert_eq!(weight("front", "stereod"), 0xb0f3_82ac_00af_6b41);
        assert_ne!(weight("ab", "c"), weight("a", "bc"));
    }

    #[test]
    fn a_silent_server_does_not_count_and_this_one_always_does() {
        let now = Instant::now();
        let mut state = State::default();
        state.servers.insert("fresh".to_owned(), now);
        state.servers.insert("frozen".to_owned(), now);
        let later = now + SILENCE;
        assert_eq!(state.live("own", now).len(), 3);
        state.servers.insert("fresh".to_owned(), later);
        assert_eq!(
            state.live("own", later).into_iter().collect::<Vec<_>>(),
            ["fresh", "own"]
        );
        assert_eq!(owner("any", &BTreeSet::new()), None);
    }
    #[test]
    fn a_server_that_tells_its_load_is_there_after_its_token_went() {
        let (mut state, now) = (State::default(), Instant::now());
        assert!(state.heard("back", now));
        assert!(!state.heard("back", now), "that is not news");
        assert!(state.heard("back", now + SILENCE), "it was silent");
        state.servers.remove("back");
        assert!(state.heard("back", now));
        assert_eq!(state.live("own", now).len(), 2);
        for number in 0..2 * MOST_NAMES {
            state.heard(&number.to_string(), now);
        }
        assert_eq!(state.servers.len(), MOST_NAMES);
        assert!(
            state.heard("new", now + SILENCE),
            "those that were heard long ago make room"
        );
    }

    #[test]
    fn cameras_are_corrected_by_what_the_network_says() {
        let set = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect::<BTreeSet<_>>();
        let (mut state, mut missing) = (State::default(), BTreeSet::new());
        let configured = set(&["fixed"]);
        state.cameras = set(&["fixed", "gone", "late"]);
        assert!(state.correct(&set(&["lost"]), &configured, &mut missing));
        assert_eq!(
            state.cameras,
            set(&["fixed", "gone", "late", "lost"]),
            "one that is missing gets a second chance"
        );
        assert!(state.correct(&set(&["late", "lost"]), &configured, &mut missing));
        assert_eq!(state.cameras, set(&["fixed", "late", "lost"]));
        assert!(!state.correct(&set(&["late", "lost"]), &configured, &mut missing));
        let many = (0..2 * MOST_NAMES).map(|number| number.to_string()).collect();
        state.correct(&many, &configured, &mut missing);
        assert_eq!(state.cameras.len(), MOST_NAMES);
    }
}
