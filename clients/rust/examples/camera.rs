//! Sends one pair again and again as a camera, and prints what comes back.
#![expect(clippy::print_stdout, reason = "that is what it is for")]

use std::time::Duration;

use stereo_client::Fleet;
use stereo_client::v1::{Image, ImageEncoding, StereoRequest};

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let [left, right, router] = <[String; 3]>::try_from(Vec::from_iter(std::env::args().skip(1)))
        .map_err(|_| "usage: camera LEFT RIGHT tcp/ROUTER:7447")?;
    let image = |file: String| -> std::io::Result<Image> {
        let data = std::fs::read(file)?.into();
        Ok(Image {
            encoding: ImageEncoding::Png.into(),
            data,
            ..Image::default()
        })
    };
    let pair = StereoRequest {
        left: Some(image(left)?),
        right: Some(image(right)?),
        ..StereoRequest::default()
    };
    let fleet = Fleet::connect(&[&router]).await?;
    let results = fleet.results("front").await?;
    let camera = fleet.camera("front").await?;
    camera.until_served(Duration::from_secs(5)).await?;
    for sequence in 1..=30 {
        camera
            .send(&StereoRequest {
                sequence: Some(sequence),
                ..pair.clone()
            })
            .await?;
        let report = results
            .next_within(Duration::from_secs(5))
            .await?
            .report
            .unwrap_or_default();
        println!("frame {sequence}: {} by {}", report.rung, report.instance);
    }
    Ok(())
}
