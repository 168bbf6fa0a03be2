use std::path::{Path, PathBuf};

use super::find_scenes;

/// A fresh folder below the build's own temporary directory.
fn fresh_folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("stereo-dataset-{}-{name}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder for the test");
    folder
}

fn put_gray(path: &Path, value: u8) {
    std::fs::create_dir_all(path.parent().expect("below the test's folder")).expect("a folder");
    image::GrayImage::from_pixel(40, 32, image::Luma([value]))
        .save(path)
        .expect("a PNG");
}

fn put_truth(path: &Path, px: u16) {
    std::fs::create_dir_all(path.parent().expect("below the test's folder")).expect("a folder");
    let image: image::ImageBuffer<image::Luma<u16>, Vec<u16>> =
        image::ImageBuffer::from_pixel(40, 32, image::Luma([px * 256]));
    image.save(path).expect("a 16-bit PNG");
}

#[test]
fn prepared_scenes_are_found_with_their_number_of_disparities() {
    let root = fresh_folder("prepared");
    for scene in ["set/b", "set/a"] {
        put_gray(&root.join(scene).join("left.png"), 1);
        put_gray(&root.join(scene).join("right.png"), 2);
        put_truth(&root.join(scene).join("gt_noc.png"), 7);
    }
    std::fs::write(root.join("set/a/meta.json"), r#"{"ndisp": 150}"#).expect("meta.json");
    let scenes = find_scenes(&root).expect("two scenes");
    assert_eq!(
        scenes.iter().map(|s| s.name.as_str()).collect::<Vec<_>>(),
        ["set/a", "set/b"]
    );
    assert_eq!(scenes[0].disparities().expect("said in meta.json"), 160);
    assert_eq!(scenes[1].disparities().expect("the default"), 128);
    let loaded = scenes[0].load().expect("three readable files");
    assert_eq!(
        (
            loaded.left.pixels()[0],
            loaded.right.pixels()[0],
            loaded.truth.disparity_px[0]
        ),
        (1, 2, 7.0)
    );
    // The folder of one data set is as good a root as the folder of all.
    assert_eq!(find_scenes(&root.join("set")).expect("the same two").len(), 2);
    std::fs::remove_dir_all(root).expect("the test's own folder");
}

#[test]
fn kitti_is_found_as_downloaded() {
    for (truth, left, right) in [
        ("disp_noc", "colored_0", "colored_1"),
        ("disp_noc", "image_0", "image_1"),
        ("disp_noc_0", "image_2", "image_3"),
    ] {
        let root = fresh_folder(&format!("kitti-{left}"));
        put_truth(&root.join("training").join(truth).join("000003_10.png"), 9);
        put_gray(&root.join("training").join(left).join("000003_10.png"), 3);
        put_gray(&root.join("training").join(right).join("000003_10.png"), 4);
        put_gray(&root.join("training").join(left).join("000003_11.png"), 5);
        let scenes = find_scenes(&root).expect("one scene");
        assert_eq!(scenes.len(), 1, "{left}");
        let loaded = scenes[0].load().expect("three readable files");
        assert_eq!(
            (
                loaded.left.pixels()[0],
                loaded.right.pixels()[0],
                loaded.truth.disparity_px[5]
            ),
            (3, 4, 9.0)
        );
        std::fs::remove_dir_all(root).expect("the test's own folder");
    }
}

#[test]
fn middlebury_and_eth3d_keep_only_what_their_mask_calls_visible() {
    for (disparity, calib) in [
        ("disp0.pfm", "ndisp=260\n"),
        ("disp0GT.pfm", "0 PINHOLE 40 32 1 1 1 1\n"),
    ] {
        let root = fresh_folder(disparity);
        let scene = root.join("Adirondack");
        put_gray(&scene.join("im0.png"), 3);
        put_gray(&scene.join("im1.png"), 4);
        let mut mask = image::GrayImage::from_pixel(40, 32, image::Luma([255]));
        mask.put_pixel(1, 0, image::Luma([128]));
        mask.save(scene.join("mask0nocc.png")).expect("a mask");
        let mut pfm = b"Pf\n40 32\n-1\n".to_vec();
        pfm.extend((0..40 * 32).flat_map(|_| 5.5_f32.to_le_bytes()));
        std::fs::write(scene.join(disparity), pfm).expect("a PFM");
        std::fs::write(scene.join("calib.txt"), calib).expect("calib.txt");
        let scenes = find_scenes(&root).expect("one scene");
        assert_eq!(
            scenes[0].load().expect("readable").truth.disparity_px[..3],
            [5.5, 0.0, 5.5]
        );
        let expected = if disparity == "disp0.pfm" { 272 } else { 128 };
        assert_eq!(scenes[0].disparities().expect("a number"), expected);
        std::fs::remove_dir_all(root).expect("the test's own folder");
    }
}
