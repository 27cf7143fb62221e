//! What a process says of itself on its standard error, and how much of it.

use anyhow::Context;
use std::io::IsTerminal;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Registry, reload};

/// What is logged where nothing else is said.
const DEFAULT: &str = "warn,zenoh=error";

/// The log of this process.
#[derive(Clone, Debug)]
pub struct Log(reload::Handle<EnvFilter, Registry>);

/// Sends the program's own log to standard error; what is logged is set by `RUST_LOG`.
pub fn start() -> Log {
    let (filter, handle) = reload::Layer::new(from_environment());
    let colours = std::io::stderr().is_terminal();
    let lines = tracing_subscriber::fmt::layer().with_ansi(colours).with_writer(std::io::stderr);
    if let Err(error) = tracing_subscriber::registry().with(filter).with(lines).try_init() {
        tracing::debug!(%error, "logging was started before");
    }
    Log(handle)
}

impl Log {
    /// Logs what passes a filter such as `info,zenoh=error` from now on; without one, what the process was started with.
    ///
    /// # Errors
    /// If it is no filter; nothing has changed then.
    pub fn filter(&self, filter: Option<&str>) -> anyhow::Result<()> {
        let filter = match filter {
            Some(text) => EnvFilter::try_new(text).with_context(|| format!("reading the filter `{text}`"))?,
            None => from_environment(),
        };
        Ok(self.0.reload(filter)?)
    }
}

fn from_environment() -> EnvFilter {
    EnvFilter::try_from_default_env().unwrap_or_else(|_unset| EnvFilter::new(DEFAULT))
}
