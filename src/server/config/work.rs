//! Workers, queues, and memory.

use std::time::Duration;

use clap::Args;

use super::{Mistakes, cores, memory, units, whole};

/// Even one core serves a page full of hands: a drag takes milliseconds.
pub(crate) const LEAST_QUEUE: usize = 64;
/// The account's part of the memory that there is, in tenths: the rest is for the program, its stacks, the allocator's waste and the kernel's buffers.
const TENTHS: u64 = 6;
/// Less is no service.
const LEAST_MEMORY: u64 = 16 << 20;

/// The options, as text.
#[derive(Debug, Args)]
pub struct WorkOptions {
    /// Threads that compute, and requests that run at one time, once for drags and once for uploads; auto = one a core.
    #[arg(long, env = "MLSWARP_WORKERS", value_name = "N", default_value = "auto", global = true)]
    workers: String,
    /// Drags, and uploads, that may wait for a worker; beyond that 503. auto = 4 times the workers, at least 64.
    #[arg(long, env = "MLSWARP_QUEUE", value_name = "N", default_value = "auto", global = true)]
    queue: String,
    /// Longest wait of a drag for a worker; then 503.
    #[arg(long, env = "MLSWARP_DRAG_WAIT", value_name = "TIME", default_value = "200ms", global = true)]
    drag_wait: String,
    /// Longest wait of an upload for a worker, and of a drag whose picture or plan must be made again; then 503.
    #[arg(long, env = "MLSWARP_UPLOAD_WAIT", value_name = "TIME", default_value = "5s", global = true)]
    upload_wait: String,
    /// Memory for all that clients cause: uploads, pictures, plans, answers, sockets. auto = 6 tenths of the machine's or the control group's.
    #[arg(long, env = "MLSWARP_MEMORY_BYTES", value_name = "SIZE", default_value = "auto", global = true)]
    memory_bytes: String,
    /// Of that, most for decoded pictures that nobody uses now.
    #[arg(long, env = "MLSWARP_IMAGE_CACHE_BYTES", value_name = "SIZE", default_value = "512MiB", global = true)]
    image_cache_bytes: String,
    /// Of that, most for tables of coefficients that nobody uses now.
    #[arg(long, env = "MLSWARP_PLAN_CACHE_BYTES", value_name = "SIZE", default_value = "512MiB", global = true)]
    plan_cache_bytes: String,
}

/// Workers, queues and memory, checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WorkConfig {
    /// Threads that compute, and requests that run at one time, once for drags and once for uploads.
    pub workers: usize,
    /// Drags, and uploads, that may wait for a worker.
    pub queue: usize,
    /// Longest wait of a drag.
    pub drag_wait: Duration,
    /// Longest wait of an upload.
    pub upload_wait: Duration,
    /// Memory for all that clients cause.
    pub memory_bytes: u64,
    /// Of that, most for decoded pictures that nobody uses now.
    pub image_cache_bytes: u64,
    /// Of that, most for tables of coefficients that nobody uses now.
    pub plan_cache_bytes: u64,
}

impl WorkOptions {
    pub(crate) fn resolve(&self, m: &mut Mistakes) -> WorkConfig {
        let auto = |text: &str| text == "auto";
        let workers = m.read("workers", &self.workers, |t| if auto(t) { Ok(cores()) } else { whole(t, 1, 1024) });
        let queue = |t: &str| if auto(t) { Ok((4 * workers).max(LEAST_QUEUE)) } else { whole(t, 0, 100_000) };
        WorkConfig {
            workers,
            queue: m.read("queue", &self.queue, queue),
            drag_wait: m.read("drag-wait", &self.drag_wait, units::span),
            upload_wait: m.read("upload-wait", &self.upload_wait, units::span),
            memory_bytes: m.read("memory-bytes", &self.memory_bytes, |t| if auto(t) { Ok(usual_memory()) } else { memory_bytes(t) }),
            image_cache_bytes: m.read("image-cache-bytes", &self.image_cache_bytes, units::bytes),
            plan_cache_bytes: m.read("plan-cache-bytes", &self.plan_cache_bytes, units::bytes),
        }
    }
}

fn usual_memory() -> u64 {
    (memory::available() / 10 * TENTHS).max(LEAST_MEMORY)
}

fn memory_bytes(text: &str) -> Result<u64, String> {
    let bytes = units::bytes(text)?;
    if bytes < LEAST_MEMORY { Err(format!("`{text}` is less than {} MiB", LEAST_MEMORY >> 20)) } else { Ok(bytes) }
}
