//! A worker's place at the scheduler: it takes jobs there and says how it gets on. A worker that was given up as stuck finds its place
//! taken whenever it comes back.

use std::sync::{Arc, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use stereo_scheduler::{Dispatch as Taken, Finished, Next, Ticket, Verdict};

use super::{Dispatch, Job, Phase, State};

/// Shortest time to sleep before looking again for work that is not due yet.
const SHORTEST_NAP: Duration = Duration::from_millis(1);

/// Another thread has this worker's index: this one has to end without a word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Replaced;

/// The right to speak for one worker.
pub(crate) struct Seat {
    dispatch: Arc<Dispatch>,
    index: usize,
    generation: u64,
}

/// What an idle worker does next.
pub(crate) enum Task {
    /// A job from its start.
    Start(Taken<Arc<Job>>),
    /// A job that was put aside, and what to do with it now.
    Resume(Ticket, Verdict),
}

impl Seat {
    pub(super) fn new(dispatch: &Arc<Dispatch>, index: usize, generation: u64) -> Self {
        Self {
            dispatch: Arc::clone(dispatch),
            index,
            generation,
        }
    }

    /// The worker's number.
    pub(crate) fn index(&self) -> usize {
        self.index
    }

    /// How many threads had it before.
    pub(crate) fn generation(&self) -> u64 {
        self.generation
    }

    /// Blocks until there is something to do; `None` once the service is closed or the worker was replaced.
    pub(crate) fn take(&self) -> Option<Task> {
        let dispatch = &*self.dispatch;
        let mut state = dispatch.lock();
        loop {
            if state.slots[self.index].generation != self.generation {
                return None;
            }
            let now = Instant::now();
            let at = dispatch.scheduler_time(now);
            let next = state.scheduler.next(at, self.index);
            // Those it has found hopeless on the way are among them.
            let dropped = state.scheduler.expire(at);
            let slot = &mut state.slots[self.index];
            slot.beat = now;
            let task = match next {
                Some(Next::Start(taken)) => {
                    slot.job = Some((taken.ticket, Arc::clone(&taken.job)));
                    Some(Task::Start(taken))
                }
                Some(Next::Resume { ticket, verdict }) => {
                    let place = slot.aside.iter().position(|(aside, _)| *aside == ticket);
                    slot.job = place.map(|place| slot.aside.swap_remove(place));
                    let verdict = state.follow(self.index, verdict);
                    Some(Task::Resume(ticket, verdict))
                }
                None => None,
            };
            if !dropped.is_empty() {
                drop(state);
                dispatch.answer_dropped(dropped);
                state = dispatch.lock();
            } else if task.is_none() && state.phase != Phase::Closed {
                state = self.wait(state, at);
                continue;
            }
            if task.is_some() || state.phase == Phase::Closed {
                return task;
            }
        }
    }

    fn wait<'a>(&'a self, state: MutexGuard<'a, State>, now: Duration) -> MutexGuard<'a, State> {
        let wake = &self.dispatch.wake;
        let _waits = self.dispatch.idle.begin();
        match state.scheduler.next_wakeup() {
            None => wake.wait(state).unwrap_or_else(PoisonError::into_inner),
            Some(at) => {
                let nap = at.saturating_sub(now).max(SHORTEST_NAP);
                wake.wait_timeout(state, nap)
                    .unwrap_or_else(PoisonError::into_inner)
                    .0
            }
        }
    }

    /// The images are gray.
    pub(crate) fn decoded(&self) -> Result<(), Replaced> {
        self.tell(|state, now| state.scheduler.decoded(now, self.index))
    }

    /// A rung is finished; `has_more` if the matcher could go on.
    pub(crate) fn rung_done(&self, has_more: bool) -> Result<Verdict, Replaced> {
        self.tell(|state, now| {
            let verdict = state.scheduler.rung_done(now, self.index, has_more);
            state.follow(self.index, verdict)
        })
    }

    /// What there is at a rung has been handed out.
    pub(crate) fn shared(&self) -> Result<Verdict, Replaced> {
        self.tell(|state, now| {
            let verdict = state.scheduler.shared(now, self.index);
            state.follow(self.index, verdict)
        })
    }

    /// A step within a rung is finished.
    pub(crate) fn step_done(&self) -> Result<Verdict, Replaced> {
        self.tell(|state, now| {
            let verdict = state.scheduler.step_done(now, self.index);
            state.follow(self.index, verdict)
        })
    }

    /// The mesh is made.
    pub(crate) fn meshed(&self) -> Result<(), Replaced> {
        self.tell(|state, now| state.scheduler.meshed(now, self.index))
    }

    /// The worker gets on, between two bodies.
    pub(crate) fn beat(&self) -> Result<(), Replaced> {
        self.tell(|_, _| ())
    }

    /// What the stages of the job that is being encoded were expected to take; zero if there is none.
    pub(crate) fn expected(&self) -> Duration {
        let state = self.dispatch.lock();
        let is_ours = state.slots[self.index].generation == self.generation;
        let expected = is_ours.then(|| state.scheduler.expected(self.index)).flatten();
        expected.unwrap_or_default()
    }

    /// The result is encoded: the worker is idle.
    pub(crate) fn finished(&self) -> Result<Option<Finished>, Replaced> {
        self.tell(|state, now| {
            state.slots[self.index].job = None;
            state.scheduler.finished(now, self.index)
        })
    }

    /// The job failed or was dropped: the worker is idle.
    pub(crate) fn failed(&self) -> Result<(), Replaced> {
        self.tell(|state, now| {
            state.slots[self.index].job = None;
            state.scheduler.failed(now, self.index);
        })
    }

    fn tell<T>(&self, what: impl FnOnce(&mut State, Duration) -> T) -> Result<T, Replaced> {
        let mut state = self.dispatch.lock();
        let now = Instant::now();
        let slot = &mut state.slots[self.index];
        if slot.generation != self.generation {
            return Err(Replaced);
        }
        slot.beat = now;
        Ok(what(&mut state, self.dispatch.scheduler_time(now)))
    }
}

impl State {
    /// Keeps the slot of `index` true to what its worker was told.
    fn follow(&mut self, index: usize, verdict: Verdict) -> Verdict {
        let slot = &mut self.slots[index];
        match verdict {
            Verdict::Yield => slot.aside.extend(slot.job.take()),
            Verdict::Abandon => slot.job = None,
            Verdict::Continue | Verdict::Finish { .. } => {}
        }
        verdict
    }
}
