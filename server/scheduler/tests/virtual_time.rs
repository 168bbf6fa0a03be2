//! Properties of the policy on virtual time: any arrivals, no clock, no sleep.

use std::time::Duration;

use proptest::prelude::{Strategy, prop_assert, prop_assert_eq, proptest};
use stereo_scheduler::{Budget, Costs, DeadlineQueue, TailEstimate};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Job {
    deadline: Duration,
    arrival: usize,
}

fn ms(range: std::ops::Range<u64>) -> impl Strategy<Value = Duration> {
    range.prop_map(Duration::from_millis)
}

proptest! {
    #[test]
    fn jobs_leave_by_deadline_then_arrival_and_none_is_lost(
        deadlines in proptest::collection::vec(ms(0..50), 0..200),
        capacity in 1_usize..100,
    ) {
        let mut queue = DeadlineQueue::new(capacity);
        let mut refused = 0;
        for (arrival, &deadline) in deadlines.iter().enumerate() {
            refused += usize::from(queue.push(deadline, Job { deadline, arrival }).is_err());
            prop_assert!(queue.len() <= capacity);
        }
        prop_assert_eq!(refused, deadlines.len().saturating_sub(capacity));
        let left: Vec<Job> = std::iter::from_fn(|| queue.pop()).collect();
        prop_assert_eq!(left.len() + refused, deadlines.len());
        prop_assert!(left.is_sorted_by_key(|job| (job.deadline, job.arrival)));
    }

    #[test]
    fn exactly_the_jobs_that_are_due_expire(
        deadlines in proptest::collection::vec(ms(0..50), 0..100),
        now in ms(0..50),
    ) {
        let mut queue = DeadlineQueue::new(deadlines.len());
        for (arrival, &deadline) in deadlines.iter().enumerate() {
            queue.push(deadline, Job { deadline, arrival }).unwrap();
        }
        let expired = queue.take_expired(now);
        prop_assert!(expired.iter().all(|job| job.deadline <= now));
        prop_assert!(std::iter::from_fn(|| queue.pop()).all(|job| job.deadline > now));
        prop_assert_eq!(expired.len(), deadlines.iter().filter(|&&deadline| deadline <= now).count());
    }

    #[test]
    fn a_removed_job_is_gone_and_the_others_keep_their_order(
        deadlines in proptest::collection::vec(ms(0..20), 1..60),
        pick in 0_usize..60,
    ) {
        let mut queue = DeadlineQueue::new(deadlines.len());
        let mut tickets = Vec::new();
        for (arrival, &deadline) in deadlines.iter().enumerate() {
            tickets.push(queue.push(deadline, Job { deadline, arrival }).unwrap());
        }
        let gone = pick % deadlines.len();
        prop_assert_eq!(queue.remove(tickets[gone]).map(|job| job.arrival), Some(gone));
        let left: Vec<Job> = std::iter::from_fn(|| queue.pop()).collect();
        prop_assert!(left.iter().all(|job| job.arrival != gone));
        prop_assert!(left.is_sorted_by_key(|job| (job.deadline, job.arrival)));
    }

    /// A worker that asks before each rung, with costs it has estimated from the same distribution, serves a frame in time.
    #[test]
    fn rungs_that_keep_to_their_estimate_never_miss_the_deadline(
        budget_ms in 1_u64..200,
        reserve_ms in 0_u64..50,
        costs_us in proptest::collection::vec(1_u64..20_000, 1..9),
    ) {
        let budget = Budget { deadline: Duration::from_millis(budget_ms), reserve: Duration::from_millis(reserve_ms) };
        let mut now = Duration::ZERO;
        let mut rungs = 0;
        for cost in costs_us.into_iter().map(Duration::from_micros) {
            if !budget.may_start(now, Some(cost)) {
                break;
            }
            now += cost;
            rungs += 1;
        }
        prop_assert!(rungs == 0 || now + budget.reserve <= budget.deadline);
    }

    #[test]
    fn the_tail_covers_most_of_a_noisy_cost(seed in 0_u64..1000) {
        let mut noise = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let mut costs = Costs::default();
        let mut covered = 0_u32;
        let rounds = 2000_u32;
        for _ in 0..rounds {
            noise ^= noise << 13;
            noise ^= noise >> 7;
            noise ^= noise << 17;
            let took = Duration::from_micros(5000 + noise % 2000);
            covered += u32::from(costs.tail(&(), 1000).is_some_and(|tail| took <= tail));
            costs.record((), 1000, took);
        }
        prop_assert!(covered > rounds * 95 / 100, "{} of {} covered", covered, rounds);
    }

    #[test]
    fn the_estimate_follows_a_machine_that_got_slower(slow in 2.0_f64..20.0) {
        let mut estimate = TailEstimate::first(1.0);
        (0..50).for_each(|_| estimate.record(1.0));
        (0..100).for_each(|_| estimate.record(slow));
        prop_assert!((estimate.mean() - slow).abs() < 0.01 * slow);
        prop_assert!(estimate.tail() < 1.1 * slow);
    }
}
