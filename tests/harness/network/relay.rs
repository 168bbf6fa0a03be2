//! A link with a delay: the kernel's own (netem) is not everywhere.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use anyhow::Result;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;
use tokio::time::Instant;

/// Pieces that are on their way at one time, each of 64 KiB at most.
const ON_THE_WAY: usize = 256;

/// Passes on what it gets, later and in order.
#[derive(Debug)]
pub struct Relay {
    address: SocketAddr,
    delay: Arc<Delay>,
}

/// How long everything takes, each way: at least, and up to so much more, anew for each piece.
#[derive(Debug, Default)]
struct Delay {
    least_ms: AtomicU64,
    jitter_ms: AtomicU64,
}

impl Delay {
    fn draw(&self) -> Duration {
        let jitter = rand::random_range(0..=self.jitter_ms.load(Ordering::Relaxed));
        Duration::from_millis(self.least_ms.load(Ordering::Relaxed) + jitter)
    }
}

impl Relay {
    /// Listens on this host for connections to `target`.
    ///
    /// # Errors
    /// If there is no free port.
    pub async fn start(target: SocketAddr) -> Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0").await?;
        let address = listener.local_addr()?;
        let delay = Arc::new(Delay::default());
        let of_all = Arc::clone(&delay);
        tokio::spawn(async move {
            while let Ok((near, _)) = listener.accept().await {
                let delay = Arc::clone(&of_all);
                tokio::spawn(async move {
                    let Ok(far) = TcpStream::connect(target).await else {
                        return;
                    };
                    let ((from_near, to_near), (from_far, to_far)) = (near.into_split(), far.into_split());
                    tokio::spawn(pass(from_near, to_far, Arc::clone(&delay)));
                    pass(from_far, to_near, delay).await;
                });
            }
        });
        Ok(Self { address, delay })
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// How long everything takes from now on, each way, in whole milliseconds.
    pub fn set_delay(&self, delay: Duration) {
        self.delay.least_ms.store(ms(delay), Ordering::Relaxed);
    }

    /// How much longer than that a piece may take, drawn anew for each.
    pub fn set_jitter(&self, most: Duration) {
        self.delay.jitter_ms.store(ms(most), Ordering::Relaxed);
    }
}

fn ms(duration: Duration) -> u64 {
    u64::try_from(duration.as_millis()).unwrap_or(u64::MAX)
}

/// One way, until either end closes.
async fn pass(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, delay: Arc<Delay>) {
    let (sender, mut receiver) = mpsc::channel::<(Instant, Vec<u8>)>(ON_THE_WAY);
    tokio::spawn(async move {
        while let Some((due, piece)) = receiver.recv().await {
            tokio::time::sleep_until(due).await;
            if to.write_all(&piece).await.is_err() {
                break;
            }
        }
    });
    let mut buffer = vec![0; 64 << 10];
    while let Ok(count @ 1..) = from.read(&mut buffer).await {
        let due = Instant::now() + delay.draw();
        if sender.send((due, buffer[..count].to_vec())).await.is_err() {
            break;
        }
    }
}
