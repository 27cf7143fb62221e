//! The files that a shim writes: which process runs here, and how it has ended.

use super::{Event, complain, next};
use crate::agent::Agent;
use comms::io::clock::now;
use comms::io::file::{self, Privacy};
use rustix::process::Pid;
use shim::process_record::{ProcessRecord, RECORD_FILE};
use shim::processes;
use shim::protocol::{AGENT_LOSS_GRACE, EXIT_FILE, SOCKET_FILE, ShimReport, ShimStart};
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

/// The pause before a disk that has not taken the record of an end is tried again.
const WRITE_AGAIN: Duration = Duration::from_millis(500);

/// The record of the program that runs here, for a node that starts after this shim and its node were killed.
pub(super) struct Record {
    path: PathBuf,
}

impl Record {
    pub(super) fn begin(start: &ShimStart) -> io::Result<Self> {
        let path = start.dir.join(RECORD_FILE);
        let record = ProcessRecord {
            boot: processes::kernel_boot(),
            // A program that would be kept gets the usual grace when it is ended.
            grace: start.agent_loss_grace.unwrap_or(AGENT_LOSS_GRACE),
            shim: processes::this(),
            program: None,
        };
        file::write(&path, record.head().as_bytes())?;
        Ok(Self { path })
    }

    pub(super) fn add(&self, program: Pid) {
        let Some(stat) = processes::stat(program.as_raw_nonzero().get()) else { return };
        let line = ProcessRecord::program_line(stat.process);
        let file = file::appended_itself(&self.path, Privacy::Usual);
        // Without the record, the marks in the environment of the program still identify it.
        if let Err(error) = file.and_then(|mut file| file.write_all(line.as_bytes())) {
            complain(&format!("dca-shim: cannot write `{}`: {error}", self.path.display()));
        }
    }

    pub(super) fn remove(&self) {
        std::fs::remove_file(&self.path).unwrap_or_default();
    }
}

/// Records the end, then reports it: an agent that attaches too late reads the record, in the same boot of the kernel.
/// If an agent gets the report of the end, the shim does not wait for the disk. Without an agent, the record is the only copy, so it is
/// synced. Returns the end if neither an agent nor the disk has it.
pub(super) fn conclude(dir: &Path, agent: &Agent, end: ShimReport) -> Option<ShimReport> {
    let written = write_end(dir, &end);
    let (is_heard, is_written) = (agent.report(&end), written.is_ok());
    let kept = written.and_then(|file| if is_heard { Ok(()) } else { sync(&file, dir) });
    if let Err(error) = kept {
        complain(&format!("dca-shim: cannot write `{}`: {error}", dir.join(EXIT_FILE).display()));
    }
    if is_heard || is_written { None } else { Some(end) }
}

/// Keeps a report of an end that neither an agent nor the disk has accepted, until the agent or the disk accepts it.
/// There is no other copy. Once the socket is gone, no agent will ever ask.
pub(super) fn hold(dir: &Path, agent: &Agent, end: &ShimReport, events: &Receiver<Event>) {
    let socket = dir.join(SOCKET_FILE);
    while !agent.is_told() && socket.exists() && write_end(dir, end).and_then(|file| sync(&file, dir)).is_err() {
        // An agent that attaches gets every report. Nothing runs that it could give orders about.
        match next(events, Some(now() + WRITE_AGAIN)) {
            Ok(_) | Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

fn write_end(dir: &Path, end: &ShimReport) -> io::Result<File> {
    let unfinished = dir.join("exit.new");
    let mut file = file::created(&unfinished, Privacy::Usual)?;
    writeln!(file, "{end}")?;
    std::fs::rename(&unfinished, dir.join(EXIT_FILE))?;
    Ok(file)
}

fn sync(file: &File, dir: &Path) -> io::Result<()> {
    file.sync_all()?;
    File::open(dir)?.sync_all()
}
