//! A blocking HTTP/1.1 client that does as little as it can: prepared bytes go out, an answer's
//! body is counted, nothing is allocated. It shares the cores with the service, so what it saves
//! the service gets.

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

/// Larger than the socket's buffer: one read takes what there is.
const BUFFER: usize = 256 << 10;

/// One connection, kept alive.
pub struct Client {
    stream: BufReader<TcpStream>,
    line: String,
}

impl Client {
    pub fn connect(address: SocketAddr) -> Self {
        let stream = TcpStream::connect(address).expect("the service listens");
        stream.set_nodelay(true).expect("a TCP socket");
        Self {
            stream: BufReader::with_capacity(BUFFER, stream),
            line: String::new(),
        }
    }

    /// Sends a whole request and hands the body of its answer to `body`, piece by piece. Status 2xx
    /// only.
    pub fn send(&mut self, request: &[u8], mut body: impl FnMut(&[u8])) {
        self.stream
            .get_mut()
            .write_all(request)
            .expect("the service reads");
        let status = self.line().to_owned();
        let (mut length, mut chunked) = (0, false);
        loop {
            let line = self.line();
            if line.is_empty() {
                break;
            }
            let (name, value) = line.split_once(':').expect("a header");
            if name.eq_ignore_ascii_case("content-length") {
                length = value.trim().parse().expect("a length");
            } else if name.eq_ignore_ascii_case("transfer-encoding") {
                chunked = value.trim() == "chunked";
            }
        }
        if chunked {
            loop {
                let size = usize::from_str_radix(self.line(), 16).expect("a chunk's size");
                self.take(size, &mut body);
                self.line();
                if size == 0 {
                    break;
                }
            }
        } else {
            self.take(length, &mut body);
        }
        assert!(status.starts_with("HTTP/1.1 2"), "{status}");
    }

    fn line(&mut self) -> &str {
        self.line.clear();
        self.stream
            .read_line(&mut self.line)
            .expect("the service answers");
        self.line.trim_end()
    }

    fn take(&mut self, mut size: usize, body: &mut impl FnMut(&[u8])) {
        while size > 0 {
            let bytes = self.stream.fill_buf().expect("the service answers");
            assert!(!bytes.is_empty(), "the answer breaks off");
            let part = bytes.len().min(size);
            body(&bytes[..part]);
            self.stream.consume(part);
            size -= part;
        }
    }
}

/// What a number of connections saw.
#[derive(Default)]
pub struct Load {
    /// Seconds of every request.
    pub latencies: Vec<f64>,
    /// Seconds that the connections worked side by side.
    pub elapsed: f64,
}

impl Load {
    /// Every client sends its requests one after the other, each as soon as it has the answer to
    /// the last, for so long.
    pub fn run(clients: &mut [(Client, Vec<Vec<u8>>)], time: Duration) -> Self {
        let start = Instant::now();
        let drag = |(client, requests): &mut (Client, Vec<Vec<u8>>)| {
            let mut latencies = Vec::new();
            for request in requests.iter().cycle() {
                let sent = Instant::now();
                client.send(request, |_| {});
                latencies.push(sent.elapsed().as_secs_f64());
                if start.elapsed() >= time {
                    break;
                }
            }
            latencies
        };
        let latencies = std::thread::scope(|scope| {
            let drags: Vec<_> = clients
                .iter_mut()
                .map(|client| scope.spawn(move || drag(client)))
                .collect();
            drags
                .into_iter()
                .flat_map(|drag| drag.join().expect("every answer is a picture"))
                .collect()
        });
        Self {
            latencies,
            elapsed: start.elapsed().as_secs_f64(),
        }
    }

    pub fn add(&mut self, other: Self) {
        self.latencies.extend(other.latencies);
        self.elapsed += other.elapsed;
    }
}
