//! A blocking WebSocket client that does as little as it can: prepared poses go out when they are
//! due, frames are counted and acknowledged, and no more of them is kept than is needed. It shares
//! the cores with the service, so what it saves the service gets.

use std::io::{self, BufRead as _, BufReader, Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::sync::{Mutex, mpsc};
use std::time::{Duration, Instant};

/// Of a message: the number, and the head of a PNG up to its width.
pub const HEAD: usize = 28;
const BUFFER: usize = 256 << 10;
/// Nothing takes so long.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A frame that was shown.
#[derive(Clone)]
pub struct ShownFrame {
    pub seq: u64,
    pub at: Instant,
    pub bytes: usize,
    /// What is kept of the message.
    pub message: Vec<u8>,
}

impl ShownFrame {
    /// Of a PNG, px.
    pub fn width(&self) -> u32 {
        u32::from_be_bytes(self.message[24..28].try_into().expect("the head of a file"))
    }
}

/// One drag: when each pose was sent, and what was shown.
pub struct Run {
    pub sent: Vec<Instant>,
    pub shown: Vec<ShownFrame>,
}

/// A message of the client's: small, and masked with zeros, which masks nothing.
pub fn text(text: &str) -> Vec<u8> {
    let mut message = vec![0x81];
    match u16::try_from(text.len()).expect("a short message") {
        length @ 0..126 => message.push(0x80 | length as u8),
        length => {
            message.push(0x80 | 126);
            message.extend(length.to_be_bytes());
        }
    }
    message.extend([0; 4]);
    message.extend_from_slice(text.as_bytes());
    message
}

/// An open socket.
pub struct Socket(BufReader<TcpStream>);

impl Socket {
    /// Opens a socket, or returns the status of the refusal.
    pub fn open(address: SocketAddr, path: &str) -> Result<Self, String> {
        let stream = TcpStream::connect(address).expect("the service listens");
        stream.set_nodelay(true).expect("a TCP socket");
        stream
            .set_read_timeout(Some(PATIENCE))
            .expect("a TCP socket");
        let mut reader = BufReader::with_capacity(BUFFER, stream);
        let head = format!(
            "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: Upgrade\r\nUpgrade: \
                websocket\r\nSec-WebSocket-Version: 13\r\n\
             Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        );
        reader
            .get_mut()
            .write_all(head.as_bytes())
            .expect("the service reads");
        let mut line = String::new();
        reader.read_line(&mut line).expect("the service answers");
        if !line.starts_with("HTTP/1.1 101") {
            return Err(line);
        }
        while line != "\r\n" {
            line.clear();
            reader.read_line(&mut line).expect("the service answers");
        }
        Ok(Self(reader))
    }

    /// Sends each pose when it is due after `start`, and shows frames until that of the last pose,
    /// or for so long after that was sent. Keeps this number of bytes of each message.
    pub fn drag(
        self,
        start: Instant,
        times: &[Duration],
        poses: &[Vec<u8>],
        patience: Duration,
        keep: usize,
    ) -> Run {
        let Self(mut reader) = self;
        let writer = &Mutex::new(reader.get_ref().try_clone().expect("a TCP socket"));
        let write = |message: &[u8]| writer.lock().expect("no writer panics").write_all(message);
        let (is_over, over) = mpsc::channel::<()>();
        std::thread::scope(|scope| {
            let sender = scope.spawn(move || {
                let send = |(due, pose): (&Duration, &Vec<u8>)| {
                    std::thread::sleep((start + *due).saturating_duration_since(Instant::now()));
                    let now = Instant::now();
                    write(pose).expect("the service reads");
                    now
                };
                let sent = times.iter().zip(poses).map(send).collect();
                let is_late = over.recv_timeout(patience) == Err(mpsc::RecvTimeoutError::Timeout);
                if is_late {
                    // Ends the other thread's read.
                    let _ = writer
                        .lock()
                        .expect("no writer panics")
                        .shutdown(Shutdown::Both);
                }
                (sent, is_late)
            });
            let mut shown = Vec::with_capacity(poses.len());
            let last = poses.len() as u64 - 1;
            let mut end = Ok(());
            while end.is_ok()
                && shown
                    .last()
                    .is_none_or(|frame: &ShownFrame| frame.seq != last)
            {
                end = next(&mut reader, keep).and_then(|frame| {
                    let Some(frame) = frame else { return Ok(()) };
                    let ack = text(&format!(r#"{{"ack":{}}}"#, frame.seq));
                    shown.push(frame);
                    write(&ack)
                });
            }
            drop(is_over);
            let (sent, is_late) = sender.join().expect("every pose was sent");
            assert!(
                is_late || end.is_ok(),
                "the service has ended the drag: {end:?}"
            );
            Run { sent, shown }
        })
    }
}

/// The next message, if it is a frame.
fn next(reader: &mut BufReader<TcpStream>, keep: usize) -> io::Result<Option<ShownFrame>> {
    let (mut opcode, mut bytes, mut message) = (0, 0, Vec::with_capacity(HEAD));
    loop {
        let mut start = [0; 2];
        reader.read_exact(&mut start)?;
        let length = match start[1] {
            126 => u64::from(u16::from_be_bytes(array(reader)?)),
            127 => u64::from_be_bytes(array(reader)?),
            length => u64::from(length),
        };
        if start[0] & 0xf != 0 {
            opcode = start[0] & 0xf;
        }
        let mut left = length as usize;
        bytes += left;
        while left > 0 {
            let part = reader.fill_buf()?;
            if part.is_empty() {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            let part = &part[..part.len().min(left)];
            message.extend_from_slice(&part[..part.len().min(keep - message.len())]);
            let taken = part.len();
            reader.consume(taken);
            left -= taken;
        }
        if start[0] & 0x80 != 0 {
            break;
        }
    }
    match opcode {
        2 => {
            let seq = u64::from_le_bytes(message[..8].try_into().expect("a number"));
            Ok(Some(ShownFrame {
                seq,
                at: Instant::now(),
                bytes,
                message,
            }))
        }
        8 => panic!("the service has closed the socket: {message:?}"),
        1 if message.starts_with(b"{\"actual") || message.starts_with(b"{\"code") => {
            panic!("{}", String::from_utf8_lossy(&message))
        }
        _ => Ok(None),
    }
}

fn array<const N: usize>(reader: &mut BufReader<TcpStream>) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    reader.read_exact(&mut bytes)?;
    Ok(bytes)
}
