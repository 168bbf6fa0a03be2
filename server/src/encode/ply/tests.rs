//! Files are read back by the `ply-rs-bw` crate.

use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{DefaultElement, Encoding, Ply, Property};

use super::encode;
use crate::encode::sample::{CAMERA, Sample, WIDTH};

fn read(sample: &Sample) -> Ply<DefaultElement> {
    let file = encode(&sample.frame()).unwrap();
    assert_eq!(
        encode(&sample.frame()).unwrap(),
        file,
        "the same frame is the same file"
    );
    Parser::<DefaultElement>::new()
        .read_ply(&mut file.as_slice())
        .unwrap()
}

fn float(element: &DefaultElement, name: &str) -> f32 {
    match element[name] {
        Property::Float(value) => value,
        ref other => panic!("{name} is {other:?}"),
    }
}

fn byte(element: &DefaultElement, name: &str) -> u8 {
    match element[name] {
        Property::UChar(value) => value,
        ref other => panic!("{name} is {other:?}"),
    }
}

fn points(ply: &Ply<DefaultElement>) -> Vec<[f32; 3]> {
    ply.payload["vertex"]
        .iter()
        .map(|v| ["x", "y", "z"].map(|axis| float(v, axis)))
        .collect()
}

#[test]
fn a_calibrated_mesh_is_in_metres_in_the_cameras_frame() {
    let ply = read(&Sample::colour(Some(CAMERA)));
    assert_eq!(ply.header.encoding, Encoding::BinaryLittleEndian);
    assert!(
        ply.header
            .comments
            .iter()
            .any(|c| c.contains("metres") && c.contains("y down")),
        "{:?}",
        ply.header
    );
    assert_eq!(
        points(&ply),
        [
            [-0.5875, -0.3875, 1.0],
            [-0.5875, 0.3875, 1.0],
            [1.175, 0.775, 2.0],
            [1.175, -0.775, 2.0]
        ]
    );
    let faces: Vec<&Property> = ply.payload["face"]
        .iter()
        .map(|face| &face["vertex_indices"])
        .collect();
    assert_eq!(
        faces,
        [
            &Property::ListInt(vec![0, 1, 2]),
            &Property::ListInt(vec![0, 2, 3])
        ]
    );
}

#[test]
fn an_uncalibrated_mesh_is_in_pixels_with_the_nearer_part_at_smaller_z() {
    let ply = read(&Sample::colour(None));
    assert!(
        ply.header.comments.iter().any(|c| c.contains("px")),
        "{:?}",
        ply.header
    );
    assert_eq!(
        points(&ply),
        [
            [0.0, 0.0, -10.0],
            [0.0, 31.0, -10.0],
            [47.0, 31.0, -5.0],
            [47.0, 0.0, -5.0]
        ]
    );
}

#[test]
fn vertices_have_the_colour_of_their_pixel() {
    let mut sample = Sample::colour(None);
    (sample.mesh.vertices[1].u, sample.mesh.vertices[1].v) = (2.4, 30.6);
    let ply = read(&sample);
    let rgb = Sample::rgb();
    let pixels = rgb.as_chunks::<3>().0;
    let expected = [
        pixels[0],
        pixels[31 * WIDTH + 2],
        pixels[31 * WIDTH + 47],
        pixels[47],
    ];
    let got: Vec<[u8; 3]> = ply.payload["vertex"]
        .iter()
        .map(|v| ["red", "green", "blue"].map(|name| byte(v, name)))
        .collect();
    assert_eq!(got, expected);
}

#[test]
fn an_empty_mesh_is_a_valid_file() {
    let mut sample = Sample::colour(Some(CAMERA));
    sample.mesh.vertices.clear();
    sample.mesh.triangles.clear();
    let ply = read(&sample);
    assert_eq!(
        (
            ply.header.elements["vertex"].count,
            ply.header.elements["face"].count
        ),
        (0, 0)
    );
}
