//! A relay before a Redis that can be slow: the answers to some commands are held until the test
//! lets them go.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;

use super::redis::Redis;

/// The relay; it ends with the test's runtime.
pub(crate) struct Relay {
    address: SocketAddr,
    /// The command whose answers are held.
    held: watch::Sender<Option<&'static str>>,
    seen: Arc<AtomicUsize>,
}

impl Relay {
    pub(crate) async fn start(server: &Redis) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let relay = Self {
            address: listener.local_addr().unwrap(),
            held: watch::Sender::new(None),
            seen: Arc::default(),
        };
        let there = server.address().replace("redis://", "");
        let (held, seen) = (relay.held.clone(), Arc::clone(&relay.seen));
        tokio::spawn(async move {
            while let Ok((near, _)) = listener.accept().await {
                let (near, far) = (
                    near.into_split(),
                    TcpStream::connect(&there).await.unwrap().into_split(),
                );
                // Whether this connection has asked what is answered late.
                let is_slow = watch::Sender::new(false);
                tokio::spawn(answers(
                    far.0,
                    near.1,
                    is_slow.subscribe(),
                    held.subscribe(),
                ));
                tokio::spawn(questions(
                    near.0,
                    far.1,
                    is_slow,
                    held.subscribe(),
                    Arc::clone(&seen),
                ));
            }
        });
        relay
    }

    /// The address for `--store`.
    pub(crate) fn address(&self) -> String {
        format!("redis://{}", self.address)
    }

    /// From now on the answers to this command are held, and all that comes after them on the same
    /// connection. `None` lets all of them go.
    pub(crate) fn hold(&self, command: Option<&'static str>) {
        self.held.send_replace(command);
    }

    /// Commands whose answers were held, so far.
    pub(crate) fn held(&self) -> usize {
        self.seen.load(Ordering::SeqCst)
    }
}

async fn questions(
    mut near: OwnedReadHalf,
    mut far: OwnedWriteHalf,
    is_slow: watch::Sender<bool>,
    held: watch::Receiver<Option<&'static str>>,
    seen: Arc<AtomicUsize>,
) {
    let mut bytes = vec![0; 1 << 16];
    while let Ok(n @ 1..) = near.read(&mut bytes).await {
        let command = *held.borrow();
        if let Some(command) = command {
            let word = format!("\r\n${}\r\n{command}\r\n", command.len());
            let times = bytes[..n]
                .windows(word.len())
                .filter(|window| *window == word.as_bytes())
                .count();
            is_slow.send_if_modified(|is| times > 0 && !std::mem::replace(is, true));
            seen.fetch_add(times, Ordering::SeqCst);
        }
        if far.write_all(&bytes[..n]).await.is_err() {
            return;
        }
    }
}

async fn answers(
    mut far: OwnedReadHalf,
    mut near: OwnedWriteHalf,
    is_slow: watch::Receiver<bool>,
    mut held: watch::Receiver<Option<&'static str>>,
) {
    let mut bytes = vec![0; 1 << 16];
    while let Ok(n @ 1..) = far.read(&mut bytes).await {
        let is_slow = *is_slow.borrow();
        if is_slow && held.wait_for(Option::is_none).await.is_err() {
            return;
        }
        if near.write_all(&bytes[..n]).await.is_err() {
            return;
        }
    }
}
