//! What the paper prints: *High-Performance and Tunable Stereo Reconstruction* (Pillai, Ramalingam, Leonard, ICRA 2016),
//! measured there on an Intel i7-3920XM; and our figures beside it.

use std::fmt::Write as _;

use stereo_tests::score::mean;

use crate::table::{Row, Table};

/// A row of tables II and III: KITTI, within 2, 3, 4, 5 px of the truth over high-gradient pixels in %, and ms.
struct Accuracy {
    method: &'static str,
    within: [f64; 4],
    ms: f64,
}

const TABLES_2_AND_3: [Accuracy; 6] = [
    Accuracy {
        method: "SGBM",
        within: [89.0, 93.9, 95.6, 96.5],
        ms: 351.9,
    },
    Accuracy {
        method: "ELAS",
        within: [92.7, 96.1, 97.3, 97.9],
        ms: 160.9,
    },
    Accuracy {
        method: "Line-Sweep",
        within: [72.6, 81.2, 84.7, 86.7],
        ms: 70.0,
    },
    Accuracy {
        method: "Ours-1",
        within: [83.1, 89.9, 92.9, 94.7],
        ms: 10.8,
    },
    Accuracy {
        method: "Ours-2",
        within: [83.5, 90.2, 93.2, 94.9],
        ms: 28.9,
    },
    Accuracy {
        method: "Ours-4",
        within: [85.4, 91.4, 94.0, 95.5],
        ms: 58.2,
    },
];

/// Table IV: ms at 320x240, 640x480, 800x600, 1280x720 and 1920x1080; SGBM first.
const TABLE_4: [(&str, [f64; 5]); 5] = [
    ("SGBM", [53.4, 216.7, 360.0, 763.7, 1873.7]),
    ("ELAS", [22.7, 107.2, 170.3, 332.7, 650.9]),
    ("Ours-1", [3.0, 8.2, 10.9, 18.2, 35.9]),
    ("Ours-2", [6.4, 19.2, 27.4, 46.0, 81.0]),
    ("Ours-4", [18.7, 64.9, 99.2, 172.9, 287.2]),
];

/// Table V: within 3 px of SGBM in %, with the cameras BumbleBee2 and ZED.
pub(crate) const TABLE_5: [(&str, [f64; 2]); 4] = [
    ("ELAS", [81.1, 91.6]),
    ("Line-Sweep", [83.9, 77.2]),
    ("Ours-1", [89.6, 87.5]),
    ("Ours-2", [90.8, 87.3]),
];

/// Table IV's rows, with `columns` columns of the same sizes and an empty one for KITTI.
pub(crate) fn times_by_size(columns: usize) -> String {
    let sgbm = TABLE_4[0].1;
    let mut text = String::new();
    for (method, times_ms) in TABLE_4 {
        write!(text, "| *paper, printed: {method}* |").expect("a String takes everything");
        for (ms, sgbm_ms) in times_ms.iter().zip(sgbm).take(columns) {
            write!(text, " *{ms:.1} ({:.1}x)* |", sgbm_ms / ms).expect("a String takes everything");
        }
        text.push_str(" |\n");
    }
    text
}

/// Tables II and III: the printed rows, then everything semi-dense of `measured`.
pub(crate) fn accuracy(measured: &Table) -> String {
    let mut text = String::from(
        "| method | <2 px | <3 px | <4 px | <5 px | density | ms | Hz | x SGBM |\n|---|---|---|---|---|---|---|---|---|\n",
    );
    let mut line = |name: &str, within: [f64; 4], density: &str, ms: f64, sgbm_ms: Option<f64>| {
        let within = within.map(|share| format!("{share:.1}")).join(" | ");
        let ratio = sgbm_ms.map_or_else(String::new, |sgbm| format!("{:.1}", sgbm / ms));
        writeln!(
            text,
            "| {name} | {within} | {density} | {ms:.1} | {:.1} | {ratio} |",
            1e3 / ms
        )
        .expect("a String takes everything");
    };
    for row in &TABLES_2_AND_3 {
        let name = format!("*paper, printed: {}*", row.method);
        line(
            &name,
            row.within,
            "not printed",
            row.ms,
            Some(TABLES_2_AND_3[0].ms),
        );
    }
    let is_dense = |row: &&Row| row.name.ends_with(" dense") || row.name.contains(" conf ");
    for row in measured.rows.iter().filter(|row| !is_dense(row)) {
        let edges = mean(&row.scores).edges;
        let density = format!("{:.1}", edges.density);
        line(
            &row.name,
            edges.returned,
            &density,
            row.match_ms(),
            measured.sgbm_ms(),
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::{TABLES_2_AND_3, accuracy, times_by_size};
    use crate::table::{Row, Table};
    use stereo_tests::score::Score;

    #[test]
    fn the_printed_speed_ups_are_the_papers() {
        let text = times_by_size(5);
        assert!(
            text.contains("| *paper, printed: Ours-1* | *3.0 (17.8x)*"),
            "{text}"
        );
        assert!(text.lines().all(|line| line.matches('|').count() == 8), "{text}");
    }

    #[test]
    fn printed_rows_come_first_and_dense_ones_are_left_out() {
        let row = |name: &str| Row {
            name: name.to_owned(),
            scores: vec![Score::default()],
            times_ms: vec![(2.0, 2.0)],
        };
        let rows = vec![
            row("stereod fast 1 it semi_dense"),
            row("stereod fast 1 it dense"),
            row("OpenCV 5.0.0 sgbm"),
        ];
        let text = accuracy(&Table { scenes: 1, rows });
        assert_eq!(text.lines().count(), 2 + TABLES_2_AND_3.len() + 2);
        assert!(text.contains(
            "| *paper, printed: Ours-1* | 83.1 | 89.9 | 92.9 | 94.7 | not printed | 10.8 | 92.6 | 32.6 |"
        ));
        assert!(
            text.contains(
                "| stereod fast 1 it semi_dense | 0.0 | 0.0 | 0.0 | 0.0 | 0.0 | 2.0 | 500.0 | 1.0 |"
            )
        );
    }
}
