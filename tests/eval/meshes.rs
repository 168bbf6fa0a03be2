//! `cargo eval meshes`: what the mesh that is sent is worth, for several budgets of triangles.
//!
//! The whole ladder is climbed, the mesh is taken as a client gets it, and its triangles are drawn again from the published
//! vertices: nothing of the matcher's own maps is used. Errors are over the pixels with non-occluded ground truth that a
//! triangle covers; coverage is their share of all pixels with such ground truth.

use std::fmt::Write;
use std::time::Instant;

use anyhow::Result;
use stereo::{
    Density, DisparityMap, Level, Matcher, Mesh, MeshParams, Params, Progress, Serial, Shape, StereoPair,
    Vertex,
};

use crate::method::Views;
use crate::source::{Document, KITTI, MIDDLEBURY, Source};

/// Triangles that the mesh may have.
const BUDGETS: [u32; 3] = [500, 2000, 8000];
/// Times a mesh is made; the fastest counts.
const REPEAT: u32 = 20;

pub(crate) fn run(source: &Source) -> Result<()> {
    let mut text = String::from(
        "| data set | budget | triangles sent | within 3 px, % | mean error, px | coverage, % | ms |\n\
         |---|---|---|---|---|---|---|\n",
    );
    for set in [KITTI, MIDDLEBURY] {
        let scenes = source.views(set)?;
        let mut rows = [Figures::default(); BUDGETS.len() + 1];
        for scene in &scenes {
            for (sum, row) in rows.iter_mut().zip(figures(scene)?) {
                sum.add(&row);
            }
        }
        write_rows(&mut text, set.title, scenes.len(), &rows);
    }
    source.publish(Document::Readme, "mesh", &text)
}

/// Means over the scenes of a data set: a row for each budget, then one for the map the meshes are fitted to.
fn write_rows(text: &mut String, title: &str, scenes: usize, rows: &[Figures]) {
    let n = scenes.max(1) as f64;
    let budgets = BUDGETS.map(Some).into_iter().chain([None]);
    for (budget, sum) in budgets.zip(rows) {
        let name = budget.map_or("(the map itself)".to_owned(), |budget| budget.to_string());
        let of_a_mesh = |text: String| budget.map_or(String::new(), |_| text);
        writeln!(
            text,
            "| {title}, {scenes} scenes | {name} | {} | {:.1} | {:.2} | {:.1} | {} |",
            of_a_mesh(format!("{:.0}", sum.triangles / n)),
            sum.within_3_px / n,
            sum.mean_error_px / n,
            sum.coverage / n,
            of_a_mesh(format!("{:.2}", sum.ms / n)),
        )
        .expect("a String takes everything");
    }
}

/// Of one scene: for each budget, then of the map.
fn figures(scene: &Views) -> Result<[Figures; BUDGETS.len() + 1]> {
    let (left, right) = &scene.served;
    let shape = Shape::new(left.width_px(), left.height_px())?;
    let params = Params {
        density: Density::Dense,
        ..Params::default()
    };
    let mut matcher = Matcher::new(Level::detect(), shape, params)?;
    let mut map = DisparityMap::new(shape);
    let pair = StereoPair::new(left.view(), right.view())?;
    let mut progress = matcher.base(pair, &mut map, &Serial)?;
    while !matches!(progress, Progress::Converged(_)) {
        progress = matcher.refine(pair, &mut map, &Serial);
    }
    let truth = &scene.scored.truth.disparity_px;
    let mut rows = [Figures::default(); BUDGETS.len() + 1];
    let mut mesh = Mesh::default();
    for (row, max_triangles) in rows.iter_mut().zip(BUDGETS) {
        let params = MeshParams {
            max_triangles,
            ..MeshParams::default()
        };
        let mut ms = f64::MAX;
        for _ in 0..REPEAT {
            let start = Instant::now();
            matcher.mesh(&params, &mut mesh);
            ms = ms.min(1e3 * start.elapsed().as_secs_f64());
        }
        *row = Figures {
            triangles: mesh.triangles.len() as f64,
            ms,
            ..Figures::of(&draw(&mesh, left.width_px(), left.height_px()), truth)
        };
    }
    let map: Vec<f64> = map.iter_px().map(f64::from).collect();
    rows[BUDGETS.len()] = Figures::of(&map, truth);
    Ok(rows)
}

/// Sums over scenes.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Figures {
    triangles: f64,
    coverage: f64,
    within_3_px: f64,
    mean_error_px: f64,
    ms: f64,
}

impl Figures {
    /// Of a drawn mesh, NaN where it covers nothing; `truth` is 0 where it is unknown.
    fn of(drawn: &[f64], truth: &[f32]) -> Self {
        let (mut known, mut covered, mut within, mut error) = (0.0, 0.0, 0.0, 0.0);
        for (&got, &truth) in drawn.iter().zip(truth).filter(|&(_, &truth)| truth > 0.0) {
            known += 1.0;
            if !got.is_nan() {
                let miss = (got - f64::from(truth)).abs();
                covered += 1.0;
                error += miss;
                within += f64::from(u8::from(miss <= 3.0));
            }
        }
        let share = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
        Self {
            coverage: 100.0 * share(covered, known),
            within_3_px: 100.0 * share(within, covered),
            mean_error_px: share(error, covered),
            ..Self::default()
        }
    }

    fn add(&mut self, other: &Self) {
        self.triangles += other.triangles;
        self.coverage += other.coverage;
        self.within_3_px += other.within_3_px;
        self.mean_error_px += other.mean_error_px;
        self.ms += other.ms;
    }
}

/// The disparity that the mesh has at the middle of every pixel, NaN where it has none.
fn draw(mesh: &Mesh, width: usize, height: usize) -> Vec<f64> {
    let mut drawn = vec![f64::NAN; width * height];
    for triangle in &mesh.triangles {
        let corners = triangle.map(|index| mesh.vertices[index as usize]);
        let [a, b, c] = corners.map(|Vertex { u, v, .. }| (f64::from(u), f64::from(v)));
        let cross = |(ax, ay): (f64, f64), (bx, by): (f64, f64), (px, py): (f64, f64)| {
            (bx - ax) * (py - ay) - (by - ay) * (px - ax)
        };
        let area = cross(a, b, c);
        if area == 0.0 {
            continue;
        }
        for y in pixels([a.1, b.1, c.1], height) {
            for x in pixels([a.0, b.0, c.0], width) {
                let p = (x as f64, y as f64);
                let weights = [cross(b, c, p), cross(c, a, p), cross(a, b, p)].map(|part| part / area);
                if weights.iter().all(|&weight| weight >= -1e-9) {
                    let disparities = corners.map(|vertex| f64::from(vertex.disparity));
                    drawn[y * width + x] = weights
                        .iter()
                        .zip(disparities)
                        .map(|(weight, d)| weight * d)
                        .sum();
                }
            }
        }
    }
    drawn
}

/// The whole numbers below `n` from the least to the most of three.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "kept within 0..n"
)]
fn pixels(at: [f64; 3], n: usize) -> std::ops::RangeInclusive<usize> {
    let [least, most] = [
        at.iter().copied().fold(f64::MAX, f64::min).ceil(),
        at.iter().copied().fold(f64::MIN, f64::max).floor(),
    ];
    let last = (n - 1) as f64;
    least.clamp(0.0, last) as usize..=most.clamp(0.0, last) as usize
}

#[cfg(test)]
mod tests {
    use super::{Figures, draw};
    use stereo::{Mesh, Vertex};

    fn vertex(u: f32, v: f32, disparity: f32) -> Vertex {
        Vertex { u, v, disparity }
    }

    #[test]
    fn a_drawn_triangle_covers_its_pixels_with_its_plane() {
        let mesh = Mesh {
            vertices: vec![
                vertex(1.0, 1.0, 10.0),
                vertex(1.0, 5.0, 18.0),
                vertex(5.0, 1.0, 14.0),
            ],
            triangles: vec![[0, 1, 2]],
        };
        let drawn = draw(&mesh, 8, 7);
        for y in 0..7u8 {
            for x in 0..8u8 {
                let got = drawn[usize::from(y) * 8 + usize::from(x)];
                if x >= 1 && y >= 1 && x + y <= 6 {
                    let plane = 10.0 + f64::from(x - 1) + 2.0 * f64::from(y - 1);
                    assert!((got - plane).abs() < 1e-9, "{x} {y}: {got} for {plane}");
                } else {
                    assert!(got.is_nan(), "{x} {y}: {got}");
                }
            }
        }
    }

    #[test]
    fn what_the_mesh_does_not_cover_is_no_error_but_lowers_the_coverage() {
        let drawn = [10.0, f64::NAN, 14.0, 5.0];
        let figures = Figures::of(&drawn, &[10.5, 10.0, 10.0, 0.0]);
        assert!((figures.coverage - 200.0 / 3.0).abs() < 1e-9);
        assert_eq!((figures.within_3_px, figures.mean_error_px), (50.0, 2.25));
    }
}
