//! What is going on inside.

/// What is going on inside, for `/readyz` and logs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Health {
    /// Worker threads in all.
    pub workers: usize,
    /// Those that have matched their dummy pair.
    pub workers_primed: usize,
    /// Those that could not match it.
    pub workers_failed: usize,
    /// Whether a worker got stuck and no more are replaced.
    pub is_crippled: bool,
    /// Requests that wait for a worker.
    pub queue_depth: usize,
    /// Whether new work is refused because the server is stopping.
    pub is_draining: bool,
}
