//! Takes the console in: every file that `make console` has put into `clients/console/dist` becomes a part of the binary. If there are
//! none, the server says how to get them.
#![expect(
    clippy::disallowed_methods,
    reason = "cargo talks to build scripts by environment variables"
)]

use std::error::Error;
use std::fmt::Write as _;
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};

fn main() -> Result<(), Box<dyn Error>> {
    let dist = PathBuf::from(std::env::var("CARGO_MANIFEST_DIR")?).join("../clients/console/dist");
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed={}", dist.display());
    let mut files = Vec::new();
    collect(&dist, &mut files)?;
    files.sort();
    let mut table = String::from("const FILES: &[File] = &[\n");
    for file in files.iter().filter(|file| content_type(file).is_some()) {
        let path = file.strip_prefix(&dist)?.to_str().ok_or("a name isn't UTF-8")?;
        let gzip = PathBuf::from(format!("{}.gz", file.display()));
        let gzip = match files.contains(&gzip) {
            true => format!("Some({})", body(&gzip)?),
            false => "None".to_owned(),
        };
        writeln!(
            table,
            "File {{ path: {:?}, content_type: {:?}, plain: {}, gzip: {gzip} }},",
            format!("/{path}"),
            content_type(file).unwrap_or_default(),
            body(file)?,
        )?;
    }
    table.push_str("];\n");
    fs::write(PathBuf::from(std::env::var("OUT_DIR")?).join("console.rs"), table)?;
    Ok(())
}

/// All files in a folder and those below; none if it doesn't exist.
fn collect(folder: &Path, files: &mut Vec<PathBuf>) -> Result<(), Box<dyn Error>> {
    if !folder.exists() {
        return Ok(());
    }
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            collect(&path, files)?;
        } else {
            files.push(path);
        }
    }
    Ok(())
}

/// The media type of a file that is served; `None` for those that aren't, or only in the place of another.
fn content_type(file: &Path) -> Option<&'static str> {
    match file.extension()?.to_str()? {
        "html" => Some("text/html; charset=utf-8"),
        "js" => Some("text/javascript; charset=utf-8"),
        "css" => Some("text/css; charset=utf-8"),
        "svg" => Some("image/svg+xml"),
        "png" => Some("image/png"),
        "jpg" => Some("image/jpeg"),
        "json" => Some("application/json"),
        _ => None,
    }
}

/// A file's bytes and their tag, as the expression of a `Body`.
fn body(file: &Path) -> Result<String, Box<dyn Error>> {
    let mut hasher = DefaultHasher::new();
    fs::read(file)?.hash(&mut hasher);
    let tag = format!("\"{:016x}\"", hasher.finish());
    let path = file.canonicalize()?;
    let path = path.to_str().ok_or("a name isn't UTF-8")?;
    Ok(format!(
        "Body {{ tag: {tag:?}, bytes: include_bytes!({path:?}) }}"
    ))
}
