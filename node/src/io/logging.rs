//! Sets up the log of a process on standard error, and its filter.

use crate::logic::nameserver::Change;
use anyhow::Context;
use std::io::IsTerminal;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Registry, reload};

/// The log filter of a command line, if the user sets none. The library for the network may log nothing, because DCA
/// itself reports the faults that matter.
pub const COMMAND: &str = "warn,zenoh=off";
/// The default filter of a node's log.
pub const NODE: &str = "info,zenoh=error";

/// The log of this process.
#[derive(Clone, Debug)]
pub struct Log {
    handle: reload::Handle<EnvFilter, Registry>,
    usual: &'static str,
}

/// Begins to log to standard error. `RUST_LOG` sets the filter, or else `usual`.
pub fn start(usual: &'static str) -> Log {
    let (filter, handle) = reload::Layer::new(from_environment(usual));
    let colours = std::io::stderr().is_terminal();
    let lines = tracing_subscriber::fmt::layer().with_ansi(colours).with_writer(std::io::stderr);
    if let Err(error) = tracing_subscriber::registry().with(filter).with(lines).try_init() {
        tracing::debug!(%error, "logging was started before");
    }
    Log { handle, usual }
}

/// Logs a change of another node.
pub fn peer(change: &Change) {
    if change.is_good() { tracing::info!("{change}") } else { tracing::warn!("{change}") }
}

impl Log {
    /// From now on, logs with a filter such as `info,zenoh=error`. Without one, logs with the filter that the process was started with.
    ///
    /// # Errors
    /// The text is not a filter. Then nothing has changed.
    pub fn filter(&self, filter: Option<&str>) -> anyhow::Result<()> {
        let filter = match filter {
            Some(text) => EnvFilter::try_new(text).with_context(|| format!("reading the filter `{text}`"))?,
            None => from_environment(self.usual),
        };
        Ok(self.handle.reload(filter)?)
    }
}

fn from_environment(usual: &str) -> EnvFilter {
    let asked = std::env::var("RUST_LOG").ok().filter(|text| !text.trim().is_empty());
    asked.and_then(|text| EnvFilter::try_new(text).ok()).unwrap_or_else(|| EnvFilter::new(usual))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{self, Write};
    use std::sync::{Arc, Mutex};

    #[derive(Clone, Default)]
    struct Stream(Arc<Mutex<Vec<u8>>>);

    impl Write for Stream {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap().extend(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_person_sees_nothing_of_the_network_s_library() {
        let stream = Stream::default();
        let writer = stream.clone();
        let lines = tracing_subscriber::fmt::layer().with_ansi(false).with_writer(move || writer.clone());
        let log = tracing_subscriber::registry().with(EnvFilter::new(COMMAND)).with(lines);
        tracing::subscriber::with_default(log, || {
            tracing::error!(target: "zenoh::net::routing", "raw");
            tracing::error!(target: "zenoh_transport::unicast", "raw");
            tracing::warn!("in words");
        });
        let text = String::from_utf8(stream.0.lock().unwrap().clone()).unwrap();
        assert!(text.contains("in words") && !text.contains("raw"), "{text}");
    }
}
