//! The listener and its connections: how many, how long each may be silent, and how they end.

use std::io;
use std::net::SocketAddr;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::Request;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinHandle;
use tokio::time::{sleep, timeout};
use tower::ServiceExt;

use crate::config::HttpConfig;

/// How long connections may take to end once the server stops.
const CLOSE: Duration = Duration::from_secs(2);
/// How long to wait when the system has no descriptor left for a new connection.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// Requests that one HTTP/2 connection may have under way.
const MAX_STREAMS: u32 = 64;

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
    pub fn serve(self, config: &HttpConfig, router: Router) -> Listening {
        let stop = watch::Sender::new(false);
        let Self { socket, addr } = self;
        let task = tokio::spawn(accept(socket, config.clone(), router, stop.subscribe()));
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

async fn accept(socket: TcpListener, config: HttpConfig, router: Router, mut stop: watch::Receiver<bool>) {
    let places = Arc::new(Semaphore::new(config.connections as usize));
    let stopping = stop.clone();
    let accepting = async {
        // The semaphore is never closed.
        while let Ok(place) = Arc::clone(&places).acquire_owned().await {
            let stream = match socket.accept().await {
                Ok((stream, _)) => stream,
                Err(error) => {
                    tracing::warn!(%error, "can't accept a connection");
                    sleep(ACCEPT_PAUSE).await;
                    continue;
                }
            };
            let serving = serve(stream, config.clone(), router.clone(), stopping.clone());
            tokio::spawn(async move {
                serving.await;
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
    drop(places.acquire_many(config.connections).await);
}

/// Serves one connection until the client closes it, it rests for too long, or the server stops.
async fn serve(stream: TcpStream, config: HttpConfig, router: Router, mut stop: watch::Receiver<bool>) {
    // Answers are written whole; waiting to fill a packet only costs latency. Not all kinds of sockets know this.
    let _ = stream.set_nodelay(true);
    let active = watch::Sender::new(0_usize);
    let serving = active.clone();
    let service = hyper::service::service_fn(move |request: hyper::Request<hyper::body::Incoming>| {
        let busy = Busy::new(&serving);
        let answer = router.clone().oneshot(request.map(Body::new) as Request);
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
        ended = connection.as_mut() => return log(ended),
        () = rested(active.subscribe(), config.header_timeout) => {
            connection.as_mut().graceful_shutdown();
            // What is being sent may still be taken; a client that doesn't take it is cut off.
            tokio::select! {
                ended = timeout(config.body_timeout, connection.as_mut()) => return ended.map_or((), log),
                () = stopping.as_mut() => {}
            }
        }
        () = stopping.as_mut() => {}
    }
    connection.as_mut().graceful_shutdown();
    if let Ok(ended) = timeout(CLOSE, connection).await {
        log(ended);
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
        if timeout(limit, active.wait_for(|&n| n > 0)).await.is_err() {
            return;
        }
    }
}

/// One request of a connection under way, counted while this lives.
struct Busy(watch::Sender<usize>);

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

fn log(ended: Result<(), Box<dyn std::error::Error + Send + Sync>>) {
    if let Err(error) = ended {
        tracing::debug!(%error, "connection ended");
    }
}
