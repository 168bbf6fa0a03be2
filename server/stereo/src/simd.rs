//! The instruction-set level the kernels run at: a token that is made by detection only.

/// Proof that this machine can run the kernels of a level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Level(Kind);

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Kind {
    Scalar,
}

impl Level {
    /// Portable Rust; exists on every machine and is what every other level must equal bit for bit.
    pub const SCALAR: Self = Self(Kind::Scalar);

    /// The best level of this machine.
    #[must_use]
    pub fn detect() -> Self {
        Self::SCALAR
    }

    /// The name users give and see: `scalar`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self.0 {
            Kind::Scalar => "scalar",
        }
    }
}
