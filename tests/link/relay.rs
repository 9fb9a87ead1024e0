//! A TCP relay with the rate and the delay of a link. In each direction, bytes wait in a bounded
//! queue, leave it at the rate of the link, and arrive after the delay. When the queue is full, the
//! relay reads nothing more from the sender. All connections share the rate.
//!
//! A lost packet is modelled as a pause: TCP repeats it, and until then nothing that was sent after
//! it can be read.

#![allow(
    dead_code,
    reason = "each of the programs that share this file uses a part of it"
)]

use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::task::{JoinHandle, JoinSet};
use tokio::time::sleep_until;

/// What the kernel holds for each of the relay's sockets, bytes. Its default of megabytes would be
/// a second queue.
const SOCKET_BUFFER: u32 = 32 << 10;
/// Bytes of a packet: the smallest piece that is read at once.
const PACKET: u64 = 1460;
/// The largest piece.
const MAX_PIECE: u64 = 16 << 10;
/// Pieces that are under way in one direction of a connection.
const UNDER_WAY: usize = 4096;

/// One direction of a link.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Link {
    /// Bytes per second.
    pub(crate) rate: u64,
    /// The time between leaving the queue and arriving.
    pub(crate) delay: Duration,
}

impl Link {
    /// Megabits per second, and milliseconds.
    pub(crate) const fn new(megabits: u64, milliseconds: u64) -> Self {
        Self {
            rate: megabits * 125_000,
            delay: Duration::from_millis(milliseconds),
        }
    }

    /// The length of the queue in front of the link: what the link carries in a tenth of a second.
    fn queue(self) -> usize {
        usize::try_from((self.rate / 10).max(MAX_PIECE))
            .unwrap_or(Semaphore::MAX_PERMITS)
            .min(Semaphore::MAX_PERMITS)
    }
}

/// When bytes leave the queue. Times are arguments.
#[derive(Debug)]
struct Departures {
    rate: u64,
    /// The departure of the last byte so far.
    last: Instant,
}

impl Departures {
    /// When the last byte of a piece departs that has arrived at the queue at this time. Pieces are
    /// asked for in their order.
    fn departure(&mut self, arrival: Instant, bytes: usize) -> Instant {
        let time = Duration::from_nanos(bytes as u64 * 1_000_000_000 / self.rate);
        self.last = self.last.max(arrival) + time;
        self.last
    }

    fn pause(&mut self, now: Instant, time: Duration) {
        self.last = self.last.max(now) + time;
    }
}

/// One direction of a running relay.
#[derive(Clone, Debug)]
pub(crate) struct Direction {
    link: Link,
    departures: Arc<Mutex<Departures>>,
}

impl Direction {
    fn new(link: Link) -> Self {
        Self {
            link,
            departures: Arc::new(Mutex::new(Departures {
                rate: link.rate,
                last: Instant::now(),
            })),
        }
    }

    fn departures(&self) -> MutexGuard<'_, Departures> {
        self.departures
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the rate, bytes per second. The queue keeps its length.
    pub(crate) fn set_rate(&self, rate: u64) {
        self.departures().rate = rate.max(1);
    }

    /// Nothing departs for this time.
    pub(crate) fn pause(&self, time: Duration) {
        self.departures().pause(Instant::now(), time);
    }

    /// Passes everything on, including the end.
    async fn pass(
        &self,
        mut from: impl AsyncRead + Unpin,
        mut to: impl AsyncWrite + Unpin,
    ) -> io::Result<()> {
        let room = Arc::new(Semaphore::new(self.link.queue()));
        let (queue, mut queued) =
            mpsc::unbounded_channel::<(Instant, Vec<u8>, OwnedSemaphorePermit)>();
        let (wire, mut under_way) = mpsc::channel::<(Instant, Vec<u8>)>(UNDER_WAY);
        let read = async {
            loop {
                // At most what the link carries in a millisecond.
                let rate = self.departures().rate;
                let size = u32::try_from((rate / 1000).clamp(PACKET, MAX_PIECE))
                    .map_err(io::Error::other)?;
                let mut place = Arc::clone(&room)
                    .acquire_many_owned(size)
                    .await
                    .map_err(io::Error::other)?;
                let mut piece = vec![0; size as usize];
                let length = from.read(&mut piece).await?;
                piece.truncate(length);
                let place = place.split(length).unwrap_or(place);
                if queue.send((Instant::now(), piece, place)).is_err() || length == 0 {
                    drop(queue);
                    return Ok(());
                }
            }
        };
        let depart = async {
            while let Some((arrival, piece, place)) = queued.recv().await {
                let departure = self.departures().departure(arrival, piece.len());
                sleep_until(departure.into()).await;
                drop(place);
                if wire
                    .send((departure + self.link.delay, piece))
                    .await
                    .is_err()
                {
                    break;
                }
            }
            drop(wire);
            Ok(())
        };
        let arrive = async {
            while let Some((time, piece)) = under_way.recv().await {
                sleep_until(time.into()).await;
                to.write_all(&piece).await?;
            }
            to.shutdown().await
        };
        tokio::try_join!(read, depart, arrive).map(drop)
    }
}

/// The relay; its connections end when it is dropped.
#[derive(Debug)]
pub(crate) struct Relay {
    pub(crate) address: SocketAddr,
    /// From clients to the server.
    pub(crate) up: Direction,
    /// From the server to clients.
    pub(crate) down: Direction,
    cut: Arc<Notify>,
    accepting: JoinHandle<()>,
}

impl Relay {
    /// A relay on a free port of the loopback, in front of a server.
    pub(crate) fn start(server: SocketAddr, up: Link, down: Link) -> io::Result<Self> {
        let socket = bounded()?;
        socket.bind((Ipv4Addr::LOCALHOST, 0).into())?;
        let listener = socket.listen(256)?;
        let address = listener.local_addr()?;
        let (up, down) = (Direction::new(up), Direction::new(down));
        let cut = Arc::new(Notify::new());
        let of_link = (up.clone(), down.clone(), Arc::clone(&cut));
        let accepting = tokio::spawn(accept(listener, server, of_link));
        Ok(Self {
            address,
            up,
            down,
            cut,
            accepting,
        })
    }

    /// Ends the connections that there are, whatever is under way; new ones are accepted.
    pub(crate) fn cut(&self) {
        self.cut.notify_waiters();
    }

    /// Nothing departs for this time, in both directions.
    pub(crate) fn pause(&self, time: Duration) {
        self.up.pause(time);
        self.down.pause(time);
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.accepting.abort();
    }
}

fn bounded() -> io::Result<TcpSocket> {
    let socket = TcpSocket::new_v4()?;
    // A listener's sockets inherit them.
    socket.set_recv_buffer_size(SOCKET_BUFFER)?;
    socket.set_send_buffer_size(SOCKET_BUFFER)?;
    Ok(socket)
}

type OfLink = (Direction, Direction, Arc<Notify>);

async fn accept(listener: TcpListener, server: SocketAddr, of_link: OfLink) {
    let mut connections = JoinSet::new();
    while let Ok((client, _)) = listener.accept().await {
        let (up, down, cut) = of_link.clone();
        connections.spawn(async move {
            tokio::select! {
                ended = connect(client, server, &up, &down) => ended,
                () = cut.notified() => Ok(()),
            }
        });
        while connections.try_join_next().is_some() {}
    }
}

async fn connect(
    mut client: TcpStream,
    server: SocketAddr,
    up: &Direction,
    down: &Direction,
) -> io::Result<()> {
    let mut server = bounded()?.connect(server).await?;
    for socket in [&client, &server] {
        socket.set_nodelay(true)?;
    }
    let (from_client, to_client) = client.split();
    let (from_server, to_server) = server.split();
    tokio::try_join!(
        up.pass(from_client, to_server),
        down.pass(from_server, to_client)
    )
    .map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    /// The departures of packets that all arrive at once, seconds after that.
    fn of_a_burst(departures: &mut Departures, start: Instant, packets: usize) -> Vec<f64> {
        (0..packets)
            .map(|_| (departures.departure(start, 1000) - start).as_secs_f64())
            .collect()
    }

    #[test]
    fn link_departures_follow_the_rate() {
        let start = Instant::now();
        let mut departures = Departures {
            rate: 100_000,
            last: start,
        };
        let times = of_a_burst(&mut departures, start, 50);
        assert!(
            (0..50)
                .zip(&times)
                .all(|(n, time)| (time - 0.01 * f64::from(n + 1)).abs() < 1e-6),
            "{times:?}"
        );
        // The link was idle meanwhile, which saves nothing up.
        assert_eq!(
            departures.departure(start + 2 * SECOND, 1000),
            start + 2 * SECOND + SECOND / 100
        );
    }

    #[test]
    fn link_rate_changes_with_the_next_packet_and_a_pause_delays_all_that_wait() {
        let start = Instant::now();
        let mut departures = Departures {
            rate: 100_000,
            last: start,
        };
        of_a_burst(&mut departures, start, 10);
        departures.rate = 50_000;
        let times = of_a_burst(&mut departures, start, 10);
        assert!(
            (times[0] - 0.12).abs() < 1e-6 && (times[9] - 0.3).abs() < 1e-6,
            "{times:?}"
        );
        departures.pause(start, SECOND);
        assert_eq!(
            departures.departure(start, 1000),
            start + SECOND + Duration::from_millis(320)
        );
        departures.pause(start + 5 * SECOND, SECOND);
        assert_eq!(
            departures.departure(start, 1000),
            start + 6 * SECOND + Duration::from_millis(20)
        );
    }

    /// Bytes through a link of 400 kB/s and 30 ms by a clock that is not simulated: the sender may
    /// not be ahead of the queue, nor the receiver ahead of the link.
    #[tokio::test]
    async fn link_passes_the_same_bytes_and_none_too_early() {
        let link = Link {
            rate: 400_000,
            delay: Duration::from_millis(30),
        };
        let sent: Vec<u8> = (0..120_000_u32)
            .map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8)
            .collect();
        let ((mut near, from), (to, mut far)) = (tokio::io::duplex(100), tokio::io::duplex(100));
        let direction = Direction::new(link);
        let start = Instant::now();
        let write = async {
            near.write_all(&sent).await?;
            let written = start.elapsed();
            near.shutdown().await?;
            drop(near);
            Ok(written)
        };
        let read = async {
            let (mut received, mut times) = (Vec::new(), Vec::new());
            let mut piece = [0; 4096];
            while let length @ 1.. = far.read(&mut piece).await? {
                received.extend_from_slice(&piece[..length]);
                times.push((received.len(), start.elapsed()));
            }
            Ok((received, times))
        };
        let (written, (received, times), ()) =
            tokio::try_join!(write, read, direction.pass(from, to)).unwrap();
        assert!(
            received == sent,
            "{} of {} bytes",
            received.len(),
            sent.len()
        );
        let passing = |bytes: usize| Duration::from_secs_f64(bytes as f64 / 400_000.0);
        // The first piece is at least as long as what has been read of it.
        assert!(times.iter().all(|(bytes, time)| *time
            >= link.delay + passing(*bytes).saturating_sub(passing(PACKET as usize))));
        assert!(times.last().unwrap().1 >= link.delay + passing(sent.len()));
        let held = link.queue() + 3 * 1460;
        assert!(
            written >= passing(sent.len() - held),
            "the sender is {written:?} ahead"
        );
    }
}
