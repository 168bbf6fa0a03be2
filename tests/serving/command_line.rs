//! The command line, `stereo`, against the real server.

use std::path::PathBuf;
use std::process::{Command, Output};

use serde_json::Value;
use stereo_tests::process::{client_binary, target_dir};

use crate::conversation::{PAIR, Server, png16};

/// Ends with its output; `args` after `--server`, whose address is `server`.
pub(crate) fn stereo(server: &str, args: &[&str]) -> Said {
    let output = Command::new(client_binary().expect("a binary that builds"))
        .args(["--server", server])
        .args(args)
        .env("NO_COLOR", "1")
        .output()
        .expect("a program that cargo has built");
    Said(output)
}

/// What it said.
pub(crate) struct Said(Output);

impl Said {
    pub(crate) fn new(output: Output) -> Self {
        Self(output)
    }

    pub(crate) fn stdout(&self) -> String {
        String::from_utf8(self.0.stdout.clone()).expect("text")
    }

    pub(crate) fn stderr(&self) -> String {
        String::from_utf8(self.0.stderr.clone()).expect("text")
    }

    /// The objects of its lines, all of which are JSON.
    pub(crate) fn json(&self) -> Vec<Value> {
        let text = self.stdout();
        let lines = text
            .lines()
            .map(|line| serde_json::from_str(line).unwrap_or_else(|why| panic!("{why}: {line}")));
        lines.collect()
    }

    /// Asserts how it ended: exit code and words, on standard error if it is a failure.
    pub(crate) fn assert(&self, code: i32, words: &[&str]) {
        let (stdout, stderr) = (self.stdout(), self.stderr());
        assert_eq!(self.0.status.code(), Some(code), "{stdout}{stderr}");
        let text = if code == 0 { &stdout } else { &stderr };
        for word in words {
            assert!(text.contains(word), "{word:?} isn't in {stdout}{stderr}");
        }
    }
}

/// An empty folder of a test's own, removed when dropped.
pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(crate) fn new(name: &str) -> Self {
        let folder = target_dir()
            .expect("cargo has built this")
            .join(format!("tmp/command-line-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder in the target folder");
        Self(folder)
    }

    pub(crate) fn path(&self, name: &str) -> String {
        let path = self.0.join(name);
        path.to_str()
            .expect("the target folder's path is text")
            .to_owned()
    }

    pub(crate) fn write(&self, name: &str, data: &[u8]) -> String {
        let path = self.0.join(name);
        std::fs::create_dir_all(path.parent().expect("a file in a folder")).expect("a folder");
        std::fs::write(path, data).expect("room for a small file");
        self.path(name)
    }

    /// The test pair `count` times, as `left/` and `right/`.
    pub(crate) fn pairs(&self, count: u32) {
        for i in 0..count {
            self.write(&format!("left/{i:06}.png"), &PAIR.left);
            self.write(&format!("right/{i:06}.png"), &PAIR.right);
        }
    }

    fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.0.join(name)).unwrap_or_else(|why| panic!("{name}: {why}"))
    }

    fn names(&self, name: &str) -> Vec<String> {
        let entries = std::fs::read_dir(self.0.join(name)).expect("a folder");
        let mut names: Vec<String> = entries
            .map(|entry| {
                entry
                    .expect("readable")
                    .file_name()
                    .to_string_lossy()
                    .into_owned()
            })
            .collect();
        names.sort();
        names
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        drop(std::fs::remove_dir_all(&self.0));
    }
}

fn two_files(folder: &Folder) -> [String; 2] {
    [
        folder.write("left.png", &PAIR.left),
        folder.write("right.png", &PAIR.right),
    ]
}

#[tokio::test]
async fn two_files_are_matched_and_written_as_the_server_would() {
    let server = Server::start(&[]);
    server.until_ready().await;
    let folder = Folder::new("match");
    let [left, right] = two_files(&folder);
    let out = folder.path("out");
    let kinds = "png,color,pfm,npy,ply,glb";
    let said = stereo(
        server.process.url(),
        &["match", &left, &right, "--budget", "60s", "-o", &out, "-f", kinds],
    );
    said.assert(0, &["left: 3 of 3 iterations", "of 60000 ms", "density"]);
    let expected = server.good().await.png16();
    assert!(png16(&folder.read("out/left_disparity.png")) == expected);
    let px: Vec<f32> = folder.read("out/left_disparity.npy")[128..]
        .as_chunks::<4>()
        .0
        .iter()
        .map(|&bytes| f32::from_le_bytes(bytes))
        .collect();
    for (px, fixed) in px.iter().zip(&expected) {
        assert!(if *fixed == 0 {
            px.is_nan()
        } else {
            *px == f32::from(*fixed) / 256.0
        });
    }
    assert_eq!(px.len(), expected.len());
    assert!(
        folder
            .read("out/left_disparity.pfm")
            .starts_with(b"Pf\n512 320\n-1.0\n")
    );
    let color = image::load_from_memory(&folder.read("out/left_color.png")).expect("a PNG");
    assert_eq!((color.width(), color.height()), (512, 320));
    let (document, buffers, images) =
        gltf::import_slice(folder.read("out/left_mesh.glb")).expect("a valid GLB");
    let mesh = document.meshes().next().expect("a mesh");
    let primitive = mesh.primitives().next().expect("triangles");
    let reader = primitive.reader(|buffer| Some(&buffers[buffer.index()]));
    let (vertices, corners) = (
        reader.read_positions().expect("positions").count(),
        reader.read_indices().expect("indices").into_u32().count(),
    );
    assert_eq!((images[0].width, images[0].height), (512, 320));
    let header = String::from_utf8_lossy(&folder.read("out/left_mesh.ply")).into_owned();
    for line in [
        format!("element vertex {vertices}\n"),
        format!("element face {}\n", corners / 3),
    ] {
        assert!(vertices > 100 && header.contains(&line), "{line}");
    }
}

#[tokio::test]
async fn a_file_is_of_the_kind_that_its_ending_says() {
    let server = Server::start(&[]);
    let folder = Folder::new("ending");
    let [left, right] = two_files(&folder);
    let file = folder.path("x.glb");
    let options = r#"{"latency_budget_ms": 60000, "preset": "fast", "max_iterations": 1}"#;
    let said = stereo(
        server.process.url(),
        &[
            "match",
            &left,
            &right,
            "--options",
            options,
            "-o",
            &file,
            "--json",
        ],
    );
    said.assert(0, &[]);
    let [line] = said.json().try_into().expect("one line");
    assert_eq!(line["report"]["iterations_run"], 1);
    assert_eq!(line["report"]["rung"], "mesh-16");
    assert_eq!(line["files"][0], file);
    assert!(folder.read("x.glb").starts_with(b"glTF"));
}

#[tokio::test]
async fn with_a_calibration_the_mesh_is_in_metres() {
    let server = Server::start(&[]);
    let folder = Folder::new("calibration");
    let [left, right] = two_files(&folder);
    let camera = folder.write(
        "right.yaml",
        b"projection_matrix:\n  rows: 3\n  cols: 4\n  data: [400., 0., 256., -40., 0., 400., 160., 0., 0., 0., 1., 0.]\n",
    );
    let file = folder.path("mesh.ply");
    let args = ["match", &left, &right, "--budget", "60s", "-o", &file];
    stereo(server.process.url(), &args).assert(0, &[]);
    assert!(String::from_utf8_lossy(&folder.read("mesh.ply")).contains("comment not calibrated"));
    let calibrated = [&args[..], &["--calibration", &camera]].concat();
    stereo(server.process.url(), &calibrated).assert(0, &[]);
    assert!(String::from_utf8_lossy(&folder.read("mesh.ply")).contains("comment metres"));
    let wrong = [&args[..], &["--calibration", &left]].concat();
    stereo(server.process.url(), &wrong).assert(2, &["--calibration", "camera_info"]);
}

#[tokio::test]
async fn a_folder_is_matched_pair_by_pair_and_the_worst_counts() {
    let server = Server::start(&[]);
    let folder = Folder::new("folder");
    folder.write("image_2/2.png", &PAIR.left);
    folder.write("image_3/2.png", &PAIR.right);
    folder.write("image_2/10.png", b"no image");
    folder.write("image_3/10.png", &PAIR.right);
    let said = stereo(
        server.process.url(),
        &[
            "match",
            &folder.path(""),
            "--budget",
            "60s",
            "--json",
            "-o",
            &folder.path("out"),
        ],
    );
    said.assert(1, &[]);
    let lines = said.json();
    assert_eq!(
        (&lines[0]["pair"], &lines[0]["report"]["deadline_met"]),
        (&"2".into(), &true.into())
    );
    assert_eq!(
        (&lines[1]["pair"], &lines[1]["error"]),
        (&"10".into(), &"failed".into())
    );
    assert_eq!(lines[2]["exit_code"], 1);
    assert_eq!(folder.names("out"), ["2_color.png", "2_disparity.png"]);
}

#[tokio::test]
async fn a_budget_that_is_too_small_ends_with_4_and_says_what_would_do() {
    let server = Server::start(&[]);
    server.until_ready().await;
    let folder = Folder::new("late");
    let [left, right] = two_files(&folder);
    let args = ["match", &left, &right, "--budget", "0.001ms"];
    stereo(server.process.url(), &args).assert(4, &["refused with", "(HTTP 504)", "at least"]);
    let said = stereo(server.process.url(), &[&args[..], &["--json"]].concat());
    assert_eq!(
        (&said.json()[0]["error"], &said.json()[0]["exit_code"]),
        (&"refused".into(), &4.into())
    );
}

#[tokio::test]
async fn images_of_different_sizes_are_refused_with_4() {
    let server = Server::start(&[]);
    let folder = Folder::new("sizes");
    let left = folder.write("left.png", &PAIR.left);
    let small = stereo_tests::gray::GrayImage::new(64, 64, vec![7; 64 * 64]).expect("64 x 64 pixels");
    let right = folder.write("right.png", &small.to_png().expect("a small image"));
    stereo(server.process.url(), &["match", &left, &right, "--budget", "60s"])
        .assert(4, &["512 x 320", "64 x 64"]);
}

#[test]
fn nobody_at_the_address_ends_with_3() {
    let folder = Folder::new("nobody");
    let [left, right] = two_files(&folder);
    folder.pairs(1);
    let all = folder.path("");
    let commands: [&[&str]; 6] = [
        &["match", &left, &right],
        &["batch", &all],
        &["info"],
        &["bench"],
        &["watch", "--once"],
        &["stream", &all],
    ];
    for command in commands {
        // Port 1 is reserved and nobody listens there.
        stereo("http://127.0.0.1:1", command).assert(3, &["error:", "no answer from"]);
    }
    let said = stereo("http://127.0.0.1:1", &["info", "--json"]);
    assert_eq!(
        (&said.json()[0]["error"], &said.json()[0]["exit_code"]),
        (&"unreachable".into(), &3.into())
    );
    stereo("http://127.0.0.1:1", &["doctor"]).assert(3, &["begin with the first"]);
    stereo("tcp/127.0.0.1:1", &["info"]).assert(3, &["127.0.0.1:1"]);
}

#[test]
fn wrong_use_ends_with_2_and_says_what_is_right() {
    let folder = Folder::new("usage");
    let [left, right] = two_files(&folder);
    folder.write("empty/readme.txt", b"");
    let empty = folder.path("empty");
    let cases: [(&[&str], &str); 9] = [
        (&["match"], "<LEFT>"),
        (&["match", &left], "give the right one too"),
        (&["match", &empty], "left/ and right/"),
        (&["match", &left, &right, "--budget", "50"], "such as 50ms"),
        (
            &["match", &left, &right, "--options", "{\"colour\": 1}"],
            "colour",
        ),
        (&["match", &left, &right, "--preset", "best"], "best"),
        (&["match", &left, &right, "-f", "png"], "--output"),
        (&["stream", &empty, "--camera", "a/b"], "letters, digits"),
        (&["frob"], "frob"),
    ];
    for (args, word) in cases {
        stereo("http://127.0.0.1:1", args).assert(2, &[word]);
        let said = stereo("http://127.0.0.1:1", &[args, &["--json"]].concat());
        assert_eq!(
            (&said.json()[0]["error"], &said.json()[0]["exit_code"]),
            (&"usage".into(), &2.into())
        );
    }
    stereo("host:8080", &["info"]).assert(2, &["http://127.0.0.1:8080"]);
    stereo("tcp/127.0.0.1:1", &["batch", &folder.path("")]).assert(2, &["--server http://"]);
}

#[tokio::test]
async fn a_batch_answers_every_pair_and_names_those_that_could_not_be_read() {
    let server = Server::start(&[]);
    let folder = Folder::new("batch");
    folder.pairs(5);
    let args = [
        "batch",
        &folder.path(""),
        "-o",
        &folder.path("out"),
        "-f",
        "png",
        "--json",
    ];
    let said = stereo(server.process.url(), &args);
    said.assert(0, &[]);
    let lines = said.json();
    assert_eq!(lines.len(), 6);
    assert_eq!((&lines[5]["pairs"], &lines[5]["matched"]), (&5.into(), &5.into()));
    let expected = server.good().await.png16();
    for name in ["000000", "000004"] {
        assert!(png16(&folder.read(&format!("out/{name}_disparity.png"))) == expected);
    }
    folder.write("left/000001.png", b"no image");
    let said = stereo(server.process.url(), &["batch", &folder.path("")]);
    said.assert(1, &["000001: ", "neither a PNG nor a JPEG"]);
    assert!(
        said.stdout().contains("4 of 5 pairs matched"),
        "{}",
        said.stdout()
    );
}

#[tokio::test]
async fn info_says_what_the_server_is() {
    let server = Server::start(&["--instance", "north"]);
    server.until_ready().await;
    stereo(server.process.url(), &["info"]).assert(
        0,
        &["called north, ready", "workers  1", "preset   fast: mesh-16"],
    );
    let said = stereo(server.process.url(), &["info", "--json"]);
    let [line] = said.json().try_into().expect("one line");
    assert_eq!(line["info"]["instance"], "north");
    assert_eq!(line["readiness"]["status"], "ready");
}

#[tokio::test]
async fn bench_counts_every_pair_in_both_loops() {
    let server = Server::start(&[]);
    server.until_ready().await;
    for (how, value) in [("--rate", "20"), ("--concurrency", "2")] {
        let args = [
            "bench",
            "--size",
            "64x64",
            how,
            value,
            "--duration",
            "500ms",
            "--budget",
            "60s",
            "--json",
        ];
        let said = stereo(server.process.url(), &args);
        said.assert(0, &[]);
        let [line] = said.json().try_into().expect("one line");
        let count = |name: &str| line[name].as_u64().expect("a count");
        assert_eq!(count("answered"), count("sent"), "{line}");
        assert!(count("sent") >= 2, "{line}");
        let ms = |name: &str| line["latency_ms"][name].as_f64().expect("a time");
        assert!(
            0.05 < ms("p50") && ms("p50") <= ms("p99") && ms("p99") <= ms("max"),
            "{line}"
        );
    }
    let args = [
        "bench",
        "--size",
        "64x64",
        "--duration",
        "100ms",
        "--budget",
        "0.001ms",
    ];
    stereo(server.process.url(), &args).assert(4, &["(HTTP 504)"]);
}
