//! The state machine.

use std::collections::{BTreeMap, HashMap};
use std::time::Duration;

use crate::answer::{Cancelled, DropReason, Dropped, Snapshot};
use crate::cost::{Cost, CostModel};
use crate::ladder::{Ladder, Level};
use crate::nanos::{duration, nanos};
use crate::rate::Rate;
use crate::running::{RUNGS, Running, StageCosts};
use crate::shares::Shares;
use crate::spec::{
    ClientId, Config, JobSpec, Kind, Policy, Priority, Stage, StreamId, Ticket, Urgency, Work,
};
use crate::timeline::Timeline;

mod admit;
mod aside;
mod background;
mod feasible;
mod places;
mod run;

/// Everything about time in one place: who may wait, who is served next, and how much of a job is done.
///
/// The life of a job:
/// ```text
/// submit --> waits --> next --> decoded --> rung_done (base) --> [step_done ..] rung_done .. --> meshed --> finished
///    |         |                               Verdict: Continue, Finish, Yield, Abandon
///  refused   expire, cancel, or dropped by a later submit                    failed: from any point on
/// ```
/// `now` never goes back. Every method costs O(log n) of the jobs that wait, plus the number of workers.
#[derive(Debug)]
pub struct Scheduler<K, J> {
    config: Config,
    /// Jobs with a deadline: those that wait, and those that lie aside and still need their ending.
    timeline: Timeline<Item<K, J>>,
    background: BTreeMap<Ticket, Waiting<K, J>>,
    /// Virtual time of the background class.
    background_now: Duration,
    running: Vec<Option<Running<K>>>,
    /// Background jobs that were put aside, by worker.
    parked: Vec<Option<Running<K>>>,
    /// Jobs with a deadline that were put aside for others, by worker.
    preempted: Vec<Vec<Running<K>>>,
    costs: CostModel<K>,
    shares: Shares,
    ladder: Ladder,
    /// Promised work within its client's share, and that of the high class, in shares of all workers.
    within_share: Rate,
    high: Rate,
    tightest: background::Tightest,
    /// The waiting job of each stream.
    streams: HashMap<StreamId, Ticket>,
    /// Waiting jobs without a promise.
    best_effort: BTreeMap<Ticket, ()>,
    /// Jobs found hopeless by [`next`](Self::next), until [`expire`](Self::expire) hands them out.
    limbo: Vec<Dropped<J>>,
    arrivals: u64,
    now: Duration,
}

/// A job with a deadline that no worker is at.
#[derive(Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "nearly all of them wait, and a box would be an allocation for each"
)]
enum Item<K, J> {
    Waiting(Waiting<K, J>),
    /// It lies aside at this worker.
    Aside(usize),
}

#[derive(Debug)]
struct Waiting<K, J> {
    spec: JobSpec<K>,
    /// What it was admitted with.
    variant: Variant<K>,
    /// Worker-seconds taken from its client's share.
    charged_s: f64,
    /// It is run to learn what it costs now, whether or not it will be in time.
    is_probe: bool,
    job: J,
}

/// One way to do a job.
#[derive(Debug, Clone, Copy)]
struct Variant<K> {
    work: Work<K>,
    is_half: bool,
    has_mesh: bool,
    costs: StageCosts,
}

impl<K: Kind, J> Scheduler<K, J> {
    /// Idle and empty, and knows no costs.
    #[must_use]
    pub fn new(mut config: Config) -> Self {
        config.workers = config.workers.max(1);
        Self {
            config,
            timeline: Timeline::new(),
            background: BTreeMap::new(),
            background_now: Duration::ZERO,
            running: std::iter::repeat_with(|| None).take(config.workers).collect(),
            parked: std::iter::repeat_with(|| None).take(config.workers).collect(),
            preempted: std::iter::repeat_with(Vec::new).take(config.workers).collect(),
            costs: CostModel::new(config.max_costs),
            #[expect(clippy::cast_precision_loss, reason = "nobody has 2^52 workers")]
            shares: Shares::new(config.max_clients, config.workers as f64),
            ladder: Ladder::default(),
            within_share: Rate::default(),
            high: Rate::default(),
            tightest: background::Tightest::default(),
            streams: HashMap::new(),
            best_effort: BTreeMap::new(),
            limbo: Vec::new(),
            arrivals: 0,
            now: Duration::ZERO,
        }
    }

    /// Takes a job back: out of the queue at once, from its worker after the present step.
    pub fn cancel(&mut self, now: Duration, ticket: Ticket) -> Cancelled<J> {
        self.see(now);
        if let Some(waiting) = self.take(ticket, true) {
            return Cancelled::Waiting(waiting.job);
        }
        match self.begun().find(|running| running.ticket == ticket) {
            Some(running) => {
                running.is_cancelled = true;
                Cancelled::Running
            }
            None => Cancelled::Gone,
        }
    }

    /// Takes out the jobs whose deadline has passed or can't be met any more, whether or not a worker is free.
    pub fn expire(&mut self, now: Duration) -> Vec<Dropped<J>> {
        self.see(now);
        self.sweep(now);
        std::mem::take(&mut self.limbo)
    }

    /// When to call [`expire`](Self::expire), and then [`next`](Self::next) for the workers that are idle, if nothing else happens
    /// before; `None` while nobody waits.
    #[must_use]
    pub fn next_wakeup(&self) -> Option<Duration> {
        if !self.limbo.is_empty() {
            return Some(self.now);
        }
        let last_start = self
            .timeline
            .earliest_last_start()
            .filter(|_| self.config.policy != Policy::Fifo);
        let expiry = last_start.map(|last| duration(last + 1));
        // Whether a background job may start depends on what came lately, and so on time.
        let is_idle = !self.background.is_empty() && self.running.iter().any(Option::is_none);
        let retry = is_idle.then(|| self.now + background::RETRY);
        expiry.into_iter().chain(retry).min()
    }

    /// A stage took `took` for a dummy. It counts until the first job of its kind has been measured, by the calls about it.
    pub fn prime(&mut self, kind: K, stage: Stage, units: u32, took: Duration) {
        self.costs.prime(self.now, kind, stage, units, took);
    }

    /// What stages have cost so far.
    #[must_use]
    pub fn costs(&self) -> &CostModel<K> {
        &self.costs
    }

    /// The state, for metrics.
    pub fn snapshot(&mut self, now: Duration) -> Snapshot {
        self.see(now);
        let level = self.ladder.level(now);
        Snapshot {
            waiting: self.waiting(),
            background_waiting: self.background.len() + self.parked.iter().flatten().count(),
            busy_workers: self.running.iter().flatten().count(),
            level,
            mandatory_load: self.ladder.load(now, Level::FewerRungs),
            full_load: self.ladder.load(now, Level::Full),
            backlog: duration(self.timeline.total()) + self.bound_share(now, None),
            active_clients: self.shares.active(now),
        }
    }

    fn see(&mut self, now: Duration) {
        self.now = self.now.max(now);
    }

    fn is_edf(&self) -> bool {
        self.config.policy == Policy::Edf
    }

    fn workers(&self) -> u32 {
        u32::try_from(self.running.len()).unwrap_or(u32::MAX)
    }

    /// Jobs that were started: at work or aside.
    fn begun(&mut self) -> impl Iterator<Item = &mut Running<K>> {
        let aside = self.preempted.iter_mut().flatten();
        self.running
            .iter_mut()
            .chain(&mut self.parked)
            .flatten()
            .chain(aside)
    }

    /// How many jobs with a deadline have not been started.
    fn waiting(&self) -> usize {
        self.timeline.len() - self.preempted.iter().map(Vec::len).sum::<usize>()
    }

    /// Moves jobs that can't be in time any more out of the queue.
    fn sweep(&mut self, now: Duration) {
        if matches!(self.config.policy, Policy::Fifo) {
            return;
        }
        while let Some(ticket) = self.timeline.hopeless(now)
            && let Some(waiting) = self.take(ticket, true)
        {
            self.limbo.push(Dropped {
                ticket,
                job: waiting.job,
                reason: DropReason::Expired,
            });
        }
    }

    /// Takes a job out of the queue, wherever in it; `is_unserved` returns what it used of its client's share.
    fn take(&mut self, ticket: Ticket, is_unserved: bool) -> Option<Waiting<K, J>> {
        let waiting = self.remove(ticket);
        if let Some(waiting) = &waiting {
            let returned = if is_unserved { waiting.charged_s } else { 0.0 };
            self.shares.leave(waiting.spec.client, returned);
            self.best_effort.remove(&ticket);
        }
        let waiting = waiting.or_else(|| self.background.remove(&ticket))?;
        if let Some(stream) = waiting.spec.stream
            && self.streams.get(&stream) == Some(&ticket)
        {
            self.streams.remove(&stream);
        }
        Some(waiting)
    }

    /// Takes a job out of the timeline that has not been started.
    fn remove(&mut self, ticket: Ticket) -> Option<Waiting<K, J>> {
        if let Some(Item::Aside(_)) = self.timeline.get(ticket) {
            return None;
        }
        match self.timeline.remove(ticket) {
            Some(Item::Waiting(waiting)) => Some(waiting),
            Some(Item::Aside(_)) | None => None,
        }
    }

    /// Time until the workers that are busy are free, if none starts anything else, by the worker; `but` is not counted.
    fn bound_share(&self, now: Duration, but: Option<usize>) -> Duration {
        let bound = |(index, running): (usize, &Option<Running<K>>)| {
            let counts = Some(index) != but;
            running
                .as_ref()
                .filter(|_| counts)
                .map(|running| running.bound_for(now))
        };
        let total: Duration = self.running.iter().enumerate().filter_map(bound).sum();
        total / self.workers()
    }

    /// The least slack of any waiting job at `headroom`, if the busy workers are bound for `bound` on the average.
    fn least_slack(&self, now: Duration, headroom: usize, bound: Duration) -> i64 {
        let now = crate::timeline::at_headroom(nanos(now), headroom);
        self.timeline.least()[headroom].saturating_sub(now + nanos(bound))
    }

    /// What the reply takes after everything else.
    fn reply(&self, now: Duration, work: &Work<K>) -> Cost {
        self.costs.cost(now, work.encode, Stage::Reply, work.units)
    }

    /// What the stages of `work` cost, as known `now`.
    fn stage_costs(&self, now: Duration, work: &Work<K>, has_mesh: bool) -> StageCosts {
        let cost = |kind, stage| self.costs.cost(now, kind, stage, work.units);
        let mesh = work.mesh.filter(|_| has_mesh);
        let mut costs = StageCosts {
            decode: cost(work.decode, Stage::Decode),
            step: cost(work.matching, Stage::Step),
            ..StageCosts::default()
        };
        for (rung, at) in (0..work.rungs.max(1)).zip(0..RUNGS) {
            costs.rungs[at] = cost(work.matching, Stage::Rung(rung));
            costs.encode[at] = cost(work.encode, Stage::Encode(rung));
            costs.mesh[at] = mesh.map_or_else(Default::default, |kind| cost(kind, Stage::Mesh(rung)));
        }
        costs
    }

    /// The ways to do a job, the best first, from what the ladder's level allows down to the cheapest the client allows.
    fn variants(&self, now: Duration, spec: &JobSpec<K>, level: Level) -> Variants<K> {
        let sizes = [Some(spec.work), spec.half];
        let mut ways = Variants {
            ways: [None; 4],
            len: 0,
        };
        let only_half = spec.half.is_some() && level >= Level::HalfResolution;
        let no_mesh = spec.is_mesh_optional && level >= Level::NoMesh;
        for (has_mesh, is_half) in [(true, false), (true, true), (false, false), (false, true)] {
            let Some(work) = sizes[usize::from(is_half)] else {
                continue;
            };
            let is_allowed = (has_mesh || spec.is_mesh_optional && work.mesh.is_some())
                && (is_half || !only_half)
                && (!has_mesh || !no_mesh || work.mesh.is_none());
            if is_allowed {
                let has_mesh = has_mesh && work.mesh.is_some();
                let costs = self.stage_costs(now, &work, has_mesh);
                ways.ways[ways.len] = Some(Variant {
                    work,
                    is_half,
                    has_mesh,
                    costs,
                });
                ways.len += 1;
            }
        }
        ways
    }
}

/// One to four [`Variant`]s.
struct Variants<K> {
    ways: [Option<Variant<K>>; 4],
    len: usize,
}

impl<K> Variants<K> {
    fn iter(&self) -> impl Iterator<Item = &Variant<K>> {
        self.ways[..self.len].iter().flatten()
    }
}
