//! Options of workers, queues and memory.

use std::time::Duration;

use clap::Args;

use super::available_memory;
use super::option::{Checked, Maybe, bytes, span, unless, whole};

/// The shortest automatic queue: a drag takes milliseconds, so that even one core serves this many.
pub(super) const MIN_QUEUE: usize = 64;
/// Memory for decoded images that `auto` gives at least, bytes: a picture of 24 megapixels with a
/// mask.
const MIN_IMAGE_CACHE: u64 = 512 << 20;
/// Tenths of the available memory that clients may use; the rest is for the program, its stacks,
/// the allocator and the kernel's buffers.
const MEMORY_TENTHS: u64 = 6;
/// The service does not start with less memory.
const MIN_MEMORY: u64 = 16 << 20;

/// Workers, queues and memory.
#[derive(Args, Clone, Copy, Debug, PartialEq, Eq)]
#[command(next_help_heading = "Workers and memory")]
pub struct WorkConfig {
    /// Number of requests that run at the same time, separately for drags and for uploads; each has
    /// a compute thread. auto = number of cores.
    #[arg(long, value_name = "N", default_value = "auto", value_parser = Checked(workers))]
    pub workers: usize,
    /// Number of drags, and of uploads, that may wait for a worker; further ones are answered 503.
    /// auto = 4 times the workers, at least 64.
    #[arg(long, value_name = "N", default_value = "auto",
        value_parser = Checked(unless("auto", whole::<usize>(0, 100_000))))]
    queue: Maybe<usize>,
    /// Maximum time that a drag waits for a worker; then it is answered 503.
    #[arg(long, value_name = "TIME", default_value = "200ms", value_parser = Checked(span))]
    pub drag_wait: Duration,
    /// Maximum time that an upload, or a drag whose image or plan must be rebuilt, waits for a
    /// worker; then it is answered 503.
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = Checked(span))]
    pub upload_wait: Duration,
    /// Memory for uploads, images, plans, responses and sockets. auto = 6 tenths of the memory of
    /// the machine or of the control group.
    #[arg(long, value_name = "SIZE", default_value = "auto", value_parser = Checked(memory_bytes))]
    pub memory_bytes: u64,
    /// Part of `--memory-bytes` that decoded images may use while no request uses them. auto = a
    /// quarter of it, at least 512 MiB.
    #[arg(long, value_name = "SIZE", default_value = "auto",
        value_parser = Checked(unless("auto", bytes)))]
    image_cache_bytes: Maybe<u64>,
    /// Part of `--memory-bytes` that plans may use while no request uses them.
    #[arg(long, value_name = "SIZE", default_value = "512MiB", value_parser = Checked(bytes))]
    pub plan_cache_bytes: u64,
}

impl WorkConfig {
    /// Number of drags, and of uploads, that may wait for a worker.
    pub fn queue(&self) -> usize {
        self.queue
            .unwrap_or_else(|| (4 * self.workers).max(MIN_QUEUE))
    }

    /// Memory for decoded images that no request uses. Requests that need
    /// memory evict them, so a large part costs nobody a refusal.
    pub fn image_cache_bytes(&self) -> u64 {
        self.image_cache_bytes
            .unwrap_or_else(|| (self.memory_bytes / 4).max(MIN_IMAGE_CACHE))
    }
}

fn workers(text: &str) -> Result<usize, String> {
    let cores = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    if text == "auto" {
        Ok(cores())
    } else {
        whole(1, 1024)(text)
    }
}

fn memory_bytes(text: &str) -> Result<u64, String> {
    if text == "auto" {
        return Ok((available_memory::bytes() / 10 * MEMORY_TENTHS).max(MIN_MEMORY));
    }
    let bytes = bytes(text)?;
    if bytes < MIN_MEMORY {
        Err(format!("`{text}` is less than {} MiB", MIN_MEMORY >> 20))
    } else {
        Ok(bytes)
    }
}
