use super::{Evidence, Facet, Writer};
use crate::FIXED_PER_PX;
use crate::frame::Window;
use crate::image::Roi;
use crate::interpolate::fill;
use crate::mesh::{Mesh, MeshParams};
use crate::scene::Noise;
use crate::simd::Level;
use crate::support::Support;
use crate::triangulation::Triangulation;

const WIDTH: usize = 64;
const HEIGHT: usize = 48;
const CONFIRMED_FROM: u8 = 61;

/// A mesh whose every pixel is textured and confirmed.
struct Scene {
    triangulation: Triangulation,
    mask: Vec<u8>,
    interpolated: Vec<u16>,
    disparity: Vec<u16>,
    confidence: Vec<u8>,
}

impl Scene {
    fn of(supports: &[Support]) -> Self {
        let mut triangulation = Triangulation::default();
        triangulation.rebuild(supports, WIDTH, HEIGHT);
        let mut interpolated = vec![0; WIDTH * HEIGHT];
        for triangle in triangulation.triangles_from(0) {
            fill(
                Level::detect(),
                &mut interpolated,
                WIDTH,
                [triangle.vertices].into_iter(),
                255 * FIXED_PER_PX,
            );
        }
        Self {
            triangulation,
            mask: vec![1; WIDTH * HEIGHT],
            disparity: interpolated.clone(),
            interpolated,
            confidence: vec![CONFIRMED_FROM; WIDTH * HEIGHT],
        }
    }

    /// Supports every 10 px whose disparity depends on the column.
    fn of_columns(disparity_px: impl Fn(usize) -> f32) -> Self {
        let at = |k: usize| (7 + k % 5 * 10, 5 + k / 5 * 10);
        let supports: Vec<Support> = (0..20)
            .map(|k| Support {
                x: at(k).0,
                y: at(k).1,
                disparity_px: disparity_px(at(k).0),
            })
            .collect();
        Self::of(&supports)
    }

    fn write(&self, params: &MeshParams) -> Mesh {
        let evidence = Evidence {
            window: Window {
                roi: Roi {
                    x: 100,
                    y: 30,
                    width: WIDTH,
                    height: HEIGHT,
                },
                min_disparity_px: 20,
                disparities: 256,
            },
            mask: &self.mask,
            disparity: &self.disparity,
            confidence: &self.confidence,
            confirmed_from: CONFIRMED_FROM,
        };
        let mut meshes = Level::available().into_iter().map(|level| {
            let facets = self.triangulation.triangles_from(0).map(Facet::from);
            let vertices = self.triangulation.vertices();
            let mut mesh = Mesh::default();
            Writer::default().write(level, (vertices, facets), evidence, params, &mut mesh);
            mesh
        });
        let mesh = meshes.next().unwrap();
        assert!(meshes.all(|other| other == mesh), "all levels agree");
        mesh
    }

    /// Triangles kept, and all there are.
    fn kept(&self, params: &MeshParams) -> (usize, usize) {
        (
            self.write(params).triangles.len(),
            self.triangulation.triangles_from(0).count(),
        )
    }
}

const KEEP: MeshParams = MeshParams {
    keep_rejected: true,
    max_disparity_step_px: 4.0,
    min_valid_share: 0.5,
    tolerance_px: 1.0,
    max_triangles: 1000,
};
const STRICT: MeshParams = MeshParams {
    keep_rejected: false,
    ..KEEP
};

fn has_a_corner(mesh: &Mesh, triangle: [u32; 3]) -> bool {
    let vertices = triangle.map(|index| mesh.vertices[index as usize]);
    vertices
        .iter()
        .any(|vertex| [100.0, 163.0].contains(&vertex.u) && [30.0, 77.0].contains(&vertex.v))
}

#[test]
fn a_confirmed_surface_is_kept_whole_in_the_images_pixels_and_faces_the_camera() {
    let mesh = Scene::of_columns(|_| 6.0).write(&STRICT);
    assert_eq!(mesh, Scene::of_columns(|_| 6.0).write(&KEEP));
    assert_eq!(mesh.vertices.len(), 24);
    let mut area = 0.0;
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|index| mesh.vertices[index as usize]);
        let turn = (b.u - a.u) * (c.v - a.v) - (b.v - a.v) * (c.u - a.u);
        assert!(turn < 0.0, "clockwise with v down");
        area -= turn / 2.0;
    }
    assert_eq!(area, 63.0 * 47.0);
    let extent = |at: fn(&crate::mesh::Vertex) -> f32| {
        let values = mesh.vertices.iter().map(at);
        (
            values.clone().fold(f32::MAX, f32::min),
            values.fold(f32::MIN, f32::max),
        )
    };
    assert_eq!(
        [extent(|v| v.u), extent(|v| v.v), extent(|v| v.disparity)],
        [(100.0, 163.0), (30.0, 77.0), (26.0, 26.0)]
    );
}

#[test]
fn a_surface_steeper_than_one_px_per_px_is_left_out_even_if_confirmed() {
    // Columns 27 and 37 have different disparities; the triangles between them are the ones of interest.
    let across = |mesh: &Mesh| {
        let spans = |triangle: &[u32; 3]| {
            let disparities = triangle.map(|index| mesh.vertices[index as usize].disparity);
            disparities.iter().any(|&disparity| disparity != disparities[0])
        };
        let triangles = mesh.triangles.iter().filter(|triangle| spans(triangle));
        triangles
            .filter(|&&triangle| !has_a_corner(mesh, triangle))
            .count()
    };
    for (step_px, kept) in [(11.0, 0), (9.0, 6)] {
        let scene = Scene::of_columns(|x| if x < 30 { 2.0 } else { 2.0 + step_px });
        assert_eq!(
            (across(&scene.write(&STRICT)), across(&scene.write(&KEEP))),
            (kept, 6)
        );
    }
}

#[test]
fn a_textured_triangle_needs_its_share_of_confirmed_pixels() {
    let share = |min_valid_share| MeshParams {
        min_valid_share,
        ..STRICT
    };
    let mut scene = Scene::of_columns(|_| 6.0);
    scene.confidence.fill(CONFIRMED_FROM - 1);
    assert_eq!(scene.kept(&STRICT).0, 0);
    assert_eq!(scene.kept(&share(0.0)).0, scene.kept(&KEEP).1);
    // Validated, but at another disparity than the mesh's.
    scene.confidence.fill(254);
    scene
        .disparity
        .iter_mut()
        .for_each(|fixed| *fixed += FIXED_PER_PX);
    assert_eq!(scene.kept(&STRICT).0, scene.kept(&KEEP).1);
    scene.disparity.iter_mut().for_each(|fixed| *fixed += 1);
    assert_eq!(scene.kept(&STRICT).0, 0);
    let coarse = MeshParams {
        tolerance_px: 1.5,
        ..STRICT
    };
    assert_eq!(
        scene.kept(&coarse).0,
        scene.kept(&KEEP).1,
        "a mesh that may be coarse is not refused for it"
    );
    // About seven pixels in ten.
    let mut noise = Noise::new(9);
    scene.disparity.copy_from_slice(&scene.interpolated);
    scene
        .confidence
        .iter_mut()
        .for_each(|confidence| *confidence = if noise.below(10) < 7 { 254 } else { 0 });
    let kept = [0.4, 0.7, 0.95].map(|min| scene.kept(&share(min)).0);
    assert!(
        kept[0] == scene.kept(&KEEP).1 && kept[0] > kept[1] && kept[1] > kept[2],
        "{kept:?}"
    );
}

#[test]
fn a_triangle_without_texture_is_judged_by_its_step_and_never_reaches_a_corner() {
    let step = |max_disparity_step_px| MeshParams {
        max_disparity_step_px,
        ..STRICT
    };
    let mut scene = Scene::of_columns(|x| if x < 30 { 2.0 } else { 8.0 });
    scene.mask.fill(0);
    scene.confidence.fill(0);
    let counts = [5.9, 6.0].map(|max| {
        let mesh = scene.write(&step(max));
        assert!(
            mesh.triangles
                .iter()
                .all(|&triangle| !has_a_corner(&mesh, triangle))
        );
        mesh.triangles.len()
    });
    // 3 x 4 squares between the supports; those of one column span the step.
    assert!(counts[0] >= 18 && counts[1] >= counts[0] + 6, "{counts:?}");
    // Three textured pixels are too few to tell, whatever they say.
    scene.mask[20 * WIDTH + 20..][..3].fill(1);
    assert_eq!(scene.kept(&step(6.0)).0, counts[1]);
    assert_eq!(scene.kept(&KEEP).0, scene.kept(&KEEP).1);
}
