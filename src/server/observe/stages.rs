//! How long the stages of a picture took, as responses, metrics and traces give it.

use std::time::Duration;

/// Wall time of the steps before drawing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Timing {
    /// Waiting for a worker.
    pub queue: Duration,
    /// Digest and decoding of the file, or waiting for who does.
    pub decode: Duration,
    /// The table of coefficients, or waiting for who fills it.
    pub plan: Duration,
    /// Posing the grid.
    pub deform: Duration,
}

/// Processor time of drawing, all threads together.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cost {
    /// Mesh to pixels.
    pub render: Duration,
    /// Pixels to the bytes of a file.
    pub encode: Duration,
}
