use proptest::prelude::*;

use super::{CORNERS, Triangle, Triangulation};
use crate::interpolate::{fill, scan_lines};
use crate::scene::Noise;
use crate::simd::Level;
use crate::support::Support;

fn draw(noise: &mut Noise, count: usize, (width, height): (usize, usize)) -> Vec<Support> {
    (0..count)
        .map(|_| Support {
            x: 4 + noise.below(width - 8),
            y: 4 + noise.below(height - 8),
            disparity_px: f32::from(u16::try_from(noise.below(60 * 64)).unwrap()) / 64.0,
        })
        .collect()
}

/// How many triangles visit each pixel.
fn coverage(mesh: &Triangulation, (width, height): (usize, usize)) -> Vec<u32> {
    let mut visits = vec![0; width * height];
    for triangle in mesh.triangles_from(0) {
        scan_lines(&triangle.vertices, |y, first, last| {
            visits[y * width + first..=y * width + last]
                .iter_mut()
                .for_each(|n| *n += 1);
        });
    }
    visits
}

fn rasterise(map: &mut [u16], mesh: &Triangulation, first_new: usize, width: usize) {
    for triangle in mesh.triangles_from(first_new) {
        fill(
            Level::detect(),
            map,
            width,
            [triangle.vertices].into_iter(),
            255 * 64,
        );
    }
}

fn unique(supports: &[Support]) -> usize {
    let mut positions: Vec<_> = supports.iter().map(|support| (support.x, support.y)).collect();
    positions.sort_unstable();
    positions.dedup();
    positions.len()
}

fn sizes() -> impl Strategy<Value = (usize, usize)> {
    prop_oneof![
        (32usize..200, 32usize..200),
        Just((4096, 32)),
        Just((32, 4096)),
        Just((1000, 700))
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_pixel_of_the_window_lies_in_a_triangle(
        size in sizes(),
        (first, more) in (0usize..300, 0usize..200),
        seed in any::<u64>(),
    ) {
        let mut noise = Noise::new(seed);
        let mut mesh = Triangulation::default();
        // What is left of another frame must not matter.
        mesh.rebuild(&draw(&mut noise, 50, (64, 64)), 64, 64);
        let first = draw(&mut noise, first, size);
        mesh.rebuild(&first, size.0, size.1);
        prop_assert!(coverage(&mesh, size).iter().all(|&visits| visits > 0));
        let more = draw(&mut noise, more, size);
        mesh.insert(&more);
        prop_assert!(coverage(&mesh, size).iter().all(|&visits| visits > 0));
        // Random draws hit some pixels twice: those are one vertex.
        prop_assert_eq!(mesh.vertices(), CORNERS + unique(&[first, more].concat()));
    }

    #[test]
    fn rasterising_what_changed_gives_the_map_of_rasterising_all(
        size in (32usize..200, 32usize..200),
        batches in proptest::collection::vec(0usize..80, 1..6),
        seed in any::<u64>(),
    ) {
        let mut noise = Noise::new(seed);
        let mut mesh = Triangulation::default();
        let mut taken = vec![false; size.0 * size.1];
        let (mut map, mut rasterised) = (vec![u16::MAX; size.0 * size.1], 0);
        for (k, &count) in batches.iter().enumerate() {
            let mut batch = draw(&mut noise, count, size);
            batch.retain(|support| !std::mem::replace(&mut taken[support.y * size.0 + support.x], true));
            if k == 0 {
                mesh.rebuild(&batch, size.0, size.1);
            } else {
                mesh.insert(&batch);
            }
            rasterise(&mut map, &mesh, rasterised, size.0);
            rasterised = mesh.vertices();
            let mut all = vec![u16::MAX; size.0 * size.1];
            rasterise(&mut all, &mesh, 0, size.0);
            // A pixel on an edge has the plane of either side, equal but for rounding.
            let differ = map.iter().zip(&all).filter(|(one, other)| one.abs_diff(**other) > 1).count();
            prop_assert_eq!(differ, 0, "batch {}", k);
        }
    }
}

fn support(x: usize, y: usize, disparity_px: f32) -> Support {
    Support { x, y, disparity_px }
}

#[test]
fn corners_take_the_disparity_of_the_nearest_support() {
    let mut mesh = Triangulation::default();
    mesh.rebuild(&[support(10, 10, 3.0), support(80, 40, 8.0)], 100, 60);
    let mut corners = [0.0; CORNERS];
    for Triangle { indices, vertices } in mesh.triangles_from(0) {
        for (index, vertex) in indices
            .into_iter()
            .zip(vertices)
            .filter(|(index, _)| *index < CORNERS)
        {
            assert_eq!(
                (vertex.u, vertex.v),
                [(0.0, 0.0), (99.0, 0.0), (0.0, 59.0), (99.0, 59.0)][index]
            );
            corners[index] = vertex.disparity;
        }
    }
    assert_eq!(corners, [3.0, 8.0, 3.0, 8.0]);
}

#[test]
fn without_supports_the_window_is_two_triangles_at_infinity() {
    let mut mesh = Triangulation::default();
    mesh.rebuild(&[], 40, 32);
    let triangles: Vec<Triangle> = mesh.triangles_from(0).collect();
    assert_eq!(triangles.len(), 2);
    assert!(triangles.iter().all(|triangle| triangle.has_corner()));
    assert!(
        triangles
            .iter()
            .flat_map(|triangle| triangle.vertices)
            .all(|vertex| vertex.disparity == 0.0)
    );
    assert_eq!(mesh.triangles_from(CORNERS).count(), 0);
}

#[test]
fn the_same_pixel_twice_is_one_vertex_with_the_later_disparity() {
    let mut mesh = Triangulation::default();
    mesh.rebuild(
        &[support(20, 20, 5.0), support(20, 20, 5.0), support(30, 12, 6.0)],
        64,
        48,
    );
    mesh.insert(&[support(30, 12, 6.0), support(20, 20, 7.0), support(40, 30, 1.0)]);
    assert_eq!(mesh.vertices(), CORNERS + 3);
    let triangles: Vec<Triangle> = mesh.triangles_from(0).collect();
    let at = |u: f32| {
        let mut vertices = triangles.iter().flat_map(|triangle| triangle.vertices);
        vertices
            .find(|vertex| vertex.u == u)
            .map(|vertex| vertex.disparity)
    };
    assert_eq!([at(20.0), at(30.0), at(40.0)], [Some(7.0), Some(6.0), Some(1.0)]);
    let touches_a_corner = |triangle: &Triangle| {
        triangle
            .vertices
            .iter()
            .any(|vertex| (vertex.u == 0.0 || vertex.u == 63.0) && (vertex.v == 0.0 || vertex.v == 47.0))
    };
    assert!(
        triangles
            .iter()
            .all(|triangle| triangle.has_corner() == touches_a_corner(triangle))
    );
}
