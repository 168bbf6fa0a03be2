//! Options whose values have names: in JSON the wire's, in lower case and without the enum's prefix.

use crate::status::ServiceError;

/// A field whose values have names.
pub(super) struct Choice {
    /// The field.
    name: &'static str,
    /// What its values' names start with on the wire.
    prefix: &'static str,
    /// The names, for people.
    expected: &'static str,
}

pub(super) const PRESET: Choice = Choice {
    name: "preset",
    prefix: "PRESET_",
    expected: "default, fast or paper",
};
pub(super) const DENSITY: Choice = Choice {
    name: "density",
    prefix: "DENSITY_",
    expected: "semi_dense or dense",
};
pub(super) const PRIORITY_CLASS: Choice = Choice {
    name: "priority_class",
    prefix: "PRIORITY_CLASS_",
    expected: "deadline, best_effort or background",
};
pub(super) const OUTPUTS: Choice = Choice {
    name: "outputs",
    prefix: "OUTPUT_",
    expected: "disparity, confidence, depth, mesh or points",
};
pub(super) const DISPARITY_ENCODING: Choice = Choice {
    name: "disparity_encoding",
    prefix: "DISPARITY_ENCODING_",
    expected: "f32, u16 or png16",
};
pub(super) const COMPRESSION: Choice = Choice {
    name: "compression",
    prefix: "COMPRESSION_",
    expected: "none, zstd or lz4",
};

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
            field.name, field.expected
        ))
    })
}
