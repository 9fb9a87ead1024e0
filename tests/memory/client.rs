//! A client that keeps its connection and its buffers: plain HTTP/1.1 over a socket, so that
//! nothing of it is in the service's figures.

use std::fmt::Write as _;
use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};

/// A connection that is kept.
pub(crate) struct Client {
    stream: TcpStream,
    head: String,
    answer: Vec<u8>,
}

/// An answer: its status, and where its body lies.
pub(crate) struct Answer<'a> {
    pub(crate) status: u16,
    pub(crate) body: &'a [u8],
}

impl Client {
    pub(crate) fn connect(address: SocketAddr) -> Self {
        let stream = TcpStream::connect(address).unwrap();
        stream.set_nodelay(true).unwrap();
        Self {
            stream,
            head: String::new(),
            answer: Vec::new(),
        }
    }

    /// Sends a request and reads its whole answer.
    pub(crate) fn post(&mut self, path: &str, media_type: &str, body: &[u8]) -> Answer<'_> {
        self.head.clear();
        write!(
            self.head,
            "POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Type: \
                {media_type}\r\nContent-Length: {}\r\n\r\n",
            body.len()
        )
        .unwrap();
        self.stream.write_all(self.head.as_bytes()).unwrap();
        self.stream.write_all(body).unwrap();
        self.answer.clear();
        let head = loop {
            if let Some(end) = find(&self.answer, b"\r\n\r\n") {
                break end + 4;
            }
            self.read();
        };
        let text = std::str::from_utf8(&self.answer[..head]).unwrap();
        let status = text[9..12].parse().unwrap();
        let length = text
            .split("\r\n")
            .find_map(|line| line.strip_prefix("content-length: "))
            .map(|n| n.parse::<usize>().unwrap());
        let end = match length {
            Some(length) => {
                while self.answer.len() < head + length {
                    self.read();
                }
                head + length
            }
            None => self.chunks(head),
        };
        Answer {
            status,
            body: &self.answer[head..end],
        }
    }

    /// Reads all chunks and moves them together; returns where the body ends.
    fn chunks(&mut self, head: usize) -> usize {
        let (mut from, mut to) = (head, head);
        loop {
            let line = loop {
                if let Some(end) = find(&self.answer[from..], b"\r\n") {
                    break end;
                }
                self.read();
            };
            let length = std::str::from_utf8(&self.answer[from..from + line]).unwrap();
            let length = usize::from_str_radix(length, 16).unwrap();
            from += line + 2;
            while self.answer.len() < from + length + 2 {
                self.read();
            }
            self.answer.copy_within(from..from + length, to);
            from += length + 2;
            to += length;
            if length == 0 {
                return to;
            }
        }
    }

    fn read(&mut self) {
        let filled = self.answer.len();
        self.answer.resize(filled + (64 << 10), 0);
        let read = self.stream.read(&mut self.answer[filled..]).unwrap();
        assert_ne!(read, 0, "the server has closed the connection");
        self.answer.truncate(filled + read);
    }
}

fn find(bytes: &[u8], wanted: &[u8]) -> Option<usize> {
    bytes
        .windows(wanted.len())
        .position(|window| window == wanted)
}
