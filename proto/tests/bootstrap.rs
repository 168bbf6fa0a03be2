//! Keeps `src/gen`, and the Python client's copy of the descriptor set, equal to what the `.proto` files say.

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

use prost::Message;

/// The descriptor set, here and in the Python package.
const DESCRIPTOR_SET: &str = "stereo.v1.binpb";
const PYTHON_PACKAGE: &str = "../clients/python/src/stereo_client";

/// Rewrites what was stale and fails: the next run passes.
#[test]
fn generated_code_is_what_the_proto_files_say() -> Result<(), Box<dyn Error>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut stale = Vec::new();
    for (name, content) in generate(root)? {
        let mut places = vec![root.join("src/gen").join(&name)];
        if name == DESCRIPTOR_SET {
            places.push(root.join(PYTHON_PACKAGE).join(&name));
        }
        for path in places {
            if fs::read(&path).ok().as_ref() != Some(&content) {
                fs::create_dir_all(path.parent().unwrap_or(root))?;
                fs::write(&path, &content)?;
                stale.push(path);
            }
        }
    }
    assert!(
        stale.is_empty(),
        "generated files were stale and have been rewritten ({stale:?}): run again and commit them"
    );
    Ok(())
}

/// Names of the files in `src/gen`, and their contents.
type Files = Vec<(String, Vec<u8>)>;

fn generate(root: &Path) -> Result<Files, Box<dyn Error>> {
    let mut sources: Vec<PathBuf> = fs::read_dir(root.join("stereo/v1"))?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<_, _>>()?;
    sources.retain(|path| path.extension().is_some_and(|extension| extension == "proto"));
    sources.sort();

    let mut compiler = protox::Compiler::new([root])?;
    compiler
        .include_imports(true)
        .include_source_info(true)
        .open_files(sources)?;
    let descriptors = compiler.file_descriptor_set();

    let mut files = vec![(DESCRIPTOR_SET.to_owned(), compiler.encode_file_descriptor_set())];
    let modules = descriptors
        .file
        .into_iter()
        .map(|file| {
            (
                prost_build::Module::from_protobuf_package_name(file.package()),
                file,
            )
        })
        .collect();
    let mut config = prost_build::Config::new();
    config.bytes(["."]).boxed(".stereo.v1.BatchReply.outcome.result");
    let mut generated: Vec<_> = config.generate(modules)?.into_iter().collect();
    generated.sort_by(|a, b| a.1.cmp(&b.1));
    for (module, content) in generated.into_iter().filter(|(_, content)| !content.is_empty()) {
        files.push((module.to_file_name_or("stereo"), content.into_bytes()));
    }
    Ok(files)
}

#[test]
fn descriptor_set_holds_every_message_of_the_package() -> Result<(), prost::DecodeError> {
    let set = prost_types::FileDescriptorSet::decode(stereo_proto::DESCRIPTOR_SET)?;
    let messages: Vec<&str> = set
        .file
        .iter()
        .filter(|file| file.package() == "stereo.v1")
        .flat_map(|file| file.message_type.iter().map(|message| message.name()))
        .collect();
    for name in [
        "StereoRequest",
        "Options",
        "StereoResult",
        "ExecutionReport",
        "Status",
        "BatchReply",
        "CameraSettings",
        "ImageStamp",
        "ServerLoad",
        "StreamView",
    ] {
        assert!(messages.contains(&name), "{name} is missing from {messages:?}");
    }
    Ok(())
}
