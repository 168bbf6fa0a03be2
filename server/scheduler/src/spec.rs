//! What the scheduler is told about a job, and the limits it works within.

use std::time::Duration;

/// Who a job is charged to: a camera or a credential. A server hashes the name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ClientId(pub u64);

/// A stream of frames of which only the newest matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct StreamId(pub u64);

/// Names a job from its submission to its end, so that it can be taken back. Never reused within one scheduler.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticket {
    /// What the queue sorts by: the deadline, or zero under a policy that keeps the order of arrival.
    pub(crate) order: Duration,
    pub(crate) arrival: u64,
}

/// One job: whose it is, when it is due, and what kind of work it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JobSpec<K> {
    /// Whose share it is charged to.
    pub client: ClientId,
    /// Weight of that client among the active ones, 1 for everybody alike; 0 counts as 1.
    pub weight: u32,
    /// If given, this job replaces one of the same stream that still waits, and ends the refinement of one that runs.
    pub stream: Option<StreamId>,
    /// When it is due, if ever.
    pub urgency: Urgency,
    /// The work at full resolution.
    pub work: Work<K>,
    /// The work at half resolution, if the client allows that instead.
    pub half: Option<Work<K>>,
    /// Whether the client would rather have a result without its mesh than none.
    pub is_mesh_optional: bool,
}

/// When a job is due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Urgency {
    /// The answer is due at this moment.
    Deadline {
        /// The moment, since the caller's epoch.
        at: Duration,
        /// What it is worth beside the others.
        priority: Priority,
    },
    /// Whenever no job with a deadline is in want of the worker.
    Background,
}

/// Classes of jobs with a deadline. The order of service is by deadline alone; the class decides who is turned away.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub enum Priority {
    /// Admitted without a promise: dropped ([`DropReason::Displaced`](crate::DropReason)) when a promised job needs its place.
    BestEffort,
    /// Admitted means kept.
    #[default]
    Normal,
    /// As normal; the other classes leave room for what this class has been asking for.
    High,
}

/// What a stage works on, as far as it makes a difference to its cost by the unit.
pub trait Kind: Copy + Eq + std::hash::Hash {
    /// How unlike the costs of two kinds are expected to be; `None` if one says nothing about the other. What was never measured is
    /// predicted from the nearest kind that was.
    fn distance(&self, other: &Self) -> Option<u32> {
        (self == other).then_some(0)
    }
}

/// Plain numbers, for simulations: unrelated to each other.
impl Kind for u32 {}

/// The stages of a job, by the kinds `K` under which their costs are known.
///
/// Two jobs whose stage has equal kinds cost about the same for each unit. A kind may carry size class, codec, options.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Work<K> {
    /// Size, pixels for a frame. Costs are learned and predicted by the unit.
    pub units: u32,
    /// Input to gray views.
    pub decode: K,
    /// Base and the rungs after it.
    pub matching: K,
    /// The output mesh, if any is wanted.
    pub mesh: Option<K>,
    /// Result to bytes.
    pub encode: K,
    /// Rungs wanted, the first (base) included; 0 counts as 1.
    pub rungs: u8,
}

/// A stage of a job; costs are kept for each stage of each kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// Input to gray views.
    Decode,
    /// The rung of this index, 0 = base.
    Rung(u8),
    /// One step of a refining rung.
    Step,
    /// The output mesh, after the rung of this index: a better map has a finer mesh.
    Mesh(u8),
    /// Result to bytes, after the rung of this index.
    Encode(u8),
    /// The bytes on their way to the client: no worker's time, but a part of the budget. Known by the kind of the encoding.
    Reply,
}

impl Stage {
    /// The same stage after or at another rung; `None` if it has nothing to do with rungs.
    pub(crate) fn at_rung(self, rung: u8) -> Option<Self> {
        match self {
            Self::Decode | Self::Step | Self::Reply => None,
            Self::Rung(_) => Some(Self::Rung(rung)),
            Self::Mesh(_) => Some(Self::Mesh(rung)),
            Self::Encode(_) => Some(Self::Encode(rung)),
        }
    }

    pub(crate) fn rung(self) -> u8 {
        match self {
            Self::Decode | Self::Step | Self::Reply => 0,
            Self::Rung(rung) | Self::Mesh(rung) | Self::Encode(rung) => rung,
        }
    }
}

/// How jobs are ordered, admitted and ended. All but [`Edf`](Self::Edf) are there to be compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Policy {
    /// Earliest deadline first with admission, expiry, shares, and rungs as time allows.
    #[default]
    Edf,
    /// In order of arrival, every rung, no deadline is looked at.
    Fifo,
    /// As `Fifo`, and a job whose deadline passed while it waited is dropped.
    FifoTimeout,
    /// As `FifoTimeout` with this many rungs for every job, the first included.
    Fixed(u8),
}

/// Limits of one scheduler. Memory is bounded by these numbers alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Config {
    /// How jobs are ordered, admitted and ended.
    pub policy: Policy,
    /// Workers, numbered from 0; at least 1.
    pub workers: usize,
    /// Jobs with a deadline that may wait.
    pub capacity: usize,
    /// Background jobs that may wait.
    pub background_capacity: usize,
    /// Clients that are told apart; the one that has been silent longest is forgotten first.
    pub max_clients: usize,
    /// Kinds of stages whose costs are remembered; the one not seen for longest is forgotten first.
    pub max_costs: usize,
    /// Jobs with a deadline that may lie aside at one worker, unfinished, while others are begun; each keeps its buffers.
    pub max_aside: usize,
    /// Units of work of these together; one may lie aside however large it is.
    pub max_aside_units: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            policy: Policy::Edf,
            workers: 1,
            capacity: 1024,
            background_capacity: 64,
            max_clients: 4096,
            max_costs: 1024,
            max_aside: 8,
            max_aside_units: 4_000_000,
        }
    }
}
