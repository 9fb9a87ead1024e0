//! Files that may change while the server runs: keys, certificate and its key. They are looked at every second, and at once after SIGHUP. What
//! cannot be read then leaves everything as it was, and the log says so.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use tokio::sync::watch;

use crate::app::App;
use crate::auth::tls::{ServerConfig, TlsFiles};
use crate::config::KeysConfig;

/// How often files are looked at.
const PAUSE: Duration = Duration::from_secs(1);
/// Permissions of other users to read and to write.
const OTHERS: u32 = 0o006;

/// What tells a file from what it was.
type Look = Option<(SystemTime, u64)>;

pub(crate) struct Reloader {
    app: App,
    keys: Option<KeysConfig>,
    tls: Option<(TlsFiles, watch::Sender<Arc<ServerConfig>>)>,
    seen: Vec<Look>,
}

impl Reloader {
    pub(crate) fn new(app: &App, tls: Option<watch::Sender<Arc<ServerConfig>>>) -> Self {
        let access = &app.config().access;
        let mut reread = Self { app: app.clone(), keys: access.keys.clone(), tls: access.tls.clone().zip(tls), seen: Vec::new() };
        reread.seen = looks(&reread.files());
        reread
    }

    /// How many keys there are.
    pub(crate) fn keys(&self) -> usize {
        self.keys.as_ref().map_or(0, |keys| keys.all.len())
    }

    /// Looks, for ever.
    pub(crate) async fn run(mut self) {
        let files = self.files();
        let mut hangup = hangup();
        loop {
            let forced = tokio::select! {
                () = tokio::time::sleep(PAUSE) => false,
                () = hangup.recv() => true,
            };
            if files.is_empty() {
                continue;
            }
            let paths = files.clone();
            // A file system may be slow; the only error is that the runtime ends.
            let Ok(looks) = tokio::task::spawn_blocking(move || looks(&paths)).await else { return };
            if forced || looks != self.seen {
                self.seen = looks;
                self = match tokio::task::spawn_blocking(move || self.read()).await {
                    Ok(read) => read,
                    Err(_) => return,
                };
            }
        }
    }

    fn files(&self) -> Vec<PathBuf> {
        let keys = self.keys.iter().filter_map(|keys| keys.file.clone());
        keys.chain(self.tls.iter().flat_map(|(files, _)| [files.cert.clone(), files.key.clone()])).collect()
    }

    /// Says which files of secrets other users of the machine can read or write. (A group may: Kubernetes mounts secrets for one.)
    pub(crate) fn warn_of_readable_secrets(&self) {
        let keys = self.keys.iter().filter_map(|keys| keys.file.as_deref());
        for path in keys.chain(self.tls.iter().map(|(files, _)| files.key.as_path())) {
            if let Some(mode) = mode(path).filter(|mode| mode & OTHERS != 0) {
                let path = path.display();
                tracing::warn!("other users can read or write {path} (mode {mode:03o}), which holds secrets: run chmod o-rwx {path}");
            }
        }
    }

    fn read(self) -> Self {
        if let Some(keys) = self.keys.as_ref().filter(|keys| keys.file.is_some()) {
            match keys.read() {
                Ok(new) => {
                    tracing::info!(keys = new.len(), "keys were read again");
                    self.app.access().replace_keys(new);
                }
                Err(mistake) => tracing::error!("keys stay as they were: {mistake}"),
            }
        }
        if let Some((files, config)) = &self.tls {
            match files.load() {
                Ok(new) => {
                    tracing::info!("the certificate was read again");
                    config.send_replace(new);
                }
                // A certificate is replaced before its key, or after it; a second later both are there.
                Err(mistake) => tracing::error!("the certificate stays as it was: {mistake}"),
            }
        }
        self.warn_of_readable_secrets();
        self
    }
}

/// The permissions of a file, where there are such.
fn mode(path: &Path) -> Option<u32> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt as _;
        Some(std::fs::metadata(path).ok()?.mode() & 0o777)
    }
    #[cfg(not(unix))]
    {
        let _ = path;
        None
    }
}

fn looks(files: &[PathBuf]) -> Vec<Look> {
    let look = |path: &PathBuf| {
        let about = std::fs::metadata(Path::new(path)).ok()?;
        Some((about.modified().ok()?, about.len()))
    };
    files.iter().map(look).collect()
}

/// SIGHUP, where there is such a thing.
struct Hangup(#[cfg(unix)] Option<tokio::signal::unix::Signal>);

fn hangup() -> Hangup {
    #[cfg(unix)]
    return Hangup(tokio::signal::unix::signal(tokio::signal::unix::SignalKind::hangup()).ok());
    #[cfg(not(unix))]
    Hangup()
}

impl Hangup {
    async fn recv(&mut self) {
        #[cfg(unix)]
        if let Some(signal) = &mut self.0 {
            signal.recv().await;
            return;
        }
        std::future::pending().await
    }
}
