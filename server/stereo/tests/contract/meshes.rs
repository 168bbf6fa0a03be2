//! The mesh of every rung.

use stereo::{DisparityMap, Mesh, MeshParams, Params, Progress, Serial};

use super::{Pair, climb, matcher};

#[test]
fn the_mesh_lies_on_the_wall_and_faces_the_camera() {
    let pair = Pair::with_disparity(200, 120, |_| 23);
    let mut matcher = matcher(pair.shape(), Params::default());
    climb(&mut matcher, &pair, &Serial);
    let mut mesh = Mesh::default();
    matcher.mesh(&MeshParams::default(), &mut mesh);
    assert!(!mesh.triangles.is_empty());
    let mut used = vec![false; mesh.vertices.len()];
    let mut area = 0.0;
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|index| mesh.vertices[index as usize]);
        triangle.iter().for_each(|&index| used[index as usize] = true);
        let twice_area = (b.u - a.u) * (c.v - a.v) - (b.v - a.v) * (c.u - a.u);
        assert!(
            twice_area < 0.0,
            "counter-clockwise with y up is negative with v down: {twice_area}"
        );
        area -= twice_area / 2.0;
        // The leftmost 23 columns have no counterpart in the right view, and windows reach a little further.
        assert!(
            [a, b, c]
                .iter()
                .all(|vertex| vertex.u < 32.0 || (vertex.disparity - 23.0).abs() < 1.5)
        );
    }
    assert!(used.iter().all(|&used| used), "every vertex is used");
    assert!(area > 0.6 * 200.0 * 120.0, "{area}");
}

#[test]
fn no_rungs_mesh_has_more_triangles_than_its_budget_and_a_larger_one_is_used() {
    let pair = Pair::with_disparity(320, 200, |y| 8 + i64::try_from(y / 10 % 4 * 5).unwrap());
    for params in [Params::default(), Params::fast(), Params::paper()] {
        let mut matcher = matcher(pair.shape(), params);
        let mut out = DisparityMap::new(pair.shape());
        let mut progress = matcher.base(pair.views(), &mut out, &Serial).unwrap();
        loop {
            if progress != Progress::Working {
                let mut mesh = Mesh::default();
                let counts = [100, 150, 400, 100_000].map(|max_triangles| {
                    let limits = MeshParams {
                        max_triangles,
                        keep_rejected: true,
                        ..MeshParams::default()
                    };
                    limits.validate().unwrap();
                    matcher.mesh(&limits, &mut mesh);
                    assert!(mesh.triangles.len() <= max_triangles as usize);
                    mesh.triangles.len()
                });
                // Ties at the end of a budget are left out together.
                assert!(counts[0] > 50 && counts[2] > 200 && counts[3] > 300, "{counts:?}");
            }
            if matches!(progress, Progress::Converged(_)) {
                break;
            }
            progress = matcher.refine(pair.views(), &mut out, &Serial);
        }
    }
}

#[test]
fn a_rungs_mesh_is_confirmed_by_its_own_frame() {
    let wall = Pair::with_disparity(240, 160, |_| 17);
    let noise = Pair::with_disparity(240, 160, |y| 7 * i64::try_from(y % 9).unwrap());
    for params in [Params::default(), Params::fast(), Params::paper()] {
        let first_mesh = |before: Option<&Pair>| {
            let mut matcher = matcher(wall.shape(), params.clone());
            if let Some(before) = before {
                climb(&mut matcher, before, &Serial);
            }
            let mut out = DisparityMap::new(wall.shape());
            matcher.base(wall.views(), &mut out, &Serial).unwrap();
            let mut mesh = Mesh::default();
            matcher.mesh(&MeshParams::default(), &mut mesh);
            mesh
        };
        let alone = first_mesh(None);
        // All but the part that the right view does not see.
        assert!(
            alone.triangles.len() > 20,
            "{:?}: {}",
            params.preset,
            alone.triangles.len()
        );
        assert_eq!(alone, first_mesh(Some(&noise)), "{:?}", params.preset);
    }
}

#[test]
fn nonsense_about_meshes_is_refused() {
    let is_refused = |change: fn(&mut MeshParams)| {
        let mut params = MeshParams::default();
        change(&mut params);
        params.validate().is_err()
    };
    assert_eq!(MeshParams::default().validate(), Ok(()));
    assert!(is_refused(|params| params.tolerance_px = 0.09));
    assert!(is_refused(|params| params.tolerance_px = f32::NAN));
    assert!(is_refused(|params| params.max_triangles = 99));
    assert!(is_refused(|params| params.max_triangles = 1_000_001));
    assert!(is_refused(|params| params.max_disparity_step_px = 65.0));
    assert!(is_refused(|params| params.min_valid_share = -0.1));
}

#[test]
fn triangles_across_a_jump_are_left_out_unless_asked_for() {
    let pair = Pair::with_disparity(240, 160, |y| if y < 80 { 5 } else { 45 });
    let mut matcher = matcher(pair.shape(), Params::default());
    climb(&mut matcher, &pair, &Serial);
    let (mut kept, mut all) = (Mesh::default(), Mesh::default());
    matcher.mesh(&MeshParams::default(), &mut kept);
    matcher.mesh(
        &MeshParams {
            keep_rejected: true,
            ..MeshParams::default()
        },
        &mut all,
    );
    let spread = |mesh: &Mesh| {
        mesh.triangles.iter().fold(0.0f32, |most, triangle| {
            let d = triangle.map(|index| mesh.vertices[index as usize].disparity);
            most.max(d.iter().fold(f32::MIN, |a, &b| a.max(b)) - d.iter().fold(f32::MAX, |a, &b| a.min(b)))
        })
    };
    assert!(spread(&all) > 35.0, "the whole mesh spans the jump");
    assert!(spread(&kept) < 20.0, "{}", spread(&kept));
}
