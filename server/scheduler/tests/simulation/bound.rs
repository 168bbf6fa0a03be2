//! What nobody could do better: an upper bound of the frames in budget.
//!
//! Let every frame need only its mandatory part, let it be interrupted anywhere at no cost, and let a part of a frame count as that part
//! of an answer. Then the most that can be had is a largest matching of slices of time to frames, each good from its arrival to its
//! deadline, and taking the earliest deadline at every moment finds it (Glover 1967, matching in convex bipartite graphs). Frames that
//! all cost the same are counted by the work done for them.

use std::collections::BTreeMap;
use std::time::Duration;

use super::traffic::Request;

/// An upper bound of the share of `requests`, sorted by arrival, that one worker can answer in budget, if each takes `mandatory`.
pub(crate) fn most_in_budget(requests: &[Request], mandatory: Duration) -> f64 {
    let mut open: BTreeMap<(Duration, usize), Duration> = BTreeMap::new();
    let mut done = Duration::ZERO;
    let mut now = Duration::ZERO;
    let mut work_until = |end: Duration, open: &mut BTreeMap<(Duration, usize), Duration>| {
        while let Some(mut first) = open.first_entry().filter(|_| now < end) {
            let (due, _) = *first.key();
            if due <= now {
                first.remove();
                continue;
            }
            let slice = (*first.get()).min(due - now).min(end - now);
            now += slice;
            done += slice;
            *first.get_mut() -= slice;
            if first.get().is_zero() {
                first.remove();
            }
        }
        now = now.max(end);
    };
    for (index, request) in requests.iter().enumerate() {
        work_until(request.at, &mut open);
        if let Some(due) = request.deadline {
            open.insert((due, index), mandatory);
        }
    }
    work_until(Duration::from_secs(1_000_000), &mut open);
    done.as_secs_f64() / mandatory.as_secs_f64() / (requests.len() as f64).max(1.0)
}
