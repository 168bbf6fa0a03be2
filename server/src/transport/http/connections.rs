//! The listener and its connections: how many, how long each may be silent, and how they end.

mod departures;
mod farewell;
mod patient;
mod places;
mod tls;

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
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{sleep, timeout};
use tower::ServiceExt;

pub(super) use self::departures::Departures;
use self::patient::Patient;
use self::places::{Place, Places};
pub(super) use self::tls::CertifiedNames;
pub use self::tls::Tls;
use crate::config::HttpConfig;
use crate::metrics::{ConnectionEnd, Metrics};
use crate::service::Service;
use crate::status::ServiceError;

/// How long connections may take to end once the server stops.
const CLOSE: Duration = Duration::from_secs(2);
/// How long to wait when the system has no descriptor left for a new connection.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// A batch gives its client up after the time for a body, and says so; the connection waits a little longer than that.
const PATIENCE_FACTOR: u32 = 2;
/// What a connection of HTTP/1.1 may hold of what came or is to go, and so the longest head. Small, since refused clients that still send
/// are many: hundreds of them beside a flood.
const MAX_BUFFER_BYTES: usize = 16 << 10;
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
    /// Reads the files of TLS again.
    renewal: Option<JoinHandle<()>>,
}

impl Listener {
    /// Binds an address.
    ///
    /// # Errors
    /// What the system says, such as that the address is in use.
    pub async fn bind(addr: SocketAddr) -> io::Result<Self> {
        let socket = TcpListener::bind(addr).await?;
        let addr = socket.local_addr()?;
        Ok(Self { socket, addr })
    }

    /// Starts to answer with `router`, encrypted if there is a `tls`.
    #[must_use]
    pub fn serve(
        self,
        config: &HttpConfig,
        tls: Option<Arc<Tls>>,
        router: Router,
        service: &Service,
    ) -> Listening {
        let metrics = Arc::clone(service.metrics());
        let stop = watch::Sender::new(false);
        let Self { socket, addr } = self;
        let renewal = tls.clone().map(|tls| tokio::spawn(tls.keep_current()));
        let host = Host {
            config: config.clone(),
            tls,
            router,
            metrics,
            stop: stop.subscribe(),
        };
        let task = tokio::spawn(accept(socket, host));
        Listening {
            addr,
            stop,
            task,
            renewal,
        }
    }
}

impl Listening {
    /// Accepts nothing any more, lets every connection finish what it is at, and cuts off those that take longer than 2 s.
    pub async fn close(self) {
        // Fails only if the task has ended already.
        let _ = self.stop.send(true);
        let _ = self.task.await;
        if let Some(renewal) = self.renewal {
            renewal.abort();
        }
    }
}

/// What connections are served with.
#[derive(Clone)]
struct Host {
    config: HttpConfig,
    tls: Option<Arc<Tls>>,
    router: Router,
    metrics: Arc<Metrics>,
    stop: watch::Receiver<bool>,
}

async fn accept(socket: TcpListener, host: Host) {
    let metrics = Arc::clone(&host.metrics);
    let mut stop = host.stop.clone();
    let places = Arc::new(Places::new(host.config.connections, Arc::clone(&metrics)));
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
            let connection = Connection {
                peer: peer.ip().to_canonical(),
                names: CertifiedNames::default(),
                departures: Departures::default(),
                host: host.clone(),
            };
            tokio::spawn(async move {
                let metrics = Arc::clone(&connection.host.metrics);
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

/// One connection, with what is known of it.
struct Connection {
    peer: IpAddr,
    names: CertifiedNames,
    departures: Departures,
    host: Host,
}

impl Connection {
    /// Serves it until the client closes it, it rests for too long, its place is needed, or the server stops.
    async fn serve(self, stream: TcpStream, place: &Place) -> ConnectionEnd {
        // Answers are written whole; waiting to fill a packet only costs latency. Not all kinds of sockets know this.
        let _ = stream.set_nodelay(true);
        match self.host.tls.clone() {
            None => {
                let stream = self.patient(stream);
                self.converse(stream, place).await
            }
            Some(tls) => self.serve_encrypted(stream, &tls, place).await,
        }
    }

    fn patient(&self, stream: TcpStream) -> Patient {
        let patience = PATIENCE_FACTOR * self.host.config.body_timeout;
        Patient::new(stream, patience, self.departures.clone())
    }

    /// The same after a handshake, which has the time of a head. Until its first request the connection has to make room for others.
    async fn serve_encrypted(mut self, stream: TcpStream, tls: &Tls, place: &Place) -> ConnectionEnd {
        let mut stop = self.host.stop.clone();
        let handshake = timeout(self.host.config.header_timeout, async {
            match tls::begins(&stream).await {
                Ok(true) => tls.accept(self.patient(stream)).await,
                Ok(false) => {
                    let error = ServiceError::Invalid(
                        "this port speaks HTTPS: begin the address with https://".to_owned(),
                    );
                    self.host.metrics.ended(None, error.reason_name());
                    farewell::say(stream, error).await;
                    Err(io::ErrorKind::InvalidData.into())
                }
                Err(error) => Err(error),
            }
        });
        let encrypted = tokio::select! {
            shaken = handshake => match shaken {
                Ok(Ok(encrypted)) => encrypted,
                Ok(Err(error)) => {
                    tracing::debug!(%error, peer = %self.peer, "no TLS came about");
                    return ConnectionEnd::Handshake;
                }
                Err(_) => return ConnectionEnd::Silent,
            },
            () = place.evicted() => return ConnectionEnd::Evicted,
            _ = stop.wait_for(|&stop| stop) => return ConnectionEnd::Stopping,
        };
        self.names = tls::certified_names(encrypted.get_ref().1);
        self.converse(encrypted, place).await
    }

    /// Answers requests.
    async fn converse<S>(self, stream: S, place: &Place) -> ConnectionEnd
    where
        S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    {
        let Self {
            peer,
            names,
            departures,
            host,
        } = self;
        let Host {
            config,
            router,
            mut stop,
            ..
        } = host;
        let active = watch::Sender::new(0_usize);
        let serving = active.clone();
        let service = hyper::service::service_fn(move |request: hyper::Request<hyper::body::Incoming>| {
            place.speaks();
            let busy = Arc::new(Busy::new(&serving));
            let mut request: Request = request.map(Body::new);
            let extensions = request.extensions_mut();
            extensions.insert(Peer(peer));
            extensions.insert(names.clone());
            extensions.insert(Arc::clone(&busy));
            extensions.insert(departures.clone());
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

/// HTTP/1.1 and HTTP/2; a client that is silent for longer than `silence` is given up.
fn builder(silence: Duration) -> Builder<TokioExecutor> {
    let mut builder = Builder::new(TokioExecutor::new());
    builder
        .http1()
        .timer(TokioTimer::new())
        .header_read_timeout(silence)
        .max_buf_size(MAX_BUFFER_BYTES);
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
