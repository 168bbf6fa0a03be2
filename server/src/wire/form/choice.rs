//! Options whose values have names: in JSON the wire's, in lower case and without the enum's prefix.

use crate::status::ServiceError;

/// A field whose values have names.
pub(super) struct Choice {
    /// The field.
    name: &'static str,
    /// What its values' names start with on the wire.
    prefix: &'static str,
    /// The names.
    pub(super) values: &'static [&'static str],
}

pub(super) const PRESET: Choice = Choice {
    name: "preset",
    prefix: "PRESET_",
    values: &["default", "fast", "paper"],
};
pub(super) const DENSITY: Choice = Choice {
    name: "density",
    prefix: "DENSITY_",
    values: &["semi_dense", "dense"],
};
pub(super) const PRIORITY_CLASS: Choice = Choice {
    name: "priority_class",
    prefix: "PRIORITY_CLASS_",
    values: &["deadline", "best_effort", "background"],
};
pub(super) const OUTPUTS: Choice = Choice {
    name: "outputs",
    prefix: "OUTPUT_",
    values: &["disparity", "confidence", "depth", "mesh", "points"],
};
pub(super) const DISPARITY_ENCODING: Choice = Choice {
    name: "disparity_encoding",
    prefix: "DISPARITY_ENCODING_",
    values: &["f32", "u16", "png16"],
};
pub(super) const COMPRESSION: Choice = Choice {
    name: "compression",
    prefix: "COMPRESSION_",
    values: &["none", "zstd", "lz4"],
};

impl Choice {
    /// The names, for people: `a, b or c`.
    fn expected(&self) -> String {
        match self.values {
            [others @ .., last] if !others.is_empty() => format!("{} or {last}", others.join(", ")),
            few => few.concat(),
        }
    }
}

/// The value called `given` in lower case and without the prefix; absent = unspecified.
pub(super) fn choice<E: Into<i32>>(
    field: &Choice,
    given: Option<String>,
    from_str_name: impl Fn(&str) -> Option<E>,
) -> Result<i32, ServiceError> {
    let Some(given) = given else { return Ok(0) };
    let is_lower = !given.bytes().any(|byte| byte.is_ascii_uppercase());
    let value = from_str_name(&format!("{}{}", field.prefix, given.to_ascii_uppercase())).map(Into::into);
    value.filter(|&value| is_lower && value != 0).ok_or_else(|| {
        let start: String = given.chars().take(32).collect();
        ServiceError::Invalid(format!(
            "{} must be {}, got {start:?}",
            field.name,
            field.expected()
        ))
    })
}
