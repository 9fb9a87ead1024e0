//! A server whose runtime has one thread, and the processor time that this thread takes between two
//! looks at its queue: at least the longest poll of a task. Nothing in the server is changed for
//! that. While the thread is awake, a task that is always ready comes once in each pass over the
//! queue; the hooks for the thread's sleep tell the rest.

use std::net::SocketAddr;
use std::pin::{Pin, pin};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use mlswarp_server::app::App;
use mlswarp_server::http::connection::{listen, serve};
use rustix::time::{ClockId, clock_gettime};
use tokio::sync::oneshot;
use tokio::task::yield_now;

use super::server::config;

/// A pass that takes less has polled no other task.
const IDLE: Duration = Duration::from_micros(4);

/// A server on a thread of its own; it stops when this is dropped.
pub(crate) struct ClockedServer {
    pub(crate) address: SocketAddr,
    clock: Arc<Clock>,
    runtime: tokio::runtime::Handle,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

/// The processor time of the runtime's thread.
#[derive(Default)]
struct Clock {
    /// At the end of the last pass, ns.
    last: AtomicU64,
    longest: AtomicU64,
    metronome: Mutex<Option<Waker>>,
}

/// The processor time of this thread, ns.
fn thread_nanos() -> u64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    u64::try_from(time.tv_sec).unwrap() * 1_000_000_000 + u64::try_from(time.tv_nsec).unwrap()
}

impl Clock {
    /// The end of a pass; how long it was.
    fn pass(&self) -> Duration {
        let now = thread_nanos();
        let nanos = now - self.last.swap(now, Ordering::Relaxed);
        self.longest.fetch_max(nanos, Ordering::Relaxed);
        Duration::from_nanos(nanos)
    }

    /// The thread wakes.
    fn wake(&self) {
        self.pass();
        let metronome = self.metronome.lock().unwrap().take();
        metronome.into_iter().for_each(Waker::wake);
    }
}

/// The task that is always ready. Before it sleeps, a pass without another task is not enough:
/// tasks that have used up their turn come when no other is ready, after the task that calls them
/// to their next turn. So it waits as often as both do, and lets them come first.
struct Metronome {
    clock: Arc<Clock>,
    idle_passes: u32,
}

impl Future for Metronome {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<()> {
        let is_idle = self.clock.pass() < IDLE;
        self.idle_passes = if is_idle { self.idle_passes + 1 } else { 0 };
        match self.idle_passes {
            2 | 4 | 6 | 8 => drop(pin!(yield_now()).poll(cx)),
            0..=9 => cx.waker().wake_by_ref(),
            _ => {
                self.idle_passes = 0;
                *self.clock.metronome.lock().unwrap() = Some(cx.waker().clone());
            }
        }
        Poll::Pending
    }
}

impl ClockedServer {
    pub(crate) fn start(options: &[&str]) -> Self {
        let config = config(options);
        let listener = listen(config.listen).unwrap();
        let address = listener.local_addr().unwrap();
        let app = App::new(config).unwrap();
        let (clock, (stop, stopped)) = (Arc::<Clock>::default(), oneshot::channel());
        let (says, said) = std::sync::mpsc::channel();
        let (parks, wakes, ticks) = (Arc::clone(&clock), Arc::clone(&clock), Arc::clone(&clock));
        let thread = std::thread::spawn(move || {
            let mut builder = tokio::runtime::Builder::new_current_thread();
            // Otherwise it would look for what is ready between its passes too, without the hooks:
            // the metronome could sleep on, and several polls would count as one.
            builder.event_interval(u32::MAX);
            builder.enable_all().on_thread_unpark(move || wakes.wake());
            builder.on_thread_park(move || {
                parks.pass();
            });
            let runtime = builder.build().unwrap();
            says.send(runtime.handle().clone()).unwrap();
            runtime.block_on(async {
                tokio::spawn(Metronome {
                    clock: ticks,
                    idle_passes: 0,
                });
                let stop = async {
                    let _ = stopped.await;
                };
                tokio::spawn(serve(app, listener, stop))
                    .await
                    .unwrap()
                    .unwrap();
            });
        });
        Self {
            address,
            clock,
            runtime: said.recv().unwrap(),
            stop: Some(stop),
            thread: Some(thread),
        }
    }

    /// Computes on the runtime's thread for so long.
    pub(crate) fn compute(&self, time: Duration) {
        let (says, said) = std::sync::mpsc::channel();
        self.runtime.spawn(async move {
            let began = thread_nanos();
            while Duration::from_nanos(thread_nanos() - began) < time {}
            says.send(()).unwrap();
        });
        said.recv().unwrap();
    }

    /// The longest pass of the runtime's thread during some work, and a little later.
    pub(crate) fn longest<T>(&self, work: impl FnOnce() -> T) -> (Duration, T) {
        self.clock.longest.store(0, Ordering::Relaxed);
        let done = work();
        std::thread::sleep(Duration::from_millis(3));
        // On a busy machine the pass may not have ended yet. A task is polled after it.
        for _ in 0..2 {
            let (says, said) = std::sync::mpsc::channel();
            self.runtime.spawn(async move { says.send(()).unwrap() });
            said.recv().unwrap();
        }
        (
            Duration::from_nanos(self.clock.longest.load(Ordering::Relaxed)),
            done,
        )
    }
}

impl Drop for ClockedServer {
    fn drop(&mut self) {
        drop(self.stop.take());
        let ended = self.thread.take().map(std::thread::JoinHandle::join);
        assert!(std::thread::panicking() || ended.is_none_or(|ended| ended.is_ok()));
    }
}
