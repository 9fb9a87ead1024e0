//! The program in a process of its own, and sessions on it.

use std::io::{BufRead as _, BufReader, Read as _};
use std::net::SocketAddr;
use std::process::{Child, Command, Stdio};

use mlswarp::deform::Handle;

use crate::client::Client;

/// The program, on a free port; it ends with this value.
pub struct Service {
    pub address: SocketAddr,
    child: Child,
}

impl Service {
    pub fn start() -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_mlswarp"));
        command.args(["serve", "--listen", "127.0.0.1:0", "--log", "info"]);
        // What is set for this process is not meant for it, but for the level.
        let ours = std::env::vars_os()
            .map(|(name, _)| name)
            .filter(|name| name.to_string_lossy().starts_with("MLSWARP_"));
        for name in ours.filter(|name| name != "MLSWARP_LEVEL") {
            command.env_remove(name);
        }
        let mut child = command
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let mut log = BufReader::new(child.stderr.take().expect("piped"));
        let mut line = String::new();
        let address = loop {
            line.clear();
            assert_ne!(
                log.read_line(&mut line).expect("a log"),
                0,
                "the service ended before it listened"
            );
            if let Some((_, address)) = line.split_once("http://") {
                let end = address
                    .find(|c: char| !"0123456789.:".contains(c))
                    .unwrap_or(address.len());
                break address[..end].parse().expect("an address");
            }
        };
        std::thread::spawn(move || log.read_to_end(&mut Vec::new()));
        Self { address, child }
    }

    /// A session of its own; its path.
    pub fn session(&self, client: &mut Client, file: &[u8], warp: &str) -> String {
        let mut body = Vec::new();
        body.extend_from_slice(
            b"--boundary\r\nContent-Disposition: form-data; name=\"image\"; \
            filename=\"picture.png\"\r\n\r\n",
        );
        body.extend_from_slice(file);
        let part = format!(
            "\r\n--boundary\r\nContent-Disposition: form-data; \
                name=\"warp\"\r\n\r\n{warp}\r\n--boundary--\r\n"
        );
        body.extend_from_slice(part.as_bytes());
        let mut answer = Vec::new();
        client.send(
            &self.post("/sessions", "multipart/form-data; boundary=boundary", &body),
            |bytes| answer.extend_from_slice(bytes),
        );
        let session: serde_json::Value = serde_json::from_slice(&answer).expect("the session");
        format!("/sessions/{}", session["id"].as_str().expect("an id"))
    }

    /// A request whose answer a client takes.
    pub fn post(&self, path: &str, media_type: &str, body: &[u8]) -> Vec<u8> {
        let (address, length) = (self.address, body.len());
        let head = format!(
            "POST {path} HTTP/1.1\r\nHost: {address}\r\nContent-Type: \
                {media_type}\r\nContent-Length: {length}\r\n\r\n"
        );
        [head.as_bytes(), body].concat()
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// `[[x, y], ...]`
pub fn places(handles: &[Handle]) -> String {
    let places = handles
        .iter()
        .flat_map(Handle::places)
        .map(|p| format!("[{},{}]", p.x, p.y));
    format!("[{}]", places.collect::<Vec<_>>().join(","))
}
