//! The options part in the API description: the ranges and names are those that are checked.

use utoipa::openapi::schema::{Array, ArrayBuilder, Object, ObjectBuilder, SchemaType, Type};

use super::choice::{self, Choice};
use super::range::{self, Range};

/// A number that may be left out.
fn number(range: &Range, what: &str) -> Object {
    let kind = match range.step {
        0.0 => Type::Number,
        _ => Type::Integer,
    };
    ObjectBuilder::new()
        .schema_type(SchemaType::from_iter([kind, Type::Null]))
        .minimum(Some(range.min))
        .maximum(Some(range.max))
        .multiple_of((range.step > 0.0).then_some(range.step))
        .description(Some(what))
        .build()
}

/// One of some names.
fn name(choice: &Choice) -> ObjectBuilder {
    ObjectBuilder::new()
        .schema_type(Type::String)
        .enum_values(Some(choice.values.iter().copied()))
}

/// One of some names, or nothing.
fn optional_name(choice: &Choice, what: &str) -> Object {
    let values = choice.values.iter().copied().map(Some).chain([None]);
    ObjectBuilder::new()
        .schema_type(SchemaType::from_iter([Type::String, Type::Null]))
        .enum_values(Some(values))
        .description(Some(what))
        .build()
}

pub(super) fn max_iterations() -> Object {
    number(
        &range::MAX_ITERATIONS,
        "Rungs of the preset's ladder to run at most, the first included. Absent: the whole ladder.",
    )
}

pub(super) fn min_confidence() -> Object {
    number(
        &range::MIN_CONFIDENCE,
        "Drops pixels with a confidence under 255 times this. Absent: none.",
    )
}

pub(super) fn num_disparities() -> Object {
    number(
        &range::NUM_DISPARITIES,
        "Number of disparities searched, in pixels. Absent: 128.",
    )
}

pub(super) fn min_disparity() -> Object {
    number(
        &range::MIN_DISPARITY,
        "Smallest disparity searched, in pixels. Absent: 0.",
    )
}

pub(super) fn focus_weight() -> Object {
    number(&range::FOCUS_WEIGHT, "Heavier regions come first. Absent: 1.")
}

pub(super) fn max_disparity_step_px() -> Object {
    number(
        &range::MAX_DISPARITY_STEP_PX,
        "A triangle without texture spans a depth discontinuity if its vertex disparities differ by more than this, in pixels. Absent: 4.",
    )
}

pub(super) fn min_valid_share() -> Object {
    number(
        &range::MIN_VALID_SHARE,
        "A triangle with texture failed validation if less than this share of its textured pixels lies on it. Absent: 0.5.",
    )
}

pub(super) fn tolerance_px() -> Object {
    number(
        &range::MESH_TOLERANCE_PX,
        "How far a dense result may be from a plane that still fits it, in pixels of disparity. Absent: 1.",
    )
}

pub(super) fn max_triangles() -> Object {
    number(&range::MAX_TRIANGLES, "Triangles at most. Absent: 20000.")
}

pub(super) fn preset() -> Object {
    optional_name(
        &choice::PRESET,
        "Named choice of algorithm parameters. Absent: default.",
    )
}

pub(super) fn density() -> Object {
    optional_name(
        &choice::DENSITY,
        "Which pixels get a disparity. Absent: semi_dense.",
    )
}

pub(super) fn priority_class() -> Object {
    optional_name(
        &choice::PRIORITY_CLASS,
        "How the request is scheduled. Absent: deadline.",
    )
}

pub(super) fn disparity_encoding() -> Object {
    optional_name(
        &choice::DISPARITY_ENCODING,
        "How a protobuf result holds the disparity. Absent: u16.",
    )
}

pub(super) fn compression() -> Object {
    optional_name(
        &choice::COMPRESSION,
        "How the payloads of a protobuf result are compressed. Absent: none.",
    )
}

pub(super) fn outputs() -> Array {
    ArrayBuilder::new()
        .schema_type(SchemaType::from_iter([Type::Array, Type::Null]))
        .items(name(&choice::OUTPUTS))
        .description(Some(
            "The parts a protobuf result has. Absent or empty: disparity, confidence and mesh.",
        ))
        .build()
}
