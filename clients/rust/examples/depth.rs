//! Two image files to a picture of the depth.

use stereo_client::{Accept, Client, PairFiles};

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let [left, right, server] = <[String; 3]>::try_from(Vec::from_iter(std::env::args().skip(1)))
        .map_err(|_| "usage: depth LEFT RIGHT SERVER")?;
    let files = PairFiles {
        left: std::fs::read(left)?.into(),
        right: std::fs::read(right)?.into(),
        options_json: Some(r#"{"latency_budget_ms": 200, "density": "dense"}"#.to_owned()),
    };
    let reply = Client::new(&server)?.match_files(files, Accept::ColorPng).await?;
    std::fs::write("depth.png", &reply.body)?;
    Ok(())
}
