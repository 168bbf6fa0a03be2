use std::collections::BTreeSet;

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

use super::*;

/// Names of a left and a right image.
type Pair = (u64, u64);

const PERIOD: Duration = Duration::from_millis(33);

fn stamp(sequence: impl Into<Option<u64>>, ms: impl Into<Option<u64>>) -> Stamp {
    Stamp {
        sequence: sequence.into(),
        time_ns: ms.into().map(|ms| i128::from(ms) * 1_000_000),
    }
}

fn offer(
    pairer: &mut Pairer<u64>,
    side: Side,
    stamp: Stamp,
    now: Instant,
) -> (Option<Pair>, Vec<(u64, Unpaired)>) {
    let name = stamp.sequence.unwrap_or_default();
    let offered = pairer.offer(side, stamp, name, now);
    let dropped = offered
        .dropped
        .into_iter()
        .map(|dropped| (dropped.image, dropped.why));
    (offered.pair, dropped.collect())
}

#[test]
fn equal_numbers_are_a_pair_whichever_comes_first() {
    let now = Instant::now();
    let mut pairer = Pairer::new(PairingRules::default());
    assert_eq!(
        offer(&mut pairer, Side::Left, stamp(1, None), now),
        (None, vec![])
    );
    assert_eq!(
        offer(&mut pairer, Side::Right, stamp(1, None), now),
        (Some((1, 1)), vec![])
    );
    assert_eq!(
        offer(&mut pairer, Side::Right, stamp(2, None), now),
        (None, vec![])
    );
    assert_eq!(
        offer(&mut pairer, Side::Left, stamp(2, None), now),
        (Some((2, 2)), vec![])
    );
}

#[test]
fn what_a_newer_pair_overtakes_is_given_up() {
    let now = Instant::now();
    let mut pairer = Pairer::new(PairingRules::default());
    for number in [1, 2] {
        offer(&mut pairer, Side::Left, stamp(number, None), now);
    }
    let (pair, dropped) = offer(&mut pairer, Side::Right, stamp(2, None), now);
    assert_eq!((pair, dropped), (Some((2, 2)), vec![(1, Unpaired::Alone)]));
    let (pair, dropped) = offer(&mut pairer, Side::Right, stamp(1, None), now);
    assert_eq!((pair, dropped), (None, vec![(1, Unpaired::Late)]));
}

#[test]
fn an_image_that_comes_twice_is_dropped_once() {
    let now = Instant::now();
    let mut pairer = Pairer::new(PairingRules::default());
    offer(&mut pairer, Side::Left, stamp(1, None), now);
    let again = offer(&mut pairer, Side::Left, stamp(1, None), now);
    assert_eq!(again, (None, vec![(1, Unpaired::Duplicate)]));
    assert_eq!(
        offer(&mut pairer, Side::Right, stamp(1, None), now).0,
        Some((1, 1))
    );
    let again = offer(&mut pairer, Side::Right, stamp(1, None), now);
    assert_eq!(again, (None, vec![(1, Unpaired::Duplicate)]));
}

#[test]
fn times_within_the_tolerance_are_a_pair_and_the_nearest_wins() {
    let now = Instant::now();
    let mut pairer = Pairer::new(PairingRules::default());
    let mut offer = |side, ms, name| pairer.offer(side, stamp(None, ms), name, now).pair;
    assert_eq!(offer(Side::Left, 1000, 1), None);
    assert_eq!(offer(Side::Left, 1012, 2), None);
    assert_eq!(offer(Side::Right, 1010, 3), Some((2, 3)));
    assert_eq!(offer(Side::Left, 1033, 4), None);
    assert_eq!(
        offer(Side::Right, 1044, 5),
        None,
        "11 ms are more than the tolerance"
    );
}

#[test]
fn an_image_that_stays_alone_says_how_far_the_nearest_other_was() {
    let now = Instant::now();
    let mut pairer = Pairer::new(PairingRules::default());
    pairer.offer(Side::Left, stamp(None, 1000), 1, now);
    pairer.offer(Side::Right, stamp(None, 1015), 2, now);
    pairer.offer(Side::Right, stamp(None, 1090), 3, now);
    let expiry = pairer.next_expiry().unwrap();
    assert_eq!(expiry, now + PairingRules::default().patience);
    assert!(pairer.expire(expiry - Duration::from_nanos(1)).is_empty());
    let nearest: Vec<_> = pairer
        .expire(expiry)
        .iter()
        .map(|dropped| dropped.nearest)
        .collect();
    let ms = |ms| Some(Duration::from_millis(ms));
    assert_eq!(nearest, [ms(15), ms(15), ms(90)]);
    assert_eq!(pairer.next_expiry(), None);
}

#[test]
fn an_image_without_number_and_time_is_refused() {
    let mut pairer = Pairer::new(PairingRules::default());
    let (pair, dropped) = offer(&mut pairer, Side::Left, stamp(None, None), Instant::now());
    assert_eq!((pair, dropped), (None, vec![(0, Unpaired::Unstamped)]));
    let by_time = PairingRules {
        key: PairingKey::Time,
        ..PairingRules::default()
    };
    let (_, dropped) = offer(
        &mut Pairer::new(by_time),
        Side::Left,
        stamp(7, None),
        Instant::now(),
    );
    assert_eq!(dropped, vec![(7, Unpaired::Unstamped)]);
}

#[test]
fn a_camera_that_starts_again_is_followed_from_its_first_frame() {
    let now = Instant::now();
    let mut pairer = Pairer::new(PairingRules::default());
    for number in [1000, 1001] {
        offer(&mut pairer, Side::Left, stamp(number, None), now);
        offer(&mut pairer, Side::Right, stamp(number, None), now);
    }
    offer(&mut pairer, Side::Left, stamp(1002, None), now);
    let restarted = offer(&mut pairer, Side::Left, stamp(0, None), now);
    assert_eq!(restarted, (None, vec![(1002, Unpaired::Alone)]));
    assert_eq!(
        offer(&mut pairer, Side::Right, stamp(0, None), now).0,
        Some((0, 0))
    );
}

#[test]
fn no_more_images_wait_than_there_are_places() {
    let now = Instant::now();
    let mut pairer = Pairer::new(PairingRules::default());
    let mut dropped = 0;
    for number in 0..100 {
        dropped += offer(&mut pairer, Side::Left, stamp(number, None), now).1.len();
    }
    assert_eq!(dropped, 100 - MOST_WAITING);
}

/// What a random network does to the images of a camera.
struct Chaos {
    key: PairingKey,
    with_loss: bool,
    with_reorder: bool,
    with_duplicates: bool,
}

/// Which frame an image really is of, and a number of its own.
type Truth = (u64, u64);

/// Sends `frames` frames through the chaos, and checks that pairs are of one frame, in order, and that every image is in one pair or
/// dropped. The number of pairs.
fn send(chaos: &Chaos, frames: u64, dice: &mut StdRng) -> u64 {
    let rules = PairingRules {
        key: chaos.key,
        ..PairingRules::default()
    };
    let start = Instant::now();
    let tolerance_ns = i128::try_from(rules.tolerance.as_nanos()).unwrap();
    let skew_ns = dice.random_range(-tolerance_ns..=tolerance_ns);
    let first: u64 = dice.random_range(0..1000);
    let mut arrivals: Vec<(i128, Side, Stamp, Truth)> = Vec::new();
    let mut sent = 0;
    for frame in first..first + frames {
        let taken_ns = i128::from(frame) * i128::try_from(PERIOD.as_nanos()).unwrap();
        for (side, clock_ns) in [(Side::Left, 0), (Side::Right, skew_ns)] {
            if chaos.with_loss && dice.random_bool(0.2) {
                continue;
            }
            let copies = 1 + u32::from(chaos.with_duplicates && dice.random_bool(0.2));
            for _ in 0..copies {
                let late_ns = match chaos.with_reorder {
                    true => dice.random_range(0..80_000_000),
                    false => dice.random_range(0..1_000_000),
                };
                let stamp = Stamp {
                    sequence: (chaos.key != PairingKey::Time).then_some(frame),
                    time_ns: (chaos.key != PairingKey::Sequence).then_some(taken_ns + clock_ns),
                };
                arrivals.push((taken_ns + late_ns, side, stamp, (frame, sent)));
                sent += 1;
            }
        }
    }
    arrivals.sort_by_key(|&(at, ..)| at);
    let mut pairer = Pairer::new(rules);
    let mut seen = BTreeSet::new();
    let mut last = None;
    let mut pairs = 0;
    let begin = arrivals.first().map_or(0, |&(at, ..)| at);
    for (at, side, stamp, truth) in arrivals {
        let now = start + Duration::from_nanos(u64::try_from(at - begin).unwrap());
        let Offered { pair, dropped } = pairer.offer(side, stamp, truth, now);
        if let Some((left, right)) = pair {
            assert_eq!(left.0, right.0, "a left and a right image of different frames");
            assert!(last < Some(left.0), "pairs came out of order");
            last = Some(left.0);
            pairs += 1;
            assert!(
                seen.insert(left.1) && seen.insert(right.1),
                "an image was used twice"
            );
        }
        for dropped in dropped {
            assert!(seen.insert(dropped.image.1), "an image was dropped and used");
        }
    }
    for dropped in pairer.expire(start + Duration::from_secs(3600)) {
        assert!(seen.insert(dropped.image.1), "an image was dropped and used");
    }
    assert_eq!(seen.len() as u64, sent, "an image was neither paired nor dropped");
    pairs
}

#[test]
fn a_million_random_sequences_have_no_image_in_a_wrong_pair() {
    let mut dice = StdRng::seed_from_u64(7);
    let mut pairs = 0;
    for round in 0..1_000_000_u32 {
        let chaos = Chaos {
            key: [PairingKey::Either, PairingKey::Sequence, PairingKey::Time][round as usize % 3],
            with_loss: dice.random_bool(0.7),
            with_reorder: dice.random_bool(0.5),
            with_duplicates: dice.random_bool(0.5),
        };
        pairs += send(&chaos, 6, &mut dice);
    }
    assert!(pairs > 3_000_000, "only {pairs} of 6 million frames came through");
}

#[test]
fn without_loss_and_reordering_every_frame_is_a_pair() {
    let mut dice = StdRng::seed_from_u64(8);
    for key in [PairingKey::Either, PairingKey::Sequence, PairingKey::Time] {
        let chaos = Chaos {
            key,
            with_loss: false,
            with_reorder: false,
            with_duplicates: true,
        };
        for _ in 0..1000 {
            assert_eq!(send(&chaos, 20, &mut dice), 20);
        }
    }
}
