//! The wire of stereod: package `stereo.v1`, and nothing but the wire.
//!
//! The source of truth is `stereo/v1/*.proto`; `src/gen` is made from it and checked in, so that nobody needs `protoc` or a
//! build script. After a change of a `.proto` file, `cargo test --release -p stereo-proto --test bootstrap` rewrites
//! `src/gen` and fails once; the next run passes. Fields of type `bytes` are [`bytes::Bytes`]: decoded from a `Bytes`, they
//! are slices of it and no pixel is copied.
#![forbid(unsafe_code)]

/// Messages of package `stereo.v1`.
pub mod v1 {
    include!("gen/stereo.v1.rs");
}

/// The package as a `google.protobuf.FileDescriptorSet` with its imports and comments, for languages that build their types
/// from it when they start.
pub const DESCRIPTOR_SET: &[u8] = include_bytes!("gen/stereo.v1.binpb");

/// Media type of one protobuf message.
pub const CONTENT_TYPE: &str = "application/x-protobuf";

/// Media type of a stream of protobuf messages, each after its length as a varint.
pub const CONTENT_TYPE_DELIMITED: &str = "application/x-protobuf; delimited=true";
