use proptest::prelude::*;

use super::{Plane, Strip, fill, scan_lines};
use crate::mesh::Vertex;
use crate::simd::{Kernel, Lanes, Level};

/// Column, row, and disparity in 1/64 px.
type Corner = (u16, u16, u16);

fn vertex((u, v, fixed): Corner) -> Vertex {
    Vertex {
        u: f32::from(u),
        v: f32::from(v),
        disparity: f32::from(fixed) / 64.0,
    }
}

/// Twice the signed area of a triangle.
fn area(p: (i64, i64), q: (i64, i64), r: (i64, i64)) -> i64 {
    (q.0 - p.0) * (r.1 - p.1) - (q.1 - p.1) * (r.0 - p.0)
}

/// Whether a pixel is inside a triangle or on its edges, in whole numbers.
fn contains(corners: &[Corner; 3], at: (i64, i64)) -> bool {
    let [p, q, r] = corners.map(|(u, v, _)| (i64::from(u), i64::from(v)));
    let signs = [area(p, q, at), area(q, r, at), area(r, p, at)].map(i64::signum);
    let within = |from: i64, values: [i64; 3]| {
        (values.iter().min() <= Some(&from)) && (values.iter().max() >= Some(&from))
    };
    // The second line is for triangles that are no more than a line or a point.
    (signs.iter().all(|&sign| sign >= 0) || signs.iter().all(|&sign| sign <= 0))
        && within(at.0, [p.0, q.0, r.0])
        && within(at.1, [p.1, q.1, r.1])
}

fn visited(corners: &[Corner; 3]) -> Vec<(i64, i64)> {
    let mut pixels = Vec::new();
    scan_lines(&corners.map(vertex), |v, first, last| {
        pixels.extend((first..=last).map(|u| (i64::try_from(u).unwrap(), i64::try_from(v).unwrap())));
    });
    pixels
}

fn corners(side: u16) -> impl Strategy<Value = [Corner; 3]> {
    proptest::array::uniform3((0..side, 0..side, 0u16..=255 * 64))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn scan_lines_visit_each_pixel_inside_or_on_an_edge_once_and_no_other(
        corners in prop_oneof![corners(4), corners(12), corners(200)],
    ) {
        let all = (0..200i64).flat_map(|v| (0..200).map(move |u| (u, v)));
        let expected: Vec<_> = all.filter(|&at| contains(&corners, at)).collect();
        prop_assert_eq!(visited(&corners), expected);
    }

    #[test]
    fn scan_lines_of_lines_and_points_visit_the_pixels_on_them(
        (from, step) in ((0u16..20, 0u16..20), (0u16..9, 0u16..9)),
        ends in proptest::array::uniform3(0u16..9),
        order in Just([0usize, 1, 2]).prop_shuffle(),
    ) {
        let corners = order.map(|k| (from.0 + ends[k] * step.0, from.1 + ends[k] * step.1, 0));
        let all = (0..100i64).flat_map(|v| (0..100).map(move |u| (u, v)));
        let expected: Vec<_> = all.filter(|&at| contains(&corners, at)).collect();
        prop_assert_eq!(visited(&corners), expected);
    }

    #[test]
    fn pixels_lie_on_the_plane_through_the_vertices(corners in corners(300)) {
        let [p, q, r] = corners.map(|(u, v, fixed)| (f64::from(u), f64::from(v), f64::from(fixed)));
        let twice_area = (q.0 - p.0) * (r.1 - p.1) - (q.1 - p.1) * (r.0 - p.0);
        let longest = [(p, q), (q, r), (r, p)].iter().fold(0.0f64, |most, (p, q)| most.max((p.0 - q.0).hypot(p.1 - q.1)));
        // Slivers thinner than 2 px have next to no pixels of their own, and planes of any steepness.
        prop_assume!(twice_area.abs() >= 2.0 * longest);
        let mut map = vec![u16::MAX; 300 * 300];
        fill(Level::detect(), &mut map, 300, [corners.map(vertex)].into_iter(), 255 * 64);
        for &(u, v, fixed) in &corners {
            prop_assert_eq!(map[usize::from(v) * 300 + usize::from(u)], fixed);
        }
        for (at, &fixed) in map.iter().enumerate() {
            let (u, v) = (at % 300, at / 300);
            if contains(&corners, (i64::try_from(u).unwrap(), i64::try_from(v).unwrap())) {
                let (u, v) = (u as f64 - p.0, v as f64 - p.1);
                let weight_q = (u * (r.1 - p.1) - v * (r.0 - p.0)) / twice_area;
                let weight_r = (v * (q.0 - p.0) - u * (q.1 - p.1)) / twice_area;
                let exact = p.2 + weight_q * (q.2 - p.2) + weight_r * (r.2 - p.2);
                prop_assert!((f64::from(fixed) - exact).abs() <= 1.0, "{} instead of {}", fixed, exact);
            } else {
                prop_assert_eq!(fixed, u16::MAX);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_map_filled_in_strips_is_the_same(corners in corners(40), rows in 1usize..=40) {
        let triangles = || [corners.map(vertex)].into_iter();
        let (mut whole, mut parts) = (vec![77; 40 * 40], vec![77; 40 * 40]);
        fill(Level::detect(), &mut whole, 40, triangles(), 255 * 64);
        let mut lines = 0;
        for (k, map) in parts.chunks_mut(rows * 40).enumerate() {
            let strip = Strip { first_row: k * rows, map, width: 40 };
            strip.fill(Level::detect(), triangles(), 255 * 64, |_, _, _| lines += 1);
        }
        prop_assert_eq!(&whole, &parts);
        let filled = whole.chunks(40).filter(|row| row.iter().any(|&fixed| fixed != 77));
        prop_assert!(filled.count() <= lines && lines <= 40);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn scan_lines_of_the_largest_triangles_lose_no_pixel(corners in corners(4096)) {
        let mut rows = std::collections::BTreeMap::new();
        scan_lines(&corners.map(vertex), |v, first, last| {
            rows.insert(i64::try_from(v).unwrap(), (i64::try_from(first).unwrap(), i64::try_from(last).unwrap()));
        });
        for v in 0..4096 {
            let inside = (0..4096).filter(|&u| contains(&corners, (u, v)));
            let (mut first, mut last) = (i64::MAX, i64::MIN);
            inside.for_each(|u| (first, last) = (first.min(u), last.max(u)));
            let (from, to) = rows.get(&v).copied().unwrap_or((i64::MAX, i64::MIN));
            // At this size a pixel may be within rounding of an edge: one more on each side is harmless.
            prop_assert!((first - 1..=first).contains(&from) || first > last, "row {}: {} for {}", v, from, first);
            prop_assert!((last..=last + 1).contains(&to) || first > last, "row {}: {} for {}", v, to, last);
        }
    }
}

#[test]
fn vertices_on_one_line_have_no_plane_and_fill_nothing() {
    let line = [(2, 2, 64), (6, 4, 128), (10, 6, 0)].map(vertex);
    assert_eq!(Plane::through(&line), None);
    let mut map = vec![77; 16 * 16];
    fill(Level::detect(), &mut map, 16, [line].into_iter(), 1000);
    assert!(map.iter().all(|&fixed| fixed == 77));
}

#[test]
fn disparities_are_kept_within_the_range() {
    let corners = [(0.0, 0.0, -3.0), (15.0, 0.0, 12.0), (0.0, 15.0, -3.0)];
    let vertices = corners.map(|(u, v, disparity)| Vertex { u, v, disparity });
    let mut map = vec![u16::MAX; 16 * 16];
    fill(Level::detect(), &mut map, 16, [vertices].into_iter(), 5 * 64);
    assert_eq!(map[..6], [0, 0, 0, 0, 64, 128]);
    assert_eq!(map[7..16], [256, 320, 320, 320, 320, 320, 320, 320, 320]);
}

#[test]
fn steepness_is_the_length_of_the_gradient() {
    let plane = Plane::through(&[(0, 0, 64), (10, 0, 64 + 30 * 64), (0, 10, 64 + 40 * 64)].map(vertex));
    assert_eq!(
        plane,
        Some(Plane {
            a: 3.0,
            b: 4.0,
            c: 1.0
        })
    );
    let is_steeper = |limit| plane.map(|plane| plane.is_steeper_than(limit));
    assert_eq!([4.99, 5.0].map(is_steeper), [Some(true), Some(false)]);
}

/// A ramp between two pixels that stay as they are.
struct Ramps {
    length: usize,
    first: i32,
    step: i32,
}

impl Kernel for Ramps {
    type Output = Vec<u16>;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Vec<u16> {
        let mut row = vec![7; self.length + 2];
        lanes.ramp(&mut row[1..=self.length], self.first, self.step, 200 << 16);
        row
    }
}

#[test]
fn ramps_of_every_length_are_the_same_at_all_levels() {
    for length in 0..70 {
        for (first, step) in [
            (100 << 16, 12_345),
            (100 << 16, -98_765),
            (-(50 << 16), 1 << 19),
            (i32::MAX, 1 << 20),
        ] {
            let ramp = |level: Level| level.run(Ramps { length, first, step });
            let mut value = first;
            let mut expected = vec![7];
            for _ in 0..length {
                expected.push(u16::try_from(value.clamp(0, 200 << 16) >> 16).unwrap());
                value = value.wrapping_add(step);
            }
            expected.push(7);
            for level in Level::available() {
                assert_eq!(
                    ramp(level),
                    expected,
                    "{level:?}, {length} px from {first} by {step}"
                );
            }
        }
    }
}
