//! Files are read back by the `gltf` crate, which validates them, decodes the texture and resolves the accessors.

use gltf::mesh::Mode;

use super::encode;
use crate::encode::sample::{CAMERA, HEIGHT, Sample, WIDTH};
use crate::job::{ImageEncoding, PixelFormat};

type Imported = (gltf::Document, Vec<gltf::buffer::Data>, Vec<gltf::image::Data>);

fn import(sample: &Sample) -> Imported {
    let file = encode(&sample.frame()).unwrap();
    assert_eq!(
        encode(&sample.frame()).unwrap(),
        file,
        "the same frame is the same file"
    );
    assert_eq!(file.len() % 4, 0);
    gltf::import_slice(&file).unwrap()
}

fn positions((document, buffers, _): &Imported) -> Vec<[f32; 3]> {
    let primitive = document.meshes().next().unwrap().primitives().next().unwrap();
    assert_eq!(primitive.mode(), Mode::Triangles);
    primitive
        .reader(|buffer| Some(&buffers[buffer.index()]))
        .read_positions()
        .unwrap()
        .collect()
}

fn indices((document, buffers, _): &Imported) -> Vec<u32> {
    let primitive = document.meshes().next().unwrap().primitives().next().unwrap();
    primitive
        .reader(|buffer| Some(&buffers[buffer.index()]))
        .read_indices()
        .unwrap()
        .into_u32()
        .collect()
}

fn close(a: [f32; 3], b: [f32; 3]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5)
}

#[test]
fn a_calibrated_mesh_is_in_metres_upright_and_in_front_of_the_camera() {
    let imported = import(&Sample::colour(Some(CAMERA)));
    let got = positions(&imported);
    // Z = 40 px * 0.25 m / disparity: 1 m at 10 px, 2 m at 5 px. The top left corner is 23.5 px left of and 15.5 px
    // above the principal point.
    let expected = [
        [-0.5875, 0.3875, -1.0],
        [-0.5875, -0.3875, -1.0],
        [1.175, -0.775, -2.0],
        [1.175, 0.775, -2.0],
    ];
    for (got, expected) in got.iter().zip(expected) {
        assert!(close(*got, expected), "{got:?} is not {expected:?}");
    }
    let node = imported.0.nodes().next().unwrap();
    assert_eq!(node.transform().decomposed().2, [1.0; 3], "a metre is a metre");
}

#[test]
fn triangles_face_the_camera() {
    for calibration in [Some(CAMERA), None] {
        let imported = import(&Sample::colour(calibration));
        let (points, indices) = (positions(&imported), indices(&imported));
        assert_eq!(indices.len(), 6);
        for triangle in indices.as_chunks::<3>().0 {
            let [a, b, c] = triangle.map(|i| points[i as usize]);
            let (ab, ac) = ([0, 1, 2].map(|i| b[i] - a[i]), [0, 1, 2].map(|i| c[i] - a[i]));
            let normal_z = ab[0] * ac[1] - ab[1] * ac[0];
            assert!(
                normal_z > 0.0,
                "the camera looks along -z, so its side of a triangle has its normal along +z"
            );
        }
    }
}

#[test]
fn an_uncalibrated_mesh_is_an_upright_relief_of_a_millimetre_a_pixel() {
    let imported = import(&Sample::colour(None));
    assert_eq!(
        positions(&imported),
        [
            [0.0, -0.0, 10.0],
            [0.0, -31.0, 10.0],
            [47.0, -31.0, 5.0],
            [47.0, -0.0, 5.0]
        ]
    );
    let scale = imported.0.nodes().next().unwrap().transform().decomposed().2;
    assert_eq!(scale, [0.001; 3]);
}

#[test]
fn the_bounds_are_those_of_the_positions() {
    let imported = import(&Sample::colour(Some(CAMERA)));
    let box_ = imported
        .0
        .meshes()
        .next()
        .unwrap()
        .primitives()
        .next()
        .unwrap()
        .bounding_box();
    for point in positions(&imported) {
        let inside = point
            .iter()
            .zip(box_.min.iter().zip(box_.max))
            .all(|(x, (min, max))| *min <= *x && *x <= max);
        assert!(inside, "{point:?} is not in {box_:?}");
    }
    assert!(
        close(box_.min, [-0.5875, -0.775, -2.0]) && close(box_.max, [1.175, 0.775, -1.0]),
        "{box_:?}"
    );
}

#[test]
fn texture_coordinates_are_at_the_centres_of_the_pixels() {
    let (document, buffers, _) = import(&Sample::colour(Some(CAMERA)));
    let primitive = document.meshes().next().unwrap().primitives().next().unwrap();
    let reader = primitive.reader(|buffer| Some(&buffers[buffer.index()]));
    let uvs: Vec<[f32; 2]> = reader.read_tex_coords(0).unwrap().into_f32().collect();
    assert_eq!(uvs[0], [0.5 / 48.0, 0.5 / 32.0]);
    assert_eq!(uvs[2], [47.5 / 48.0, 31.5 / 32.0]);
}

#[test]
fn the_material_shows_the_image_as_it_is_from_both_sides() {
    let (document, _, images) = import(&Sample::colour(None));
    let material = document.materials().next().unwrap();
    assert!(material.double_sided());
    assert_eq!(
        document.extensions_used().collect::<Vec<_>>(),
        ["KHR_materials_unlit"]
    );
    assert!(material.pbr_metallic_roughness().base_color_texture().is_some());
    let image = &images[0];
    assert_eq!((image.width as usize, image.height as usize), (WIDTH, HEIGHT));
    assert_eq!(image.pixels, Sample::rgb());
}

#[test]
fn a_gray_image_is_a_gray_texture() {
    let mut sample = Sample::new(
        ImageEncoding::Raw(PixelFormat::Mono8),
        vec![0; WIDTH * HEIGHT],
        None,
    );
    for (i, gray) in sample.gray.iter_mut().enumerate() {
        *gray = u8::try_from(i % 251).unwrap();
    }
    let (_, _, images) = import(&sample);
    assert_eq!(images[0].format, gltf::image::Format::R8);
    assert_eq!(images[0].pixels, sample.gray);
}

#[test]
fn an_image_file_is_embedded_as_it_came() {
    let picture = image::RgbImage::from_raw(
        u32::try_from(WIDTH).unwrap(),
        u32::try_from(HEIGHT).unwrap(),
        Sample::rgb(),
    )
    .unwrap();
    for (encoding, format) in [
        (ImageEncoding::Png, image::ImageFormat::Png),
        (ImageEncoding::Jpeg, image::ImageFormat::Jpeg),
    ] {
        let mut file = std::io::Cursor::new(Vec::new());
        picture.write_to(&mut file, format).unwrap();
        let sample = Sample::new(encoding, file.into_inner(), Some(CAMERA));
        let (document, buffers, _) = import(&sample);
        let gltf::image::Source::View { view, mime_type } = document.images().next().unwrap().source() else {
            panic!("the texture is not in the file");
        };
        assert_eq!(mime_type, format.to_mime_type());
        assert_eq!(
            buffers[0][view.offset()..][..view.length()],
            sample.request.left.data[..]
        );
    }
}

#[test]
fn an_empty_mesh_is_a_valid_file_with_an_empty_node() {
    let mut sample = Sample::colour(Some(CAMERA));
    sample.mesh.vertices.clear();
    sample.mesh.triangles.clear();
    let file = encode(&sample.frame()).unwrap();
    let document = gltf::Gltf::from_slice(&file).unwrap();
    assert_eq!(
        (
            document.nodes().count(),
            document.meshes().count(),
            document.accessors().count()
        ),
        (1, 0, 0)
    );
}

#[test]
fn a_vertex_at_infinity_does_not_reach_the_file() {
    let mut sample = Sample::colour(Some(CAMERA));
    sample.mesh.vertices[3].disparity = 0.0;
    let imported = import(&sample);
    assert_eq!(positions(&imported).len(), 3);
    assert_eq!(indices(&imported), [0, 1, 2]);
}

#[test]
fn a_frame_without_a_mesh_is_an_error_of_ours() {
    let sample = Sample::colour(None);
    let frame = crate::job::MatchedFrame {
        mesh: None,
        ..sample.frame()
    };
    assert!(matches!(
        encode(&frame),
        Err(crate::status::ServiceError::Internal(_))
    ));
}
