//! The real binary over real Zenoh sessions, through a router of the test's own.

mod clients;
mod command_line;
mod errors;
mod fleet;
mod frames;
mod hosts;
mod impostors;
mod lifecycle;
mod network;
mod parity;
mod queries;
mod security;
mod settings;
mod shared_memory;
mod streams;
