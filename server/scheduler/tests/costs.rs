//! What the cost model makes of what it was told, and of what it was not.

use std::time::Duration;

use stereo_scheduler::{CostModel, Kind, Stage};

const fn us(us: u64) -> Duration {
    Duration::from_micros(us)
}

const UNITS: u32 = 1000;

/// A size class; alike as far as they are near.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Size(u32);

impl Kind for Size {
    fn distance(&self, other: &Self) -> Option<u32> {
        (self.0 < 100 && other.0 < 100).then(|| self.0.abs_diff(other.0))
    }
}

/// Within a thousandth: values are kept as 32-bit numbers.
fn is_near(cost: Duration, expected: Duration) -> bool {
    (cost.as_secs_f64() / expected.as_secs_f64() - 1.0).abs() < 1e-3
}

#[test]
fn an_unknown_kind_is_predicted_from_the_nearest_one_by_the_unit() {
    let mut costs = CostModel::new(64);
    for (size, took) in [(1, 100), (5, 500), (9, 900)] {
        costs.learn(us(0), Size(size), Stage::Decode, UNITS, us(took));
    }
    let cost = costs.cost(us(0), Size(6), Stage::Decode, 3 * UNITS);
    assert!(is_near(cost.typical, us(1500)), "{cost:?}");
    let known = costs.cost(us(0), Size(5), Stage::Decode, 3 * UNITS);
    assert!(cost.tail > known.tail, "what is only alike is less certain");
    let unrelated = costs.cost(us(0), Size(100), Stage::Decode, UNITS);
    assert!(
        unrelated.typical >= us(900),
        "the worst of all is reckoned with: {unrelated:?}"
    );
    assert_eq!(
        costs.cost(us(0), Size(5), Stage::Rung(0), UNITS).tail,
        Duration::ZERO
    );
}

#[test]
fn an_ending_after_an_unknown_rung_is_predicted_from_a_known_one() {
    let mut costs = CostModel::new(64);
    costs.learn(us(0), Size(1), Stage::Mesh(0), UNITS, us(100));
    costs.learn(us(0), Size(1), Stage::Mesh(2), UNITS, us(400));
    assert!(is_near(
        costs.cost(us(0), Size(1), Stage::Mesh(1), UNITS).typical,
        us(100)
    ));
    assert!(is_near(
        costs.cost(us(0), Size(1), Stage::Mesh(5), UNITS).typical,
        us(400)
    ));
    costs.learn(us(0), Size(1), Stage::Rung(0), UNITS, us(100));
    assert_eq!(
        costs.cost(us(0), Size(1), Stage::Rung(1), UNITS).typical,
        Duration::ZERO,
        "rungs have nothing in common"
    );
}

#[test]
fn the_first_real_frame_replaces_the_dummies_and_corrects_those_that_remain() {
    let mut costs = CostModel::new(64);
    for _ in 0..8 {
        costs.prime(us(0), Size(1), Stage::Mesh(0), UNITS, us(200));
        costs.prime(us(0), Size(1), Stage::Mesh(2), UNITS, us(800));
    }
    assert!(is_near(
        costs.cost(us(0), Size(1), Stage::Mesh(0), UNITS).typical,
        us(200)
    ));
    costs.learn(us(0), Size(1), Stage::Mesh(2), UNITS, us(400));
    assert!(is_near(
        costs.cost(us(0), Size(1), Stage::Mesh(2), UNITS).typical,
        us(400)
    ));
    assert!(
        is_near(costs.cost(us(0), Size(1), Stage::Mesh(0), UNITS).typical, us(100)),
        "real frames take half of what dummies do"
    );
    costs.prime(us(0), Size(1), Stage::Mesh(2), UNITS, us(800));
    assert!(
        is_near(costs.cost(us(0), Size(1), Stage::Mesh(2), UNITS).typical, us(400)),
        "another worker's dummy changes nothing any more"
    );
}

#[test]
fn an_ending_that_only_dummies_had_is_no_dearer_than_that_of_a_better_map() {
    let mut costs = CostModel::new(64);
    costs.prime(us(0), Size(1), Stage::Mesh(0), UNITS, us(900));
    for _ in 0..8 {
        costs.learn(us(0), Size(1), Stage::Mesh(2), UNITS, us(400));
    }
    let (ending, better) = (
        costs.cost(us(0), Size(1), Stage::Mesh(0), UNITS),
        costs.cost(us(0), Size(1), Stage::Mesh(2), UNITS),
    );
    assert_eq!(ending, better);
}

#[test]
fn a_hiccup_moves_what_is_typical_a_little_and_a_slower_machine_soon() {
    let mut costs = CostModel::new(64);
    for _ in 0..32 {
        costs.learn(us(0), Size(1), Stage::Decode, UNITS, us(100));
    }
    costs.learn(us(0), Size(1), Stage::Decode, UNITS, us(5000));
    assert!(costs.cost(us(0), Size(1), Stage::Decode, UNITS).typical < us(120));
    for _ in 0..16 {
        costs.learn(us(0), Size(1), Stage::Decode, UNITS, us(150));
    }
    assert!(costs.cost(us(0), Size(1), Stage::Decode, UNITS).typical > us(145));
}

#[test]
fn a_machine_that_was_slow_is_not_expected_to_be_for_ever() {
    let mut costs = CostModel::new(64);
    // A frame each 4 ms: twenty of 3 ms, ten slow ones, so that one says much about the next. The last ones are slow.
    for frame in 0..300 {
        let took = if frame % 30 >= 20 { us(4500) } else { us(3000) };
        costs.learn(us(frame * 4000), Size(1), Stage::Rung(0), UNITS, took);
    }
    let end = us(300 * 4000);
    let typical = |now| costs.cost(now, Size(1), Stage::Rung(0), UNITS).typical;
    let usual = typical(end + us(10_000_000));
    assert!(typical(end) > usual.mul_f64(1.1), "{:?}, {usual:?}", typical(end));
    assert!(
        typical(end + us(300_000)) < usual.mul_f64(1.02),
        "after a pause that is old news"
    );
}

#[test]
fn a_cost_in_doubt_is_replaced_by_a_lower_one_and_outlives_a_higher_one() {
    let known = || {
        let mut costs = CostModel::new(64);
        for _ in 0..64 {
            costs.learn(us(0), Size(1), Stage::Decode, UNITS, us(100));
        }
        costs.doubt(Size(1), Stage::Decode);
        costs
    };
    let mut faster = known();
    faster.learn(us(0), Size(1), Stage::Decode, UNITS, us(50));
    assert!(is_near(
        faster.cost(us(0), Size(1), Stage::Decode, UNITS).typical,
        us(50)
    ));
    let mut colder = known();
    colder.learn(us(0), Size(1), Stage::Decode, UNITS, us(200));
    colder.learn(us(0), Size(1), Stage::Decode, UNITS, us(90));
    assert!(is_near(
        colder.cost(us(0), Size(1), Stage::Decode, UNITS).typical,
        us(100)
    ));
}

#[test]
fn tails_of_stages_that_follow_each_other_do_not_simply_add_up() {
    let cost = |typical, tail| stereo_scheduler::Cost {
        typical: us(typical),
        tail: us(tail),
    };
    let both = cost(100, 200) + cost(100, 200);
    assert_eq!(both.typical, us(200));
    assert!(both.tail > us(342) && both.tail < us(400), "{both:?}");
}
