//! The use cases of the service in this process, without a listener: so a subcommand writes the
//! same bytes as its route.

use std::future::Future;

use mlswarp::warp::Warning;
use tokio::runtime::Runtime;

use super::failure::Failure;
use crate::app::App;
use crate::client::Client;
use crate::config::Config;
use crate::problem::Problem;

/// A service that one client uses.
pub(super) struct Service {
    pub(super) app: App,
    pub(super) client: Client,
    runtime: Runtime,
}

impl Service {
    /// Errors: the threads cannot be started.
    pub(super) fn start(config: &Config) -> Result<Self, Failure> {
        let cannot = |e: &dyn std::fmt::Display| {
            Failure::Local(format!("cannot start compute threads: {e}"))
        };
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|e| cannot(&e))?;
        let app = App::new(config.offline()).map_err(|e| cannot(&e))?;
        Ok(Self {
            app,
            client: Client::default(),
            runtime,
        })
    }

    /// Waits for a use case.
    /// Errors: Those of the use case.
    pub(super) fn run<T>(
        &self,
        use_case: impl Future<Output = Result<T, Problem>>,
    ) -> Result<T, Problem> {
        self.runtime.block_on(use_case)
    }

    /// Waits for the next part of a file; `None` at its end.
    /// Errors: Those of the use case.
    pub(super) fn next<T>(
        &self,
        part: impl Future<Output = Option<Result<T, Problem>>>,
    ) -> Result<Option<T>, Failure> {
        Ok(self.runtime.block_on(part).transpose()?)
    }
}

/// What a server sends in response headers: the method that was chosen, and warnings. `None` if
/// there is neither.
pub(super) fn summary(method: Option<String>, warnings: &[Warning]) -> Option<String> {
    let method = method.map(|method| format!("method {method}"));
    let warnings = warnings.iter().map(|warning| warning.code().to_owned());
    let words: Vec<String> = method.into_iter().chain(warnings).collect();
    (!words.is_empty()).then(|| words.join(", "))
}
