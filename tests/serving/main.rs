//! The real binary over real sockets.
#![expect(
    clippy::panic,
    reason = "a panic is how a test fails, in its helper functions too"
)]

mod bad_bodies;
mod bad_images;
mod bad_options;
mod batch;
mod bounds;
mod budgets;
mod client;
mod command_line;
mod conversation;
mod crowds;
mod doors;
mod doors_admin;
mod doors_headers;
mod doors_tls;
mod encodings;
mod files;
mod h2c;
mod lifecycle;
mod load;
mod logs;
mod mutated_files;
mod offline;
mod options;
mod replies;
mod rough_clients;
mod secure;
mod shares;
mod split_frames;
mod tls;
mod zenoh;
