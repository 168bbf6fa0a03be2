//! stereod: stereo matching as a service. A rectified pair and a latency budget go in; the best disparity and mesh that fit
//! into the budget come out, or a typed refusal.
//!
//! An hourglass: transports above ([`transport`]), one waist ([`service::Service::submit`]), one pure core below (the crate
//! `stereo`) and a pure deadline policy (the crate `stereo-scheduler`). The worker pool is the only place where pixels and
//! deadlines meet.
#![forbid(unsafe_code)]
#![cfg_attr(
    not(feature = "zenoh"),
    expect(dead_code, reason = "what only the Zenoh transport calls")
)]

pub mod allocator;
pub mod args;
pub mod clients;
pub mod config;
pub mod decode;
mod dispatch;
pub mod encode;
pub mod geometry;
pub mod info;
pub mod job;
pub mod logs;
mod metrics;
pub mod offline;
mod pool;
pub mod service;
pub mod shutdown;
pub mod status;
pub mod streams;
pub mod token;
pub mod traces;
pub mod transport;
pub mod wire;

use std::io::ErrorKind;
use std::net::SocketAddr;
use std::sync::Arc;

use axum::Router;
use thiserror::Error;

use crate::config::{Config, ConfigError, HttpConfig};
use crate::service::Service;
use crate::streams::Streams;
use crate::transport::http::{Listener, Listening, Tls, routers};
use crate::transport::zenoh::{Prepared, Zenoh};

/// Connections to the address for whoever runs the server: some that scrape, some that look.
const ADMIN_CONNECTIONS: u32 = 64;

/// Why the server can't start.
#[derive(Debug, Error)]
pub enum StartError {
    /// The configuration is not acceptable.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The address can't be listened on.
    #[error("can't listen on {addr}: {source}{}", what_to_do(source))]
    Listen {
        /// The configured address.
        addr: SocketAddr,
        /// What the system said.
        source: std::io::Error,
    },
    /// The system gives no threads.
    #[error("can't start {count} worker threads: {source}")]
    Threads {
        /// How many were asked for.
        count: u32,
        /// What the system said.
        source: std::io::Error,
    },
}

/// How a socket that can't be bound can be.
fn what_to_do(error: &std::io::Error) -> &'static str {
    match error.kind() {
        ErrorKind::AddrInUse => ": end the program that listens there, or choose another address or port",
        ErrorKind::PermissionDenied => ": ports below 1024 need the right to them, choose another port",
        ErrorKind::AddrNotAvailable => {
            ": this machine doesn't have the address, choose one it has or 0.0.0.0"
        }
        _ => "",
    }
}

/// The whole server, not yet started.
#[derive(Debug)]
pub struct Server;

/// A running server. Dropping it leaves the sockets to the runtime; [`shutdown`](Self::shutdown) ends it in order.
pub struct Running {
    /// Where it listens, with the port that the system chose if 0 was asked for.
    pub http_addr: SocketAddr,
    /// The same of the second address, where there is one.
    pub admin_addr: Option<SocketAddr>,
    /// Whether connections to the first one are encrypted.
    pub is_encrypted: bool,
    service: Arc<Service>,
    listening: Listening,
    admin: Option<Listening>,
    zenoh: Option<Zenoh>,
}

impl Server {
    /// The routes of HTTP with workers behind them, without a socket and without Zenoh: for programs that answer requests themselves.
    /// Needs a tokio runtime. The workers end when the routes are dropped.
    ///
    /// # Errors
    /// [`StartError`].
    pub fn routes(config: &Config) -> Result<Router, StartError> {
        config.validate()?;
        let simd = config.workers.level()?.name();
        let service = Arc::new(Service::start(config)?);
        let streams = Arc::new(Streams::new(service.metrics()));
        Ok(routers(config, simd, service, streams).public)
    }

    /// Validates `config`, binds the sockets, starts the workers and answers. Needs a multi-threaded tokio runtime.
    ///
    /// # Errors
    /// [`StartError`]; nothing is bound if the configuration is not acceptable.
    pub async fn start(config: Config) -> Result<Running, StartError> {
        config.validate()?;
        let zenoh = Prepared::new(&config)?;
        let simd = config.workers.level()?.name();
        let tls = Tls::load(&config.http.tls)?;
        let listener = bind(config.http.listen).await?;
        let admin = match config.http.admin {
            Some(addr) => Some(bind(addr).await?),
            None => None,
        };
        warn_of_open_doors(&config);
        let service = Arc::new(Service::start(&config)?);
        let streams = Arc::new(Streams::new(service.metrics()));
        let routers = routers(&config, simd, Arc::clone(&service), Arc::clone(&streams));
        let listening = listener.serve(&config.http, tls, routers.public, &service);
        let own = HttpConfig {
            connections: ADMIN_CONNECTIONS,
            ..config.http.clone()
        };
        let admin = admin.zip(routers.admin);
        let admin = admin.map(|(listener, router)| listener.serve(&own, None, router, &service));
        let zenoh = zenoh.map(|zenoh| zenoh.start(Arc::clone(&service), streams));
        Ok(Running {
            http_addr: listening.addr,
            admin_addr: admin.as_ref().map(|admin| admin.addr),
            is_encrypted: config.http.tls.is_on(),
            service,
            listening,
            admin,
            zenoh,
        })
    }
}

async fn bind(addr: SocketAddr) -> Result<Listener, StartError> {
    let bound = Listener::bind(addr).await;
    bound.map_err(|source| StartError::Listen { addr, source })
}

/// Says loudly what is open to more than this machine.
fn warn_of_open_doors(config: &Config) {
    let is_open = |addr: SocketAddr| !addr.ip().to_canonical().is_loopback();
    let addr = config.http.listen;
    if is_open(addr) && !config.has_doors() {
        tracing::warn!(
            %addr,
            "anybody who reaches this address can use the server: give its clients tokens (stereod token NAME), or listen on 127.0.0.1"
        );
    } else if is_open(addr) && !config.http.tls.is_on() {
        tracing::warn!(
            %addr,
            "tokens and images go over this address in the clear: give it a certificate (--tls-cert, --tls-key), or put what has one before it"
        );
    }
    if let Some(addr) = config.http.admin.filter(|&addr| is_open(addr)) {
        tracing::warn!(%addr, "anybody who reaches this address can read the server's metrics: see to it that only those do who may");
    }
}

impl Running {
    /// Waits until every worker is done with its dummy pair, and says whether all could match it: `/readyz` is 200 from then on.
    pub async fn ready(&self) -> bool {
        self.service.primed().await
    }

    /// Ends the server: no longer to be found, then not ready and no new work; what was admitted is finished or expires, then
    /// the connections are closed, those that are still busy after 2 s by force.
    pub async fn shutdown(mut self) {
        if let Some(zenoh) = &mut self.zenoh {
            zenoh.withdraw().await;
        }
        self.service.drain().await;
        if let Some(zenoh) = self.zenoh {
            zenoh.close().await;
        }
        self.listening.close().await;
        if let Some(admin) = self.admin {
            admin.close().await;
        }
        let (answered, dropped) = self.service.metrics().totals();
        tracing::info!(
            answered,
            dropped,
            "every frame that was admitted has ended, and every connection"
        );
    }
}
