//! A wall clock that steps, for one child process alone: libfaketime. What measures time spans (CLOCK_MONOTONIC) goes on as it does
//! when a machine's clock is set.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

/// Where Debian and others have the library, below /usr/lib.
const LIBRARY: &str = "faketime/libfaketimeMT.so.1";

const ABSENT: &str = "libfaketime is not installed (Debian: libfaketime)";

/// The clock of a process that was started with [`via`](Self::via).
#[derive(Debug)]
pub struct SteppedClock {
    file: PathBuf,
    words: Vec<String>,
}

impl SteppedClock {
    /// A clock that goes right until it is stepped; `file` is where it looks for its step.
    ///
    /// # Errors
    /// If libfaketime is not installed, or the file can't be written.
    pub fn new(file: &Path) -> Result<Self> {
        let library = library().context(ABSENT)?;
        let words = vec![
            "env".to_owned(),
            format!("LD_PRELOAD={}", library.display()),
            format!("FAKETIME_TIMESTAMP_FILE={}", file.display()),
            "FAKETIME_DONT_FAKE_MONOTONIC=1".to_owned(),
            "FAKETIME_NO_CACHE=1".to_owned(),
        ];
        let clock = Self {
            file: file.to_owned(),
            words,
        };
        clock.step_to("+0")?;
        Ok(clock)
    }

    /// The words before the program.
    #[must_use]
    pub fn via(&self) -> Vec<&str> {
        self.words.iter().map(String::as_str).collect()
    }

    /// Sets the clock to this distance from the right time, such as `+1h` or `-1h`.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn step_to(&self, offset: &str) -> Result<()> {
        // Whole at every moment: it is read again and again.
        let new = self.file.with_extension("new");
        std::fs::write(&new, offset).with_context(|| format!("can't write {}", new.display()))?;
        std::fs::rename(&new, &self.file).with_context(|| format!("can't write {}", self.file.display()))
    }
}

/// Whether there can be one here.
///
/// # Errors
/// Why not.
pub fn is_possible() -> Result<(), String> {
    library().map(drop).ok_or_else(|| ABSENT.to_owned())
}

fn library() -> Option<PathBuf> {
    let folders = std::fs::read_dir("/usr/lib").ok()?.flatten();
    let beside = folders.map(|folder| folder.path().join(LIBRARY));
    std::iter::once(Path::new("/usr/lib").join(LIBRARY))
        .chain(beside)
        .find(|path| path.is_file())
}
