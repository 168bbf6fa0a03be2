use std::collections::HashSet;

use super::Surface;
use crate::FIXED_PER_PX;
use crate::mesh::Vertex;
use crate::scene::Noise;
use crate::simd::Level;

/// What a mesh may cost.
#[derive(Clone, Copy)]
struct Limits {
    tolerance_px: f32,
    triangles: usize,
}

/// The mesh of a map given by its disparities in 1/64 px.
fn fit(
    (width, height): (usize, usize),
    limits: Limits,
    fixed: impl FnMut(usize, usize) -> u16,
) -> (Vec<u16>, Vec<[Vertex; 3]>) {
    let mut fixed = fixed;
    let map: Vec<u16> = (0..width * height)
        .map(|at| fixed(at % width, at / width))
        .collect();
    let mut meshes = Level::available().into_iter().map(|level| {
        let mut surface = Surface::default();
        surface.fit(level, &map, width, limits.tolerance_px);
        surface.cut(limits.triangles);
        surface
            .facets(false)
            .map(|facet| facet.vertices)
            .collect::<Vec<_>>()
    });
    let mesh = meshes.next().unwrap();
    assert!(meshes.all(|other| other == mesh), "all levels agree");
    (map, mesh)
}

fn limits(tolerance_px: f32, triangles: usize) -> Limits {
    Limits {
        tolerance_px,
        triangles,
    }
}

fn twice_area([a, b, c]: &[Vertex; 3]) -> f32 {
    (b.u - a.u) * (c.v - a.v) - (b.v - a.v) * (c.u - a.u)
}

/// Distances in px of the map from the mesh, at the middle of every triangle.
fn misses(map: &[u16], width: usize, mesh: &[[Vertex; 3]]) -> Vec<f32> {
    let middle = |[a, b, c]: &[Vertex; 3], at: fn(&Vertex) -> f32| (at(a) + at(b) + at(c)) / 3.0;
    mesh.iter()
        .map(|triangle| {
            let (u, v) = (middle(triangle, |p| p.u), middle(triangle, |p| p.v));
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "in the map"
            )]
            let at = v.round() as usize * width + u.round() as usize;
            (middle(triangle, |p| p.disparity) - f32::from(map[at]) / f32::from(FIXED_PER_PX)).abs()
        })
        .collect()
}

#[test]
fn a_plane_needs_two_triangles_a_root_square() {
    for (size, roots) in [
        ((640, 480), 3 * 2),
        ((741, 500), 3 * 2),
        ((64, 40), 1),
        ((4096, 4096), 16),
    ] {
        let (_, mesh) = fit(size, limits(1.0, 100_000), |x, y| {
            u16::try_from(2000 + 3 * x + 2 * y).unwrap()
        });
        assert_eq!(mesh.len(), 2 * roots, "{size:?}");
    }
}

#[test]
fn whatever_is_chosen_is_a_mesh_without_cracks_that_covers_the_window() {
    let mut noise = Noise::new(3);
    for size in [(32, 32), (33, 47), (300, 200), (700, 40), (40, 600), (383, 32)] {
        for budget in [100, 333, 1000, 5000, 1_000_000] {
            let (_, mesh) = fit(size, limits(0.5, budget), |x, y| {
                let rough = if x > size.0 / 2 { 3000 } else { 100 };
                u16::try_from(noise.below(rough) + y).unwrap()
            });
            assert!(mesh.len() <= budget, "{size:?}: {} of {budget}", mesh.len());
            let key = |p: &Vertex| (p.u.to_bits(), p.v.to_bits());
            let mut edges = HashSet::new();
            let mut area = 0.0;
            for triangle in &mesh {
                let turn = twice_area(triangle);
                assert!(turn < 0.0, "{size:?}: {triangle:?}");
                area -= f64::from(turn) / 2.0;
                for k in 0..3 {
                    let edge = (key(&triangle[k]), key(&triangle[(k + 1) % 3]));
                    assert!(edges.insert(edge), "two triangles on one side of an edge");
                }
            }
            let (width, height) = size;
            assert_eq!(area, ((width - 1) * (height - 1)) as f64, "{size:?}");
            let last = [width - 1, height - 1].map(|at| (at as f32).to_bits());
            let zero = 0.0f32.to_bits();
            for &(a, b) in &edges {
                let is_border = a.0 == b.0 && [zero, last[0]].contains(&a.0)
                    || a.1 == b.1 && [zero, last[1]].contains(&a.1);
                assert!(is_border || edges.contains(&(b, a)), "{size:?}: a crack");
            }
        }
    }
}

#[test]
fn a_curved_surface_is_met_within_the_tolerance_by_as_few_triangles_as_that_takes() {
    let bowl = |x: usize, y: usize| {
        let (x, y) = (x as f32 - 200.0, y as f32 - 150.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "0 to 5000"
        )]
        let fixed = (640.0 + (x * x + y * y) / 25.0) as u16;
        fixed
    };
    let counts = [0.25, 1.0, 4.0].map(|tolerance_px| {
        let (map, mesh) = fit((400, 300), limits(tolerance_px, 100_000), bowl);
        let worst = misses(&map, 400, &mesh).into_iter().fold(0.0, f32::max);
        assert!(worst < 1.5 * tolerance_px + 0.05, "{tolerance_px}: {worst}");
        mesh.len()
    });
    assert!(
        counts[0] > 2 * counts[1] && counts[1] > 2 * counts[2],
        "{counts:?}"
    );
    assert!(counts[0] < 2000, "{counts:?}");
}

#[test]
fn a_jump_draws_the_triangles_to_itself() {
    let step = |x: usize, _| if x < 150 { 640 } else { 2560 };
    let (_, mesh) = fit((400, 300), limits(1.0, 100_000), step);
    let spans = |triangle: &&[Vertex; 3]| triangle.iter().any(|p| p.disparity != triangle[0].disparity);
    let across = mesh.iter().filter(spans);
    let widest = across
        .flatten()
        .fold(0.0, |most, p| (p.u - 150.0).abs().max(most));
    assert!(widest <= 3.0, "{widest}");
    let far = mesh
        .iter()
        .filter(|triangle| triangle.iter().all(|p| p.u > 260.0));
    assert!(far.count() < 40, "where it is flat there are few");
}

#[test]
fn a_larger_budget_is_nearer_to_the_map() {
    let mut noise = Noise::new(8);
    let blocks: Vec<u16> = (0..400)
        .map(|_| u16::try_from(640 + noise.below(2000)).unwrap())
        .collect();
    let errors = [100, 400, 1600, 6400].map(|budget| {
        let (map, mesh) = fit((400, 300), limits(0.5, budget), |x, y| {
            blocks[y / 20 * 20 + x / 20]
        });
        let weights: Vec<f32> = mesh.iter().map(|triangle| twice_area(triangle).abs()).collect();
        let misses = misses(&map, 400, &mesh);
        misses
            .iter()
            .zip(&weights)
            .map(|(miss, weight)| miss * weight)
            .sum::<f32>()
            / weights.iter().sum::<f32>()
    });
    assert!(errors.is_sorted_by(|a, b| a > b), "{errors:?}");
    assert!(errors[3] < errors[0] / 4.0, "{errors:?}");
}
