//! `mlswarp health`: asks `GET /readyz` of the server at the listen address, or at that of its metrics where it has one, over a plain socket with a deadline. For health checks of
//! containers: no shell, no HTTP client, no runtime. Where the server speaks TLS, its own certificate is the one that is taken.

use std::io::{self, Read, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpStream};
use std::time::Duration;

use crate::config::Config;

/// Longest wait for each of connecting, asking and answering.
const PATIENCE: Duration = Duration::from_secs(3);
/// Enough for a status line.
const STATUS_LINE: usize = 64;

/// Whether the server can take work now.
///
/// # Errors
/// It cannot be reached, or says no.
pub fn ask(config: &Config) -> io::Result<()> {
    let watched = config.telemetry.metrics_listen;
    let address = reachable(watched.unwrap_or(config.listen));
    let stream = TcpStream::connect_timeout(&address, PATIENCE)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    // There nobody speaks TLS, and no crowd of clients keeps this one out.
    let Some(files) = config.access.tls.as_ref().filter(|_| watched.is_none()) else { return ask_over(stream, address) };
    ask_over(files.connect(stream, address.ip())?, address)
}

fn ask_over(mut stream: impl Read + Write, address: SocketAddr) -> io::Result<()> {
    stream.write_all(format!("GET /readyz HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").as_bytes())?;
    let mut line = Vec::with_capacity(STATUS_LINE);
    stream.take(STATUS_LINE as u64).read_to_end(&mut line)?;
    let status = line.split(|b| *b == b'\r').next().unwrap_or_default();
    if status.starts_with(b"HTTP/1.1 200") {
        return Ok(());
    }
    Err(io::Error::other(format!("not ready: {}", String::from_utf8_lossy(status))))
}

/// An address that means "all of them" is asked on the loopback.
fn reachable(listen: SocketAddr) -> SocketAddr {
    let ip = match listen.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => IpAddr::V4(Ipv4Addr::LOCALHOST),
        IpAddr::V6(ip) if ip.is_unspecified() => IpAddr::V6(Ipv6Addr::LOCALHOST),
        ip => ip,
    };
    SocketAddr::new(ip, listen.port())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unspecified_addresses_are_asked_on_the_loopback() {
        for (listen, asked) in [("0.0.0.0:80", "127.0.0.1:80"), ("[::]:81", "[::1]:81"), ("10.0.0.1:82", "10.0.0.1:82")] {
            assert_eq!(reachable(listen.parse().unwrap()), asked.parse().unwrap());
        }
    }
}
