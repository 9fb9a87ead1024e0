//! Durations of the stages of an image, as `Server-Timing` and the metrics report them.

use std::time::Duration;

/// Wall time of the stages before drawing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Timing {
    /// Waiting for a worker.
    pub queue: Duration,
    /// Hashing and decoding the file, or waiting for another request that does.
    pub decode: Duration,
    /// Building the table of coefficients, or waiting for another request that does.
    pub plan: Duration,
    /// Making copies of the image for its size in the output, or waiting for another request that
    /// does.
    pub reduce: Duration,
    /// Posing the grid.
    pub deform: Duration,
}

impl Timing {
    /// The times of a request that has waited this long for a worker, and done nothing yet.
    pub(crate) fn queued(queue: Duration) -> Self {
        Self {
            queue,
            ..Self::default()
        }
    }
}

/// Processor time of drawing, summed over all threads.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cost {
    /// Mesh to pixels.
    pub render: Duration,
    /// Pixels to the bytes of a file.
    pub encode: Duration,
}
