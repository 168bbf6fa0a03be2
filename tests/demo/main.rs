//! `cargo demo`: a real pair to a real server over HTTP; writes the disparity, the picture and the mesh, and compares
//! with the ground truth. Then the pair as a camera over Zenoh, and a drive beside it where there is one.

mod camera;
mod film;

use std::fmt::Write as _;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use bytes::Bytes;
use clap::Parser;
use image::{DynamicImage, ImageFormat};
use serde_json::{Value, json};
use stereo_client::{Accept, Client, PairFiles, Reply};
use stereo_tests::dataset::LoadedScene;
use stereo_tests::process::{Launch, Stereod, target_dir};
use stereo_tests::registry_pair::{RegistryPair, calibration};
use stereo_tests::score::{Accuracy, score};

/// A real pair to a real server over HTTP.
#[derive(Debug, Parser)]
struct Args {
    /// Folder for the results; made if it doesn't exist.
    #[arg(long, default_value = "out")]
    out: PathBuf,
    /// End when everything is written, also in a terminal, where the server goes on for a look at the console.
    #[arg(long)]
    once: bool,
}

/// Time enough for the whole ladder on a slow machine.
const LATENCY_BUDGET_MS: u32 = 5000;
/// How long the server may take until its workers are ready.
const READY_WITHIN: Duration = Duration::from_secs(60);

#[tokio::main]
#[expect(clippy::print_stdout, reason = "what this program finds is for reading")]
async fn main() -> Result<()> {
    let args = Args::parse();
    println!("Getting the motorcycle pair (Middlebury 2014, from the Python package scikit-image) ..");
    let pair = RegistryPair::fetch(&target_dir()?)?;
    let scene = pair.load()?;
    println!("Starting the server ..");
    let server = Stereod::launch(&Launch {
        is_apart: true,
        ..Launch::default()
    })?;
    let client = Client::new(server.url())?;
    client.ready(READY_WITHIN).await?;
    println!(
        "Sending {} x {} px to {} ..",
        scene.left.width_px(),
        scene.left.height_px(),
        server.url()
    );
    let demo = Demo {
        client,
        left: read(&pair.left())?,
        right: read(&pair.right())?,
        out: args.out,
    };
    let mut text = demo.run(&scene).await?;
    println!("Streaming it as a camera over Zenoh ..");
    let camera = camera::Camera::connect(server.url(), film::Film::pair(&scene)).await?;
    text += &camera.measure().await?;
    println!("{text}");
    if std::io::stdout().is_terminal() && !args.once {
        let drive = match film::Film::drive()? {
            Some(film) => Some(camera::Camera::connect(server.url(), film).await?),
            None => None,
        };
        let cameras = if drive.is_some() {
            "the cameras `demo` and `drive`"
        } else {
            "the camera `demo`"
        };
        println!(
            "Look at {}/ : the console matches pairs of yours, and shows {cameras} live. Ctrl-C ends it all.",
            server.url()
        );
        let driving = async {
            match &drive {
                Some(drive) => drive.play().await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            ended = camera.play() => ended?,
            ended = driving => ended?,
            pressed = tokio::signal::ctrl_c() => pressed?,
        }
        if let Some(drive) = drive {
            drive.close().await?;
        }
    }
    camera.close().await?;
    let status = server.stop()?;
    ensure!(status.success(), "the server ended with {status}");
    println!("The server stopped cleanly.");
    Ok(())
}

struct Demo {
    client: Client,
    left: Bytes,
    right: Bytes,
    out: PathBuf,
}

impl Demo {
    /// Asks for everything, writes it, and says what there is to see.
    async fn run(&self, scene: &LoadedScene) -> Result<String> {
        std::fs::create_dir_all(&self.out).with_context(|| format!("can't make {}", self.out.display()))?;
        let disparity = self.ask("dense", Accept::DisparityPng).await?;
        let report = self.ask("dense", Accept::Json).await?;
        let written = [
            self.write("disparity.png", &disparity)?,
            self.write("disparity_color.png", &self.ask("dense", Accept::ColorPng).await?)?,
            self.write("mesh.glb", &self.ask("dense", Accept::Glb).await?)?,
            self.write("report.json", &report)?,
        ];
        let report: Value = serde_json::from_slice(&report.body)?;
        let semi_dense = self.ask("semi_dense", Accept::DisparityPng).await?;
        let edges = score(
            &disparity_px(&semi_dense)?,
            &scene.left,
            &scene.truth.disparity_px,
        )
        .edges;
        let dense = score(&disparity_px(&disparity)?, &scene.left, &scene.truth.disparity_px).dense;

        let mut text = String::from("\nReport (times in ms)\n");
        for (name, value) in report["report"]
            .as_object()
            .context("the report has another form")?
        {
            writeln!(text, "  {name:20} {}", short(value))?;
        }
        text.push_str("\nAccuracy against the ground truth (non-occluded pixels), within 3 px\n");
        for (name, part) in [
            ("high-gradient pixels, semi-dense", edges),
            ("all pixels, dense", dense),
        ] {
            writeln!(text, "  {name:33} {}", percentages(&part))?;
        }
        text.push_str("\nWritten\n");
        for (path, what) in written.iter().zip([
            "16-bit disparity, px * 256, 0 = none (KITTI's convention)",
            "the same in colours: any image viewer",
            "textured mesh in metres: drop it on https://gltf-viewer.donmccurdy.com, or open it in Blender or f3d",
            "what was done and how long it took",
        ]) {
            writeln!(text, "  {:28} {what}", path.display())?;
        }
        text.push('\n');
        Ok(text)
    }

    async fn ask(&self, density: &str, accept: Accept) -> Result<Reply> {
        let options = json!({
            "latency_budget_ms": LATENCY_BUDGET_MS,
            "density": density,
            "calibration": {
                "focal_px": calibration::FOCAL_PX,
                "cx_px": calibration::CX_PX,
                "cy_px": calibration::CY_PX,
                "baseline_m": calibration::BASELINE_M,
                "doffs_px": calibration::DOFFS_PX,
            },
        });
        let files = PairFiles {
            left: self.left.clone(),
            right: self.right.clone(),
            options_json: Some(options.to_string()),
        };
        Ok(self.client.match_files(files, accept).await?)
    }

    fn write(&self, name: &str, reply: &Reply) -> Result<PathBuf> {
        let path = self.out.join(name);
        std::fs::write(&path, &reply.body).with_context(|| format!("can't write {}", path.display()))?;
        Ok(path)
    }
}

fn read(path: &Path) -> Result<Bytes> {
    Ok(std::fs::read(path)
        .with_context(|| format!("can't read {}", path.display()))?
        .into())
}

/// The disparities of a 16-bit PNG in px, 0 = none.
fn disparity_px(png: &Reply) -> Result<Vec<f32>> {
    match image::load_from_memory_with_format(&png.body, ImageFormat::Png)? {
        DynamicImage::ImageLuma16(gray) => Ok(gray.pixels().map(|p| f32::from(p.0[0]) / 256.0).collect()),
        other => anyhow::bail!("the disparity is no 16-bit gray PNG but {:?}", other.color()),
    }
}

fn percentages(part: &Accuracy) -> String {
    format!(
        "density {:5.1} %, right of the returned {:5.1} %, right of all {:5.1} %",
        part.density, part.returned[1], part.all[1]
    )
}

/// A value as people read it: numbers with three decimals at most, texts without quotes.
fn short(value: &Value) -> String {
    match value {
        Value::String(text) if text.is_empty() => "-".to_owned(),
        Value::String(text) => text.clone(),
        Value::Number(number) if number.is_f64() => format!("{:.3}", number.as_f64().unwrap_or(f64::NAN)),
        other => other.to_string(),
    }
}
