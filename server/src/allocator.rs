//! Memory of large bodies, given back to the system as soon as it is free.

use std::env;
use std::os::unix::process::CommandExt;
use std::process::Command;

/// glibc reads this when a program starts. Without it, what a large body took becomes part of a heap that seldom shrinks: twice the bytes
/// that may be in flight took a server to 1.6 times its bound.
const THRESHOLD: &str = "MALLOC_MMAP_THRESHOLD_";
/// Bytes from which an allocation is a mapping of its own.
const LARGE: &str = "1048576";

/// Starts this program anew in its own place, with glibc told, unless that is done already. Goes on without where it can't be.
#[expect(clippy::disallowed_methods, reason = "glibc's setting, none of the server's")]
pub fn give_back() {
    if cfg!(not(target_env = "gnu")) || env::var_os(THRESHOLD).is_some() {
        return;
    }
    if let Ok(program) = env::current_exe() {
        let mut args = env::args_os();
        let name = args.next().unwrap_or_else(|| program.clone().into_os_string());
        // Returns only if it fails. Then the server takes more memory, and is none the worse for it otherwise.
        let _ = Command::new(program)
            .arg0(name)
            .args(args)
            .env(THRESHOLD, LARGE)
            .exec();
    }
}
