//! What a process says of itself on its standard error, and how much of it.

use crate::logic::nameserver::Change;
use anyhow::Context;
use std::io::IsTerminal;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Registry, reload};

/// What a command line logs where nothing else is said.
pub const COMMAND: &str = "warn,zenoh=error";
/// What a node logs where nothing else is said.
pub const NODE: &str = "info,zenoh=error";

/// The log of this process.
#[derive(Clone, Debug)]
pub struct Log {
    handle: reload::Handle<EnvFilter, Registry>,
    usual: &'static str,
}

/// Sends the program's own log to standard error; what is logged is set by `RUST_LOG`, and without it by `usual`.
pub fn start(usual: &'static str) -> Log {
    let (filter, handle) = reload::Layer::new(from_environment(usual));
    let colours = std::io::stderr().is_terminal();
    let lines = tracing_subscriber::fmt::layer().with_ansi(colours).with_writer(std::io::stderr);
    if let Err(error) = tracing_subscriber::registry().with(filter).with(lines).try_init() {
        tracing::debug!(%error, "logging was started before");
    }
    Log { handle, usual }
}

/// Tells people what has become of another node.
pub fn peer(change: &Change) {
    if change.is_good() { tracing::info!("{change}") } else { tracing::warn!("{change}") }
}

impl Log {
    /// Logs what passes a filter such as `info,zenoh=error` from now on; without one, what the process was started with.
    ///
    /// # Errors
    /// If it is no filter; nothing has changed then.
    pub fn filter(&self, filter: Option<&str>) -> anyhow::Result<()> {
        let filter = match filter {
            Some(text) => EnvFilter::try_new(text).with_context(|| format!("reading the filter `{text}`"))?,
            None => from_environment(self.usual),
        };
        Ok(self.handle.reload(filter)?)
    }
}

fn from_environment(usual: &str) -> EnvFilter {
    EnvFilter::try_from_default_env().unwrap_or_else(|_unset| EnvFilter::new(usual))
}
