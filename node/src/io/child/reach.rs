//! Attaches to the programs of a killed node, for its successor.

use super::leftovers::{self, END_AGAIN};
use super::{Attached, attach, ended, ended_output};
use comms::io::clock::{Wakeup, now};
use shim::process_record::RECORD_FILE;
use shim::protocol::ShimReport;
use std::path::Path;
use std::time::Duration;

/// The pause before a shim that does not answer is tried again: it is suspended, or has only just begun.
const AGAIN: Duration = Duration::from_millis(100);

/// The fate of a program while there was no node.
#[derive(Debug)]
pub enum Reached {
    /// Its shim exists.
    Running(Attached),
    /// The program has ended: how, if that is known, and its last lines of output.
    Ended(Option<(ShimReport, Vec<String>)>),
    /// The program was to be started, and never was.
    Never,
}

/// Reaches the shim of the program in `dir`, `reports` of whose reports are known. If the shim was killed, ends its
/// leftovers. Blocks while a shim is there and does not answer.
pub fn reach(dir: &Path, reports: u64) -> Reached {
    let pause = Wakeup::default();
    loop {
        match attach(dir, reports) {
            Ok(attached) => return Reached::Running(attached),
            Err(error) => tracing::debug!(%error, ?dir, "a shim is not reached"),
        }
        // A shim that has ended by itself has removed its record last, and left nothing.
        if !dir.join(RECORD_FILE).exists()
            && let Some(end) = ended(dir)
        {
            return Reached::Ended(Some((end, ended_output(dir))));
        }
        if !leftovers::has_shim(dir) {
            break;
        }
        pause.wait(Some(now() + AGAIN));
    }
    let mut round = 0;
    while !leftovers::end_round(dir, round) {
        pause.wait(Some(now() + END_AGAIN));
        round += 1;
    }
    match ended(dir) {
        Some(end) => Reached::Ended(Some((end, ended_output(dir)))),
        // The record of how it ended is removed once its node knows; so this one was never started.
        None if reports == 0 => Reached::Never,
        None => Reached::Ended(None),
    }
}
