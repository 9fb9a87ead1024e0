//! A blocking WebSocket client that does as little as it can: prepared poses go out when they are due, frames are counted and acknowledged, and
//! nothing of them is kept. It shares the cores with the service, so what it saves the service gets.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

/// What is kept of each message: the number, and the head of a PNG up to its width.
const HEAD: usize = 28;
const BUFFER: usize = 256 << 10;
/// Nothing takes so long.
const PATIENCE: Duration = Duration::from_secs(60);

/// A frame that was shown.
#[derive(Clone, Copy)]
pub struct Shown {
    pub seq: u64,
    pub at: Instant,
    pub bytes: usize,
    /// Of a PNG, px.
    pub width: u32,
}

/// One drag: when each pose was sent, and what was shown.
pub struct Run {
    pub sent: Vec<Instant>,
    pub shown: Vec<Shown>,
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

/// Sends each pose when it is due after `start`, and shows frames until that of the last pose.
pub fn drag(address: SocketAddr, path: &str, start: Instant, times: &[Duration], poses: &[Vec<u8>]) -> Run {
    let stream = TcpStream::connect(address).expect("the service listens");
    stream.set_nodelay(true).expect("a TCP socket");
    stream.set_read_timeout(Some(PATIENCE)).expect("a TCP socket");
    let mut reader = BufReader::with_capacity(BUFFER, stream);
    let head = format!(
        "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    );
    reader.get_mut().write_all(head.as_bytes()).expect("the service reads");
    let mut line = String::new();
    reader.read_line(&mut line).expect("the service answers");
    assert!(line.starts_with("HTTP/1.1 101"), "{line}");
    while line != "\r\n" {
        line.clear();
        reader.read_line(&mut line).expect("the service answers");
    }
    let mut writer = reader.get_ref().try_clone().expect("a TCP socket");
    std::thread::scope(|scope| {
        let sender = scope.spawn(move || {
            let send = |(due, pose): (&Duration, &Vec<u8>)| {
                std::thread::sleep((start + *due).saturating_duration_since(Instant::now()));
                let now = Instant::now();
                writer.write_all(pose).expect("the service reads");
                now
            };
            times.iter().zip(poses).map(send).collect()
        });
        let mut shown = Vec::with_capacity(poses.len());
        let last = poses.len() as u64 - 1;
        while shown.last().is_none_or(|frame: &Shown| frame.seq != last) {
            if let Some(frame) = next(&mut reader) {
                let ack = text(&format!(r#"{{"ack":{}}}"#, frame.seq));
                reader.get_mut().write_all(&ack).expect("the service reads");
                shown.push(frame);
            }
        }
        Run { sent: sender.join().expect("every pose was sent"), shown }
    })
}

/// The next message, if it is a frame.
fn next(reader: &mut BufReader<TcpStream>) -> Option<Shown> {
    let (mut opcode, mut bytes, mut head) = (0, 0, Vec::with_capacity(HEAD));
    loop {
        let mut start = [0; 2];
        reader.read_exact(&mut start).expect("the service answers");
        let length = match start[1] {
            126 => u64::from(u16::from_be_bytes(array(reader))),
            127 => u64::from_be_bytes(array(reader)),
            length => u64::from(length),
        };
        if start[0] & 0xf != 0 {
            opcode = start[0] & 0xf;
        }
        let mut left = length as usize;
        bytes += left;
        while left > 0 {
            let part = reader.fill_buf().expect("the service answers");
            assert!(!part.is_empty(), "the frame breaks off");
            let part = &part[..part.len().min(left)];
            head.extend_from_slice(&part[..part.len().min(HEAD - head.len())]);
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
            let seq = u64::from_le_bytes(head[..8].try_into().expect("a number"));
            let width = u32::from_be_bytes(head[24..28].try_into().expect("the head of a file"));
            Some(Shown { seq, at: Instant::now(), bytes, width })
        }
        8 => panic!("the service has closed the socket: {head:?}"),
        1 if head.starts_with(b"{\"actual") || head.starts_with(b"{\"code") => panic!("{}", String::from_utf8_lossy(&head)),
        _ => None,
    }
}

fn array<const N: usize>(reader: &mut BufReader<TcpStream>) -> [u8; N] {
    let mut bytes = [0; N];
    reader.read_exact(&mut bytes).expect("the service answers");
    bytes
}
