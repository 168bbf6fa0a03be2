//! What the tests, the evaluation and the demo share: rendered pairs with exact ground truth, real data sets, the
//! scoring protocol, and the real `stereod` binary as a child process.
//!
//! Conventions are the core's: `x` right, `y` down, `disparity = x_left - x_right >= 0`, ground truth in the left view
//! with 0 where there is none.
#![forbid(unsafe_code)]

pub mod clock;
pub mod dataset;
pub mod degrade;
pub mod gray;
pub mod http;
pub mod machine;
pub mod matching;
pub mod network;
pub mod process;
pub mod readme;
pub mod registry_pair;
pub mod render;
pub mod scene;
pub mod score;
pub mod texture;
pub mod truth;
pub mod zenoh;
