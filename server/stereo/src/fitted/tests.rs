use super::{Source, planned, write};
use crate::FIXED_PER_PX;
use crate::frame::Window;
use crate::image::Roi;
use crate::mesh::{Mesh, MeshParams};
use crate::output_mesh::{Evidence, Writer};
use crate::simd::Level;
use crate::surface::Surface;

const WIDTH: usize = 384;
const HEIGHT: usize = 256;

/// The mesh of a map given by its disparities in px; every pixel is textured and confirmed.
fn mesh(params: &MeshParams, disparity_px: impl Fn(usize, usize) -> u16) -> Mesh {
    let map: Vec<u16> = (0..WIDTH * HEIGHT)
        .map(|at| disparity_px(at % WIDTH, at / WIDTH) * FIXED_PER_PX)
        .collect();
    let pixels = [vec![1; WIDTH * HEIGHT], vec![200; WIDTH * HEIGHT]];
    let roi = Roi {
        x: 0,
        y: 0,
        width: WIDTH,
        height: HEIGHT,
    };
    let evidence = Evidence {
        window: Window {
            roi,
            min_disparity_px: 0,
            disparities: 128,
        },
        mask: &pixels[0],
        disparity: &map,
        confidence: &pixels[1],
        confirmed_from: 100,
    };
    let source = Source {
        map: &map,
        width: WIDTH,
        is_guess: false,
    };
    let mut meshes = Level::available().into_iter().map(|level| {
        let (mut surface, mut writer) = (Surface::default(), Writer::default());
        // What is there already stays and doesn't count.
        let mut out = Mesh::default();
        out.triangles.push([0, 0, 0]);
        write(
            level,
            (&mut surface, &mut writer),
            source,
            evidence,
            params,
            &mut out,
        );
        assert_eq!(out.triangles.remove(0), [0, 0, 0]);
        out
    });
    let mesh = meshes.next().unwrap();
    assert!(meshes.all(|other| other == mesh), "all levels agree");
    mesh
}

fn budget(max_triangles: u32) -> MeshParams {
    MeshParams {
        max_triangles,
        ..MeshParams::default()
    }
}

/// Discs before a wall: no triangle across a rim holds.
fn discs(x: usize, y: usize) -> u16 {
    let from = |at: usize| (at % 64).abs_diff(32);
    if from(x).pow(2) + from(y).pow(2) < 500 {
        60
    } else {
        10
    }
}

#[test]
fn a_budget_is_for_the_triangles_that_are_sent() {
    for triangles in [500, 1000, 2000] {
        let sent = mesh(&budget(triangles), discs).triangles.len();
        let triangles = triangles as usize;
        assert!(
            sent <= triangles && 2 * sent >= triangles,
            "{sent} of {triangles}"
        );
    }
}

#[test]
fn of_a_mesh_within_the_budget_no_more_is_made() {
    let complete = mesh(&budget(MeshParams::MAX_TRIANGLES), discs);
    assert_eq!(
        mesh(
            &budget(u32::try_from(4 * complete.triangles.len()).unwrap()),
            discs
        ),
        complete
    );
}

#[test]
fn with_what_does_not_hold_the_budget_is_the_plan() {
    let params = MeshParams {
        keep_rejected: true,
        ..budget(500)
    };
    let sent = mesh(&params, discs).triangles.len();
    assert!((400..=500).contains(&sent), "{sent}");
}

#[test]
fn more_is_planned_the_less_holds_up_to_four_times_the_budget() {
    assert_eq!([1.0, 0.93].map(|share| planned(1000, share)), [1000, 1000]);
    assert!(
        (1580..1600).contains(&planned(1000, 0.5)),
        "{}",
        planned(1000, 0.5)
    );
    assert_eq!([0.1, 0.0].map(|share| planned(1000, share)), [4000, 4000]);
    assert_eq!(planned(1_000_000, 0.0), 4_000_000);
}
