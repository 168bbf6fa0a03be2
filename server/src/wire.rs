//! The wire's messages to the domain's types and back, and nothing else: shapes, sizes and options are checked here, once.
//!
//! ```text
//! application/x-protobuf ── decode_request ──┐
//!                                            ├─> StereoRequest ── frame_request ──> FrameRequest    (every check)
//! multipart/form-data ──── request_from_form ┘
//!
//! MatchedFrame ── result_body ──> StereoResult
//! ```
//!
//! Whatever way a request came, one path checks it. A batch is such messages one after another ([`Delimited`]).

mod budget;
mod compress;
mod delimited;
mod form;
mod images;
mod options;
mod payload;
mod pixels;
mod range;
mod report;
mod request;
mod result;
mod selector;
mod settings;
mod stream_view;

pub use budget::{latency_budget_from_grpc_timeout, latency_budget_from_ms};
pub use delimited::{Delimited, delimited, delimited_result_head};
pub(crate) use form::FormDescription;
pub use form::{FormParts, request_from_form};
pub use payload::{SingleImage, expect_message, single_image};
pub use report::report_body;
pub(crate) use request::is_request_id;
pub use request::{Intake, decode_request, frame_request};
pub use result::{disparity_body, mesh_body, result_body};
pub use selector::selector_parameters;
pub use settings::{
    camera_settings, camera_settings_from_json, camera_settings_to_proto, decode_camera_settings,
};
pub use stream_view::stream_view_body;
