//! HTTP/2 written frame by frame (RFC 9113).

use std::net::SocketAddr;
use std::time::Duration;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};

pub(crate) const DATA: u8 = 0;
pub(crate) const HEADERS: u8 = 1;
pub(crate) const RST_STREAM: u8 = 3;
pub(crate) const SETTINGS: u8 = 4;
pub(crate) const PING: u8 = 6;
pub(crate) const GOAWAY: u8 = 7;
pub(crate) const WINDOW_UPDATE: u8 = 8;
pub(crate) const CONTINUATION: u8 = 9;

/// Flags.
pub(crate) const ACK: u8 = 1;
pub(crate) const END_STREAM: u8 = 1;
pub(crate) const END_HEADERS: u8 = 4;

/// Methods of the static table.
pub(crate) const GET: u8 = 0x82;
pub(crate) const POST: u8 = 0x83;

/// A frame as bytes.
pub(crate) fn frame(kind: u8, flags: u8, stream: u32, payload: &[u8]) -> Vec<u8> {
    let length = (payload.len() as u32).to_be_bytes();
    [&length[1..], &[kind, flags], &stream.to_be_bytes(), payload].concat()
}

/// HPACK without a table: indexed where the static table has it, else literals. No `:authority`
/// where it is empty.
pub(crate) fn block(method: u8, path: &str, authority: &str, fields: &[(&str, &str)]) -> Vec<u8> {
    let text = |text: &str| [&[text.len() as u8], text.as_bytes()].concat();
    let mut block = [&[method, 0x86, 0x04][..], &text(path)].concat();
    if !authority.is_empty() {
        block.extend([&[0x01][..], &text(authority)].concat());
    }
    for (name, value) in fields {
        block.extend([&[0x00][..], &text(name), &text(value)].concat());
    }
    block
}

/// A client of HTTP/2 that says what it wants, frame by frame, and answers every ping.
pub(crate) struct Frames {
    pub(crate) reader: Reader,
    pub(crate) write: OwnedWriteHalf,
}

/// What the server says.
pub(crate) struct Reader {
    stream: OwnedReadHalf,
    read: Vec<u8>,
}

#[derive(Debug)]
pub(crate) struct Frame {
    pub(crate) kind: u8,
    pub(crate) flags: u8,
    pub(crate) stream: u32,
    pub(crate) payload: Vec<u8>,
}

impl Frames {
    /// `window`: what each of its streams may be sent.
    pub(crate) async fn open(address: SocketAddr, window: u32) -> Self {
        Self::over(TcpStream::connect(address).await.unwrap(), window).await
    }

    pub(crate) async fn over(stream: TcpStream, window: u32) -> Self {
        let (read, write) = stream.into_split();
        let mut frames = Self {
            reader: Reader {
                stream: read,
                read: Vec::new(),
            },
            write,
        };
        frames
            .write
            .write_all(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n")
            .await
            .unwrap();
        frames
            .say(
                SETTINGS,
                0,
                0,
                &[&[0, 4][..], &window.to_be_bytes()].concat(),
            )
            .await;
        frames
    }

    pub(crate) async fn say(&mut self, kind: u8, flags: u8, stream: u32, payload: &[u8]) {
        // The server may have closed: the next read shows that.
        let _ = self
            .write
            .write_all(&frame(kind, flags, stream, payload))
            .await;
    }

    pub(crate) async fn request(&mut self, stream: u32, method: u8, path: &str, is_whole: bool) {
        let block = block(
            method,
            path,
            "localhost",
            &[("content-type", "application/json")],
        );
        self.say(
            HEADERS,
            END_HEADERS | if is_whole { END_STREAM } else { 0 },
            stream,
            &block,
        )
        .await;
    }

    /// The next frame that is neither a ping nor settings; none at the end of the connection.
    pub(crate) async fn next(&mut self) -> Option<Frame> {
        loop {
            let frame = self.reader.next().await?;
            match (frame.kind, frame.flags & ACK) {
                (PING, 0) => self.say(PING, ACK, 0, &frame.payload).await,
                (SETTINGS, 0) => self.say(SETTINGS, ACK, 0, &[]).await,
                (PING | SETTINGS, _) => {}
                _ => return Some(frame),
            }
        }
    }
}

impl Reader {
    /// The next frame; none at the end of the connection.
    pub(crate) async fn next(&mut self) -> Option<Frame> {
        let mut piece = [0; 16 << 10];
        while self.read.len() < 9 || self.read.len() < 9 + length(&self.read) {
            match tokio::time::timeout(Duration::from_secs(60), self.stream.read(&mut piece))
                .await
                .expect("the server says something")
            {
                Ok(0) | Err(_) => return None,
                Ok(read) => self.read.extend_from_slice(&piece[..read]),
            }
        }
        let rest = self.read.split_off(9 + length(&self.read));
        let whole = std::mem::replace(&mut self.read, rest);
        let stream = u32::from_be_bytes(whole[5..9].try_into().unwrap());
        Some(Frame {
            kind: whole[3],
            flags: whole[4],
            stream,
            payload: whole[9..].to_vec(),
        })
    }
}

fn length(read: &[u8]) -> usize {
    u32::from_be_bytes([0, read[0], read[1], read[2]]) as usize
}
