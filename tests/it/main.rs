//! One integration binary: linked once, one module a topic. Name the topic first, then the law.

mod golden;
mod identity;
mod laws;
mod oracle;
