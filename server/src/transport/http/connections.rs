//! The listener and its connections: how many, how long each may be silent, and how they end.

mod departures;
mod patient;
mod places;

use std::error::Error;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::Request;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{sleep, timeout};
use tower::ServiceExt;

pub(super) use self::departures::Departures;
use self::patient::Patient;
use self::places::{Place, Places};
use crate::config::HttpConfig;
use crate::metrics::{ConnectionEnd, Metrics};
use crate::service::Service;

/// How long connections may take to end once the server stops.
const CLOSE: Duration = Duration::from_secs(2);
/// How long to wait when the system has no descriptor left for a new connection.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// A batch gives its client up after the time for a body, and says so; the connection waits a little longer than that.
const PATIENCE_FACTOR: u32 = 2;
/// Requests that one HTTP/2 connection may have under way.
const MAX_STREAMS: u32 = 64;

/// The address a request came from: an extension of each request.
#[derive(Clone, Copy)]
pub(super) struct Peer(pub(super) IpAddr);

/// A bound socket that doesn't answer yet.
#[derive(Debug)]
pub struct Listener {
    socket: TcpListener,
    addr: SocketAddr,
}

/// A listener with its task.
#[derive(Debug)]
pub struct Listening {
    /// The bound address, with the port that the system chose if 0 was asked for.
    pub addr: SocketAddr,
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
}

impl Listener {
    /// Binds the configured address.
    ///
    /// # Errors
    /// What the system says, such as that the address is in use.
    pub async fn bind(config: &HttpConfig) -> io::Result<Self> {
        let socket = TcpListener::bind(config.listen).await?;
        let addr = socket.local_addr()?;
        Ok(Self { socket, addr })
    }

    /// Starts to answer with `router`.
    #[must_use]
    pub fn serve(self, config: &HttpConfig, router: Router, service: &Service) -> Listening {
        let metrics = Arc::clone(service.metrics());
        let stop = watch::Sender::new(false);
        let Self { socket, addr } = self;
        let task = tokio::spawn(accept(socket, config.clone(), router, metrics, stop.subscribe()));
        Listening { addr, stop, task }
    }
}

impl Listening {
    /// Accepts nothing any more, lets every connection finish what it is at, and cuts off those that take longer than 2 s.
    pub async fn close(self) {
        // Fails only if the task has ended already.
        let _ = self.stop.send(true);
        let _ = self.task.await;
    }
}

async fn accept(
    socket: TcpListener,
    config: HttpConfig,
    router: Router,
    metrics: Arc<Metrics>,
    mut stop: watch::Receiver<bool>,
) {
    let places = Arc::new(Places::new(config.connections, Arc::clone(&metrics)));
    let stopping = stop.clone();
    let accepting = async {
        loop {
            let (stream, peer) = match socket.accept().await {
                Ok(accepted) => accepted,
                Err(error) => {
                    tracing::warn!(%error, "can't accept a connection");
                    sleep(ACCEPT_PAUSE).await;
                    continue;
                }
            };
            let Some(place) = places.take().await else {
                metrics.connection_ended(ConnectionEnd::Refused);
                places.refuse(stream);
                continue;
            };
            let metrics = Arc::clone(&metrics);
            let connection = Connection {
                peer: peer.ip().to_canonical(),
                config: config.clone(),
                router: router.clone(),
                stop: stopping.clone(),
            };
            tokio::spawn(async move {
                metrics.connections.inc();
                let end = connection.serve(stream, &place).await;
                metrics.connections.dec();
                metrics.connection_ended(end);
                drop(place);
            });
        }
    };
    tokio::select! {
        () = accepting => {}
        _ = stop.wait_for(|&stop| stop) => {}
    }
    drop(socket);
    // All places free again: every connection has ended, at the latest when its own time for it is up.
    places.all_free().await;
}

/// What a connection is served with.
struct Connection {
    peer: IpAddr,
    config: HttpConfig,
    router: Router,
    stop: watch::Receiver<bool>,
}

impl Connection {
    /// Serves it until the client closes it, it rests for too long, its place is needed, or the server stops.
    async fn serve(self, stream: TcpStream, place: &Place) -> ConnectionEnd {
        let Self {
            peer,
            config,
            router,
            mut stop,
        } = self;
        // Answers are written whole; waiting to fill a packet only costs latency. Not all kinds of sockets know this.
        let _ = stream.set_nodelay(true);
        let active = watch::Sender::new(0_usize);
        let serving = active.clone();
        let departures = Departures::default();
        let stream = Patient::new(stream, PATIENCE_FACTOR * config.body_timeout, departures.clone());
        let service = hyper::service::service_fn(move |request: hyper::Request<hyper::body::Incoming>| {
            place.speaks();
            let busy = Arc::new(Busy::new(&serving));
            let mut request: Request = request.map(Body::new);
            request.extensions_mut().insert(Peer(peer));
            request.extensions_mut().insert(Arc::clone(&busy));
            request.extensions_mut().insert(departures.clone());
            let answer = router.clone().oneshot(request);
            async move {
                let answer = answer.await;
                drop(busy);
                answer
            }
        });
        let builder = builder(config.header_timeout);
        let mut connection = pin!(builder.serve_connection(TokioIo::new(stream), service));
        let mut stopping = pin!(async move {
            let _ = stop.wait_for(|&stop| stop).await;
        });
        tokio::select! {
            ended = connection.as_mut() => return end(ended),
            () = place.evicted() => return ConnectionEnd::Evicted,
            () = rested(active.subscribe(), config.header_timeout) => {
                connection.as_mut().graceful_shutdown();
                // What is being sent may still be taken; a client that doesn't take it is cut off.
                tokio::select! {
                    ended = timeout(config.body_timeout, connection.as_mut()) => {
                        return match ended.map(end) {
                            Ok(ConnectionEnd::SlowReader) | Err(_) => ConnectionEnd::SlowReader,
                            // Half a head is cut off here, which is no failure of the network.
                            Ok(_) => ConnectionEnd::Silent,
                        };
                    }
                    () = stopping.as_mut() => {}
                }
            }
            () = stopping.as_mut() => {}
        }
        connection.as_mut().graceful_shutdown();
        // Cut off or not: it is the server that ends it.
        drop(timeout(CLOSE, connection).await);
        ConnectionEnd::Stopping
    }
}

/// HTTP/1.1 and h2c; a client that is silent for longer than `silence` is given up.
fn builder(silence: Duration) -> Builder<TokioExecutor> {
    let mut builder = Builder::new(TokioExecutor::new());
    builder
        .http1()
        .timer(TokioTimer::new())
        .header_read_timeout(silence);
    builder
        .http2()
        .timer(TokioTimer::new())
        .keep_alive_interval(silence)
        .max_concurrent_streams(MAX_STREAMS);
    builder
}

/// Returns once nothing has been under way for `limit`: a silent client, headers that trickle in, or a rest between requests.
async fn rested(mut active: watch::Receiver<usize>, limit: Duration) {
    loop {
        // The sender lives in the connection that this future is polled beside.
        drop(active.wait_for(|&n| n == 0).await);
        // Any change will do: a request may come and go between two looks.
        if timeout(limit, active.changed()).await.is_err() {
            return;
        }
    }
}

/// One request of a connection under way, counted while this lives. An extension of each request: whoever answers for longer than
/// until the head of the reply keeps it.
pub(super) struct Busy(watch::Sender<usize>);

impl Busy {
    fn new(active: &watch::Sender<usize>) -> Self {
        active.send_modify(|n| *n += 1);
        Self(active.clone())
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.0.send_modify(|n| *n -= 1);
    }
}

/// How a connection ended that nobody here ended.
fn end(ended: Result<(), Box<dyn Error + Send + Sync>>) -> ConnectionEnd {
    let Err(error) = ended else {
        return ConnectionEnd::Closed;
    };
    tracing::debug!(%error, "connection ended");
    let mut cause: Option<&(dyn Error + 'static)> = Some(&*error);
    while let Some(error) = cause {
        match error.downcast_ref::<hyper::Error>() {
            Some(error) if error.is_timeout() => return ConnectionEnd::Silent,
            _ => {}
        }
        match error.downcast_ref::<io::Error>() {
            Some(error) if error.kind() == io::ErrorKind::TimedOut => return ConnectionEnd::SlowReader,
            _ => {}
        }
        cause = error.source();
    }
    ConnectionEnd::Failed
}
