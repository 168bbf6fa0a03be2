//! Everything of stereod that decodes bytes from outside, as functions that any bytes can be given to: libFuzzer does so (`fuzz/`), and
//! so do this crate's test and its program `hostile`, which change the files of `fuzz/corpus` at random.
//!
//! Each target says whether the bytes were accepted. It panics if a decoder does, or if a refusal is the server's fault, or longer than
//! one can be: nothing from outside may be reflected at length. No target needs Zenoh, only what decodes its payloads.
#![forbid(unsafe_code)]

pub mod corpus;
pub mod mutate;
mod refusal;
mod targets;

use self::targets::{batch, config, files, form, http, options, pixels, request, zenoh};

/// A decoder.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// Its name, that of its corpus and of its libFuzzer target.
    pub name: &'static str,
    /// Gives bytes to it; true if they were accepted.
    pub run: fn(&[u8]) -> bool,
}

/// All decoders.
pub const TARGETS: &[Target] = &[
    Target {
        name: "request",
        run: request::request,
    },
    Target {
        name: "form",
        run: form::form,
    },
    Target {
        name: "batch",
        run: batch::batch,
    },
    Target {
        name: "png",
        run: files::png,
    },
    Target {
        name: "jpeg",
        run: files::jpeg,
    },
    Target {
        name: "pixels",
        run: pixels::pixels,
    },
    Target {
        name: "options",
        run: options::options,
    },
    Target {
        name: "selector",
        run: options::selector,
    },
    Target {
        name: "config",
        run: config::config,
    },
    Target {
        name: "zenoh",
        run: zenoh::zenoh,
    },
    Target {
        name: "http",
        run: http::http,
    },
];

/// The decoder of this name.
///
/// # Panics
/// If there is none.
#[must_use]
#[expect(clippy::panic, reason = "names are written in the program")]
pub fn target(name: &str) -> Target {
    match TARGETS.iter().find(|target| target.name == name) {
        Some(target) => *target,
        None => panic!("there is no target {name}"),
    }
}
