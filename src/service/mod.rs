//! STUB: the application.
