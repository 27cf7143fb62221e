//! Attaches to the programs of a killed node, for its successor.

use super::leftovers::{self, END_AGAIN};
use super::{Attached, attach, ended, ended_output};
use comms::io::clock::{Wakeup, now};
use shim::process_record::RECORD_FILE;
use shim::protocol::ShimReport;
use std::path::Path;
use std::time::Duration;

/// The pause before the next try to reach a shim that does not answer: it is suspended, or has just been started.
const AGAIN: Duration = Duration::from_millis(100);

/// The fate of a program during the time without a node.
#[derive(Debug)]
pub enum Reached {
    /// Its shim exists.
    Running(Attached),
    /// The program has ended. The values are how, if this is known, and its last lines of output.
    Ended(Option<(ShimReport, Vec<String>)>),
    /// The program should have been started, but never was.
    Never,
}

/// Reaches the shim of the program in `dir`; `reports` of its reports are known already. If the shim was killed, ends
/// its leftovers. Blocks while a shim exists and does not answer.
pub fn reach(dir: &Path, reports: u64) -> Reached {
    let pause = Wakeup::default();
    loop {
        match attach(dir, reports) {
            Ok(attached) => return Reached::Running(attached),
            Err(error) => tracing::debug!(%error, ?dir, "a shim is not reached"),
        }
        // A shim that has ended by itself has removed its record last, and has no leftovers.
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
        // The record of the end is removed once the node knows it. No report is known here, so the program was never started.
        None if reports == 0 => Reached::Never,
        None => Reached::Ended(None),
    }
}
