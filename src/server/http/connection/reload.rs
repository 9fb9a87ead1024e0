//! Reloads keys, the secrets of tokens, certificate and private key while the server runs: after a
//! change of their files, and after SIGHUP.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use tokio::sync::watch;

use super::signals::Signals;
use super::unless;
use crate::app::App;
use crate::auth::tls::{ServerConfig, TlsFiles};
use crate::config::{KeysConfig, SecretsConfig};

/// Pause between two looks at the files.
const POLL_PAUSE: Duration = Duration::from_secs(1);
/// Permission bits by which other users read and write.
const OTHER_USERS_BITS: u32 = 0o006;

/// Modification time and size of a file.
type Stamp = Option<(SystemTime, u64)>;

pub(crate) struct Reloader {
    app: App,
    keys: Option<KeysConfig>,
    secrets: Option<SecretsConfig>,
    tls: Option<(TlsFiles, watch::Sender<Arc<ServerConfig>>)>,
    stamps: Vec<Stamp>,
}

impl Reloader {
    pub(crate) fn new(app: &App, tls: Option<watch::Sender<Arc<ServerConfig>>>) -> Self {
        let access = &app.config().auth;
        let mut reloader = Self {
            app: app.clone(),
            keys: access.keys.clone(),
            secrets: access.secrets.clone(),
            tls: access.tls.clone().zip(tls),
            stamps: Vec::new(),
        };
        reloader.stamps = reloader.stamps();
        reloader
    }

    /// Reloads forever.
    pub(crate) async fn run(mut self) {
        let mut hangup = Signals::reload().ok();
        let mut hung_up = async || match &mut hangup {
            Some(signals) => signals.recv().await,
            None => std::future::pending().await,
        };
        loop {
            let is_forced = unless(hung_up(), tokio::time::sleep(POLL_PAUSE))
                .await
                .is_none();
            // A file system may block. The task fails only when the runtime ends.
            self = match tokio::task::spawn_blocking(move || self.check(is_forced)).await {
                Ok(reloader) => reloader,
                Err(_) => return,
            };
        }
    }

    /// Warns of files with secrets that other users can read or write. Access by the group is
    /// usual: Kubernetes mounts secrets so.
    pub(crate) fn warn_of_readable_secrets(&self) {
        let key = self.tls.iter().map(|(files, _)| &files.key);
        for path in self.secret_files().chain(key) {
            if let Some(mode) = mode(path).filter(|mode| mode & OTHER_USERS_BITS != 0) {
                let path = path.display();
                tracing::warn!(
                    "other users can read or write {path} (mode {mode:03o}), which holds secrets: \
                        run chmod o-rwx {path}"
                );
            }
        }
    }

    /// The files with keys, and with the secrets that sign tokens.
    fn secret_files(&self) -> impl Iterator<Item = &PathBuf> {
        let keys = self.keys.iter().filter_map(|keys| keys.file.as_ref());
        keys.chain(self.secrets.iter().map(|secrets| &secrets.file))
    }

    fn stamps(&self) -> Vec<Stamp> {
        let stamp = |path: &PathBuf| {
            let metadata = std::fs::metadata(path).ok()?;
            Some((metadata.modified().ok()?, metadata.len()))
        };
        let tls = self.tls.iter();
        self.secret_files()
            .chain(tls.flat_map(|(files, _)| [&files.cert, &files.key]))
            .map(stamp)
            .collect()
    }

    /// Reloads the files if one has changed. A file that cannot be used leaves everything as it
    /// was.
    fn check(mut self, is_forced: bool) -> Self {
        let stamps = self.stamps();
        if stamps.is_empty() || (stamps == self.stamps && !is_forced) {
            return self;
        }
        self.stamps = stamps;
        if let Some(keys) = self.keys.as_ref().filter(|keys| keys.file.is_some()) {
            match keys.read() {
                Ok(new) => {
                    tracing::info!(keys = new.len(), "keys reloaded");
                    self.app.access().replace_keys(new);
                }
                Err(mistake) => tracing::error!("keys not reloaded: {mistake}"),
            }
        }
        match self.secrets.as_ref().map(SecretsConfig::read) {
            Some(Ok(new)) => {
                tracing::info!(secrets = new.len(), "secrets of tokens reloaded");
                self.app.access().replace_secrets(new);
            }
            Some(Err(mistake)) => tracing::error!("secrets of tokens not reloaded: {mistake}"),
            None => {}
        }
        if let Some((files, config)) = &self.tls {
            match files.load() {
                Ok(new) => {
                    tracing::info!("certificate reloaded");
                    config.send_replace(new);
                }
                // Certificate and key are replaced one after the other; the next look finds both.
                Err(mistake) => tracing::error!("certificate not reloaded: {mistake}"),
            }
        }
        self.warn_of_readable_secrets();
        self
    }
}

/// The permission bits of a file, where the system has them.
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
