//! Memory of large bodies, given back to the system as soon as it is free, and that of small ones, kept.

use std::env;
use std::os::unix::process::CommandExt;
use std::process::Command;

/// Bytes from which an allocation is a mapping of its own. glibc reads this when a program starts. Without it, what a large body took
/// becomes part of a heap that seldom shrinks: twice the bytes that may be in flight took a server to 1.6 times its bound.
const MAPPED_FROM: (&str, &str) = ("MALLOC_MMAP_THRESHOLD_", "1048576");
/// Bytes that a heap keeps at its end: those of a few VGA frames. With glibc's 128 KiB, the body and the result of each frame were given
/// back and asked for again, page by page, which was a fifth of a round trip over HTTP without the match.
const KEPT: (&str, &str) = ("MALLOC_TRIM_THRESHOLD_", "4194304");

/// Starts this program anew in its own place, with glibc told, unless that is done already. Goes on without where it can't be.
#[expect(clippy::disallowed_methods, reason = "glibc's setting, none of the server's")]
pub fn give_back() {
    if cfg!(not(target_env = "gnu")) || env::var_os(MAPPED_FROM.0).is_some() {
        return;
    }
    if let Ok(program) = env::current_exe() {
        let mut args = env::args_os();
        let name = args.next().unwrap_or_else(|| program.clone().into_os_string());
        // Returns only if it fails. Then the server takes more memory, and is none the worse for it otherwise.
        let _ = Command::new(program)
            .arg0(name)
            .args(args)
            .envs([MAPPED_FROM, KEPT])
            .exec();
    }
}
