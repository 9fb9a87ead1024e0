//! Signals of the operating system: SIGTERM and Ctrl-C stop the service, SIGHUP reloads its files.

#[cfg(unix)]
mod platform {
    use std::future::poll_fn;
    use std::io;
    use std::task::Poll;

    use tokio::signal::unix::{Signal, SignalKind, signal};

    /// A group of signals. Signals that arrive before [`Self::recv`] is called count.
    pub(crate) struct Signals(Vec<Signal>);

    impl Signals {
        pub(crate) fn stop() -> io::Result<Self> {
            Ok(Self(vec![
                signal(SignalKind::terminate())?,
                signal(SignalKind::interrupt())?,
            ]))
        }

        pub(crate) fn reload() -> io::Result<Self> {
            Ok(Self(vec![signal(SignalKind::hangup())?]))
        }

        pub(crate) async fn recv(&mut self) {
            poll_fn(|cx| {
                let is_ready = self
                    .0
                    .iter_mut()
                    .any(|signal| signal.poll_recv(cx).is_ready());
                if is_ready {
                    Poll::Ready(())
                } else {
                    Poll::Pending
                }
            })
            .await;
        }
    }
}

#[cfg(not(unix))]
mod platform {
    use std::io;

    /// Ctrl-C.
    pub(crate) struct Signals;

    impl Signals {
        pub(crate) fn stop() -> io::Result<Self> {
            Ok(Self)
        }

        pub(crate) fn reload() -> io::Result<Self> {
            Err(io::ErrorKind::Unsupported.into())
        }

        pub(crate) async fn recv(&mut self) {
            let _ = tokio::signal::ctrl_c().await;
        }
    }
}

pub(crate) use platform::Signals;
