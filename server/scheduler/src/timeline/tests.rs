use super::*;

struct Row {
    key: Ticket,
    load: Load,
}

fn room(rows: &[Row], h: usize) -> Vec<i64> {
    let mut before = 0;
    rows.iter()
        .map(|row| {
            let room = match h {
                1.. if row.load.is_begun => PLENTY - before,
                _ => at_headroom(row.load.due, h) - row.load.tail - before,
            };
            before += row.load.share;
            room
        })
        .collect()
}

#[test]
fn the_tree_knows_what_a_walk_along_the_queue_would_find() {
    let mut dice: u64 = 42;
    let mut roll = |below: u64| {
        dice = dice
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (dice >> 33) % below
    };
    let mut rows: Vec<Row> = Vec::new();
    let mut tree = Timeline::new();
    for arrival in 0..3000 {
        if roll(3) == 0 && !rows.is_empty() {
            let gone = rows.remove(usize::try_from(roll(rows.len() as u64)).unwrap());
            assert_eq!(tree.remove(gone.key), Some(gone.key.arrival));
            assert_eq!(tree.remove(gone.key), None);
        } else if rows.len() < 60 {
            let order = Duration::from_nanos(roll(1000));
            let key = Ticket { order, arrival };
            let tail = i64::try_from(roll(50)).unwrap();
            let load = Load {
                due: nanos(order),
                tail,
                share: tail / 2,
                last_start: nanos(order) - tail,
                is_begun: roll(4) == 0,
            };
            let at = rows.partition_point(|row| row.key < key);
            rows.insert(at, Row { key, load });
            tree.insert(key, load, arrival);
        }
        assert_eq!(tree.len(), rows.len());
        assert_eq!(tree.first(), rows.first().map(|row| row.key));
        assert_eq!(tree.total(), rows.iter().map(|row| row.load.share).sum::<i64>());
        let probed = Ticket {
            order: Duration::from_nanos(roll(1000)),
            arrival,
        };
        let split = rows.partition_point(|row| row.key <= probed);
        let probe = tree.probe(probed);
        assert_eq!(
            probe.before,
            rows[..split].iter().map(|row| row.load.share).sum::<i64>()
        );
        for h in 0..HEADROOMS {
            let room = room(&rows, h);
            let at_most_plenty = |room: i64| room.min(PLENTY / 2);
            let least = |room: &[i64]| at_most_plenty(room.iter().copied().min().unwrap_or(PLENTY));
            assert_eq!(at_most_plenty(tree.least()[h]), least(&room));
            assert_eq!(at_most_plenty(probe.after[h]), least(&room[split..]));
        }
        let limit = i64::try_from(roll(1000)).unwrap() - 500;
        let last = room(&rows, 0).iter().rposition(|&room| room < limit);
        assert_eq!(
            tree.last_with_less_room_than(limit),
            last.map(|last| rows[last].key)
        );
        let earliest = rows.iter().map(|row| row.load.last_start).min();
        assert_eq!(tree.earliest_last_start(), earliest);
        let now = Duration::from_nanos(roll(1000));
        let is_hopeless = |row: &Row| row.load.last_start < nanos(now);
        let found = tree.hopeless(now);
        assert_eq!(found.is_some(), rows.iter().any(is_hopeless));
        assert!(found.is_none_or(|key| rows.iter().any(|row| row.key == key && is_hopeless(row))));
    }
}
