//! The instruction-set level the kernels run at, and the one place where a level becomes code.
//!
//! A [`Level`] is a token: whoever holds one of the higher levels holds the proof that this machine has its instructions,
//! because detection is the only way to make one. A kernel is a struct of its arguments with a generic `run`; the level
//! compiles that body once for every instruction set. Most bodies are plain loops over arrays, which the compiler turns
//! into vector code; those that need byte shuffles use the few operations of [`Lanes`], which every instruction set
//! provides. There is one body, so all levels give the same bits.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod lanes;
#[cfg(target_arch = "aarch64")]
mod neon;
mod scalar;

pub(crate) use lanes::{LABELS, Lanes, MOST_BYTES, MOST_PIXELS, TABLE};

/// Proof that this machine can run the kernels of a level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Level(Kind);

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Kind {
    Scalar,
    #[cfg(target_arch = "aarch64")]
    Neon,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

/// Work that can be compiled for every instruction set.
pub(crate) trait Kernel {
    type Output;

    /// Does the work. Implementations are `#[inline(always)]`, so that the body is compiled with the level's instructions.
    fn run<L: Lanes>(self, lanes: L) -> Self::Output;
}

/// All ones where `condition`, else zero. Selecting by masks keeps loops free of branches, without which AVX2 gets no vectors.
#[inline(always)]
pub(crate) fn mask(condition: bool) -> u16 {
    u16::from(condition).wrapping_neg()
}

impl Default for Level {
    fn default() -> Self {
        Self::SCALAR
    }
}

impl Level {
    /// Portable Rust; exists on every machine and is what every other level must equal bit for bit.
    pub const SCALAR: Self = Self(Kind::Scalar);

    /// The best level of this machine.
    #[must_use]
    pub fn detect() -> Self {
        Self::available().last().copied().unwrap_or(Self::SCALAR)
    }

    /// All levels of this machine, the slowest first.
    #[must_use]
    pub fn available() -> Vec<Self> {
        let mut levels = vec![Self::SCALAR];
        #[cfg(target_arch = "aarch64")]
        levels.push(Self(Kind::Neon));
        #[cfg(target_arch = "x86_64")]
        {
            if avx2::is_available() {
                levels.push(Self(Kind::Avx2));
            }
            if avx512::is_available() {
                levels.push(Self(Kind::Avx512));
            }
        }
        levels
    }

    /// The name users give and see: `scalar`, `neon`, `avx2` or `avx512`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self.0 {
            Kind::Scalar => "scalar",
            #[cfg(target_arch = "aarch64")]
            Kind::Neon => "neon",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => "avx512",
        }
    }

    /// Runs a kernel with this level's instructions.
    pub(crate) fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            Kind::Scalar => kernel.run(scalar::Scalar),
            #[cfg(target_arch = "aarch64")]
            Kind::Neon => kernel.run(neon::Neon),
            // SAFETY: a level of this kind exists only where `is_available` found its instructions.
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => unsafe { avx2::run(kernel) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => unsafe { avx512::run(kernel) },
        }
    }
}
