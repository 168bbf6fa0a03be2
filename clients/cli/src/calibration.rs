//! Calibrations from the files that cameras and data sets come with.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use stereo_client::v1;

use crate::failure::Failure;

/// What can be given, for whoever gave something else.
const KINDS: &str = "give JSON with focal_px, cx_px, cy_px, baseline_m and doffs_px, KITTI's text with P0 to P3 or P_rect_00 to P_rect_03, \
                     Middlebury's with cam0, cam1 and baseline, or ROS' camera_info of the right camera";

/// Projection matrices of both cameras after rectification, row by row.
struct Projections {
    left: [f64; 12],
    right: [f64; 12],
}

/// The calibration in one file, or in two of ROS: the left camera's and the right one's. `left_image` says which of KITTI's cameras it was.
pub(crate) fn read(files: &[PathBuf], left_image: &Path) -> Result<Option<v1::Calibration>, Failure> {
    let (calibration, file) = match files {
        [] => return Ok(None),
        [file] => (one(&text_of(file)?, left_image), file),
        [left, right] => {
            let both = ros(&text_of(left)?).zip(ros(&text_of(right)?));
            (
                both.map(|(left, right)| Projections { left, right }.calibration()),
                left,
            )
        }
        [_, _, third, ..] => {
            return Err(Failure::usage(format!(
                "--calibration {} is one too many: give one file, or ROS' camera_info of the left and of the right camera",
                third.display()
            )));
        }
    };
    let wrong = |why: &str| Failure::usage(format!("--calibration {} {why}: {KINDS}", file.display()));
    let calibration = calibration.ok_or_else(|| wrong("is no calibration of a known kind"))?;
    let numbers = [
        calibration.focal_px,
        calibration.cx_px,
        calibration.cy_px,
        calibration.baseline_m,
        calibration.doffs_px,
    ];
    if !numbers.iter().all(|number| number.is_finite()) || calibration.focal_px <= 0.0 {
        return Err(wrong("has no focal length above 0"));
    }
    if calibration.baseline_m <= 0.0 {
        // ROS' left camera_info alone has none, and swapped cameras a negative one.
        return Err(wrong(
            "has no distance between the cameras, or left and right are swapped",
        ));
    }
    Ok(Some(calibration))
}

fn text_of(file: &Path) -> Result<String, Failure> {
    std::fs::read(file)
        .map(|bytes| String::from_utf8_lossy(&bytes).into_owned())
        .map_err(|why| {
            Failure::usage(format!(
                "--calibration {} can't be read ({why}): name a file",
                file.display()
            ))
        })
}

fn one(text: &str, left_image: &Path) -> Option<v1::Calibration> {
    json(text)
        .or_else(|| kitti(text, left_image).map(|both| both.calibration()))
        .or_else(|| middlebury(text))
        .or_else(|| {
            let right = ros(text)?;
            // Of the right camera alone: the left one differs by the shift.
            let mut left = right;
            left[3] = 0.0;
            Some(Projections { left, right }.calibration())
        })
}

/// As options have it, and `stereod match --calibration`.
#[derive(Deserialize)]
struct Json {
    focal_px: f64,
    #[serde(alias = "cx")]
    cx_px: f64,
    #[serde(alias = "cy")]
    cy_px: f64,
    baseline_m: f64,
    #[serde(default)]
    doffs_px: f64,
}

fn json(text: &str) -> Option<v1::Calibration> {
    let Json {
        focal_px,
        cx_px,
        cy_px,
        baseline_m,
        doffs_px,
    } = serde_json::from_str(text).ok()?;
    Some(v1::Calibration {
        focal_px,
        cx_px,
        cy_px,
        baseline_m,
        doffs_px,
    })
}

/// `P2: 7.07e+02 0 ..`: cameras 0 and 1 are gray, 2 and 3 colour.
fn kitti(text: &str, left_image: &Path) -> Option<Projections> {
    let matrix = |camera: u8| {
        let names = [format!("P{camera}:"), format!("P_rect_{camera:02}:")];
        let rest = text.lines().find_map(|line| {
            names
                .iter()
                .find_map(|name| line.trim().strip_prefix(name.as_str()))
        })?;
        numbers(rest)
    };
    let folder = left_image.parent().and_then(Path::file_name).unwrap_or_default();
    let is_gray = ["image_0", "image_00"].iter().any(|name| folder == *name);
    let pair = |left, right| {
        Some(Projections {
            left: matrix(left)?,
            right: matrix(right)?,
        })
    };
    match is_gray {
        true => pair(0, 1),
        false => pair(2, 3).or_else(|| pair(0, 1)),
    }
}

/// `cam0=[3979.911 0 1244.772; 0 3979.911 1019.507; 0 0 1]`, `baseline=193.001` in mm.
fn middlebury(text: &str) -> Option<v1::Calibration> {
    let value = |name: &str| {
        let mut lines = text.lines().filter_map(|line| line.split_once('='));
        lines.find_map(|(found, value)| (found.trim() == name).then(|| value.trim()))
    };
    let left: [f64; 9] = numbers(value("cam0")?)?;
    let right: [f64; 9] = numbers(value("cam1")?)?;
    let baseline_mm: f64 = value("baseline")?.parse().ok()?;
    Some(v1::Calibration {
        focal_px: left[0],
        cx_px: left[2],
        cy_px: left[5],
        baseline_m: baseline_mm / 1e3,
        doffs_px: right[2] - left[2],
    })
}

/// The projection matrix of a `sensor_msgs/CameraInfo`: as `camera_calibration` writes it to a file, or as `ros2 topic echo` prints it.
fn ros(text: &str) -> Option<[f64; 12]> {
    let mut lines = text.lines();
    let same_line = lines.find_map(|line| {
        let (name, rest) = line.trim().split_once(':')?;
        ["p", "P", "projection_matrix"].contains(&name).then_some(rest)
    })?;
    let mut matrix = same_line.to_owned();
    for line in lines {
        // The numbers are the first that stand in a list.
        let line = line.trim();
        match line.split_once(':') {
            Some(("data", rest)) => matrix.push_str(rest),
            Some(("rows" | "cols", _)) => {}
            Some(_) => break,
            None => matrix.push_str(line),
        }
        matrix.push(' ');
    }
    numbers(&matrix.replace("- ", " "))
}

/// Exactly so many numbers, whatever stands between them.
fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let parts = text.split(|c: char| c.is_whitespace() || "[],;".contains(c));
    let found: Result<Vec<f64>, _> = parts.filter(|part| !part.is_empty()).map(str::parse).collect();
    found.ok()?.try_into().ok()
}

impl Projections {
    fn calibration(&self) -> v1::Calibration {
        let Self { left, right } = self;
        v1::Calibration {
            focal_px: left[0],
            cx_px: left[2],
            cy_px: left[6],
            baseline_m: (left[3] - right[3]) / left[0],
            doffs_px: right[2] - left[2],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(text: &str, left_image: &str, expected: [f64; 5]) {
        let found = one(text, Path::new(left_image)).unwrap();
        let numbers = [
            found.focal_px,
            found.cx_px,
            found.cy_px,
            found.baseline_m,
            found.doffs_px,
        ];
        for (number, expected) in numbers.iter().zip(expected) {
            assert!((number - expected).abs() < 1e-6, "{numbers:?}");
        }
    }

    #[test]
    fn json_has_the_names_of_options_or_of_data_sets() {
        close(
            r#"{"focal_px": 700, "cx": 300, "cy_px": 200, "baseline_m": 0.5, "frames": 3}"#,
            "",
            [700.0, 300.0, 200.0, 0.5, 0.0],
        );
    }

    #[test]
    fn of_kittis_four_cameras_it_is_those_of_the_images() {
        let text = "P0: 700 0 300 0 0 700 200 0 0 0 1 0\nP1: 7e2 0 300 -350 0 700 200 0 0 0 1 0\n\
                    P2: 700 0 310 70 0 700 200 0 0 0 1 0\nP3: 700 0 311 -350 0 700 200 0 0 0 1 0\n";
        close(text, "x/image_0/1.png", [700.0, 300.0, 200.0, 0.5, 0.0]);
        close(text, "x/image_2/1.png", [700.0, 310.0, 200.0, 0.6, 1.0]);
        let raw = "calib_time: 09-Jan-2012\nP_rect_00: 700 0 300 0 0 700 200 0 0 0 1 0\nP_rect_01: 700 0 300 -350 0 700 200 0 0 0 1 0\n";
        close(raw, "left.png", [700.0, 300.0, 200.0, 0.5, 0.0]);
    }

    #[test]
    fn middlebury_is_in_millimetres() {
        let text = "cam0=[3979.911 0 1244.772; 0 3979.911 1019.507; 0 0 1]\ncam1=[3979.911 0 1369.115; 0 3979.911 1019.507; 0 0 1]\n\
                    doffs=124.343\nbaseline=193.001\nwidth=2964\nheight=2000\n";
        close(
            text,
            "im0.png",
            [3979.911, 1244.772, 1019.507, 0.193_001, 124.343],
        );
    }

    #[test]
    fn the_right_camera_info_of_ros_has_it_all() {
        let file = "camera_name: right\nprojection_matrix:\n  rows: 3\n  cols: 4\n  data: [700., 0., 300., -84.,\n         0., 700., 200., 0.,\n\
                    \x20        0., 0., 1., 0.]\nimage_width: 640\n";
        close(file, "", [700.0, 300.0, 200.0, 0.12, 0.0]);
        let echoed = "k:\n- 1.0\n- 2.0\np:\n- 700.0\n- 0.0\n- 300.0\n- -84.0\n- 0.0\n- 700.0\n- 200.0\n- 0.0\n- 0.0\n- 0.0\n- 1.0\n- 0.0\nbinning_x: 0\n";
        close(echoed, "", [700.0, 300.0, 200.0, 0.12, 0.0]);
    }

    #[test]
    fn what_is_none_is_told_what_would_be_one() {
        let folder = std::env::temp_dir().join(format!("stereo-calibration-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let left = "P: [700, 0, 300, 0, 0, 700, 200, 0, 0, 0, 1, 0]\n";
        for (text, words) in [
            ("nothing", "no calibration of a known kind"),
            ("P: [1, 2]", "no calibration of a known kind"),
            (left, "no distance between the cameras"),
            (
                r#"{"focal_px": 0, "cx": 1, "cy": 1, "baseline_m": 1}"#,
                "no focal length",
            ),
        ] {
            let file = folder.join("calibration");
            std::fs::write(&file, text).unwrap();
            let failure = read(std::slice::from_ref(&file), Path::new("")).unwrap_err();
            assert!(failure.message.contains(words), "{failure}");
            assert!(failure.message.contains("camera_info"), "{failure}");
        }
        let right = folder.join("right");
        std::fs::write(folder.join("left"), left).unwrap();
        std::fs::write(&right, "P: [700, 0, 302, -84, 0, 700, 200, 0, 0, 0, 1, 0]\n").unwrap();
        let both = read(&[folder.join("left"), right], Path::new(""))
            .unwrap()
            .unwrap();
        assert_eq!((both.baseline_m, both.doffs_px), (0.12, 2.0));
        std::fs::remove_dir_all(folder).unwrap();
    }
}
