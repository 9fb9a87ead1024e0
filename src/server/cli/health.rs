//! `mlswarp health`: sends `GET /readyz` to a running server. With TLS, it trusts the configured
//! certificate alone.

use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, TcpStream};
use std::time::Duration;

use crate::config::Config;

/// The longest time of connecting, of each write and of each read.
const TIMEOUT: Duration = Duration::from_secs(3);
/// Bytes of a response that are read: its head, and the words about a wrong protocol.
const RESPONSE_BYTES: u64 = 4096;

/// Whether the server can take work now. Errors: it cannot be reached, or is not ready. The
/// sentence names the address, and what selects another.
pub fn ask(config: &Config) -> Result<(), String> {
    // The ops listener has no TLS and connections of its own.
    let ops = config.telemetry.metrics_listen;
    let address = reachable(ops.unwrap_or(config.listen));
    let stream = TcpStream::connect_timeout(&address, TIMEOUT).map_err(|e| {
        let option = if ops.is_some() {
            "--metrics-listen (MLSWARP_METRICS_LISTEN)"
        } else {
            "--listen (MLSWARP_LISTEN)"
        };
        format!(
            "no server answers at {address}: {e}; start it there, or give its address with {option}"
        )
    })?;
    let tls = config.auth.tls.as_ref().filter(|_| ops.is_none());
    let answer = set_timeouts(&stream).and_then(|()| match tls {
        Some(files) => response(files.connect(stream, address.ip())?, address),
        None => response(stream, address),
    });
    match answer {
        Ok(answer) if answer.starts_with("HTTP/1.1 200") => Ok(()),
        Ok(answer) if answer.is_empty() => Err(format!(
            "the server at {address} closes the connection without a response"
        )),
        Ok(answer) if tls.is_none() && wants_tls(&answer) => Err(format!(
            "the server at {address} serves HTTPS: give --tls-cert (MLSWARP_TLS_CERT) and \
                --tls-key (MLSWARP_TLS_KEY)"
        )),
        Ok(answer) => Err(format!(
            "the server at {address} is not ready: {}",
            answer.lines().next().unwrap_or_default()
        )),
        Err(_) if tls.is_some() && serves_plain_http(address) => Err(format!(
            "the server at {address} serves plain HTTP: leave out --tls-cert (MLSWARP_TLS_CERT) \
                and --tls-key"
        )),
        Err(e) => Err(format!(
            "the server at {address} does not answer GET /readyz: {e}"
        )),
    }
}

/// Whether this is the answer of a TLS port to plain HTTP: an alert, or the words of this server,
/// of nginx and of others.
fn wants_tls(answer: &str) -> bool {
    answer.starts_with("\u{15}\u{3}")
        || (answer.starts_with("HTTP/1.1 400") && answer.contains("HTTPS"))
}

fn serves_plain_http(address: SocketAddr) -> bool {
    let stream = TcpStream::connect_timeout(&address, TIMEOUT)
        .and_then(|stream| set_timeouts(&stream).map(|()| stream));
    stream
        .and_then(|stream| response(stream, address))
        .is_ok_and(|answer| answer.starts_with("HTTP/") && !wants_tls(&answer))
}

fn set_timeouts(stream: &TcpStream) -> io::Result<()> {
    stream.set_read_timeout(Some(TIMEOUT))?;
    stream.set_write_timeout(Some(TIMEOUT))
}

/// The beginning of the response.
fn response(mut stream: impl Read + Write, address: SocketAddr) -> io::Result<String> {
    stream.write_all(
        format!("GET /readyz HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").as_bytes(),
    )?;
    let mut read = Vec::new();
    match stream.take(RESPONSE_BYTES).read_to_end(&mut read) {
        // Some servers end a connection without the end of its encryption.
        Err(error) if read.is_empty() => Err(error),
        _ => Ok(String::from_utf8_lossy(&read).into_owned()),
    }
}

/// Replaces an unspecified address by the loopback.
fn reachable(mut listen: SocketAddr) -> SocketAddr {
    if listen.ip().is_unspecified() {
        listen.set_ip(if listen.is_ipv4() {
            Ipv4Addr::LOCALHOST.into()
        } else {
            Ipv6Addr::LOCALHOST.into()
        });
    }
    listen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unspecified_addresses_are_asked_on_the_loopback() {
        for (listen, asked) in [
            ("0.0.0.0:80", "127.0.0.1:80"),
            ("[::]:81", "[::1]:81"),
            ("10.0.0.1:82", "10.0.0.1:82"),
        ] {
            assert_eq!(reachable(listen.parse().unwrap()), asked.parse().unwrap());
        }
    }
}
