//! STUB: the mathematics.
