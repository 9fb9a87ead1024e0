//! One integration binary: link once, and every topic is a module.
