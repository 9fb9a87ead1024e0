//! The program: `mlswarp` serves, `mlswarp warp` bends one picture offline, `mlswarp health` asks a running server.

fn main() {}
