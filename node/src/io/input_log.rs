//! The log of an agent's inputs. If a node is killed, the next node reconstructs the agent from this log.
//!
//! The agent is a pure state machine, so its inputs determine its whole state. The file begins with a checkpoint, which
//! is a copy of the agent. A record for each later input follows:
//!
//! ```text
//! record      length (4 bytes) crc32 (4 bytes) payload, in postcard
//! 1st record  Head: the form of the log, the kernel's boot, the network
//! 2nd record  NodeState: the checkpoint
//! then        (time, input), each written before the agent has it
//! ```
//! An incomplete record at the end is ignored: its input had no effects. The file is not synced,
//! because its content is of no use after a reboot: the log of another boot is ignored. When the
//! file has grown, a new checkpoint replaces it. The file exists only while there is something that
//! a next node could adopt.

use crate::logic::agent::Input;
use crate::logic::node_state::NodeState;
use anyhow::{Context, bail};
use comms::io::file::{self, Privacy};
use comms::logic::time::Time;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The form of the log. It is raised with every change of the types of the agent and its inputs: a log of another form is not read.
const FORM: u32 = 1;
/// When the log has at least this size in bytes, a checkpoint replaces it. The limit may also be twice the size after
/// the last checkpoint.
const SIZE_MAX: u64 = 8 << 20;
/// The longest log that is read, in bytes.
const READ_MAX: usize = 1 << 30;
/// The pause after a failed write. The first input after the pause tries again.
const TRY_AGAIN_AFTER: Duration = Duration::from_secs(10);
/// The name of the file, in the folder of the node.
const FILE: &str = "inputs";

/// The header of a log.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Head {
    form: u32,
    version: String,
    /// The boot of the kernel and the network namespace.
    machine: String,
}

/// A log that is being written.
#[derive(Debug)]
pub struct InputLog {
    path: PathBuf,
    head: Head,
    /// Nothing while a next node could adopt nothing, and after a failed write.
    file: Option<File>,
    size: u64,
    /// The size at which the log is rewritten.
    limit: u64,
    /// When the disk last refused, if it has accepted no write since.
    refused: Option<Time>,
    /// Whether the log is never written, because no successor adopts the programs of this node.
    is_off: bool,
}

impl InputLog {
    /// Returns a log in the folder of a node. It has no file yet, and never gets one if no successor adopts the node's
    /// programs. `machine` names the boot of the kernel and the network.
    pub fn new(folder: &Path, machine: &str, is_wanted: bool) -> Self {
        let head = Head { form: FORM, version: env!("CARGO_PKG_VERSION").to_owned(), machine: machine.to_owned() };
        Self { path: folder.join(FILE), head, file: None, size: 0, limit: SIZE_MAX, refused: None, is_off: !is_wanted }
    }

    /// Reconstructs the agent of a killed node, with all of its inputs. Returns nothing without such an agent.
    ///
    /// # Errors
    /// The log cannot be read or has another form. The text is for a person.
    pub fn replay(&self) -> anyhow::Result<Option<NodeState>> {
        let bytes = match file::bytes(&self.path, READ_MAX) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(error).with_context(|| format!("reading `{}`", self.path.display())),
        };
        let mut records = Records { left: &bytes };
        let head: Head = records.next().context("it has no head")?.context("its head cannot be read")?;
        if head.machine != self.head.machine {
            return Ok(None);
        }
        if head != self.head {
            bail!(
                "it was written by DCA {} in form {}, and this is DCA {} with form {FORM}",
                head.version,
                head.form,
                self.head.version
            );
        }
        let mut state: NodeState =
            records.next().context("it has no checkpoint")?.context("its checkpoint cannot be read")?;
        let mut effects = Vec::new();
        while let Some(record) = records.next::<(Time, Input)>() {
            let (at, input) = record.context("an input cannot be read")?;
            state.take(at, input, &mut effects);
            effects.clear();
        }
        Ok(Some(state))
    }

    /// Writes an input to the log, before the agent gets the input.
    pub fn append(&mut self, at: Time, input: &Input) {
        let Some(file) = &mut self.file else { return };
        let written = record(&(at, input)).and_then(|record| {
            file.write_all(&record)?;
            Ok(record.len())
        });
        match written {
            Ok(length) => self.size += length as u64,
            Err(error) => self.refuse(&error, at),
        }
    }

    /// Begins, rewrites or removes the log, depending on the agent. Has to be called after the agent's effects are carried out.
    pub fn keep_up(&mut self, state: &NodeState) {
        let is_wanted = state.is_engaged();
        match &self.file {
            _ if self.is_off => {}
            None if !is_wanted => self.refused = None,
            None if self.refused.is_none_or(|at| state.at >= at + TRY_AGAIN_AFTER) => self.begin(state),
            Some(_) if !is_wanted => self.remove(),
            Some(_) if self.size >= self.limit => self.begin(state),
            None | Some(_) => {}
        }
    }

    /// Replaces the log by a new log that begins with the present state.
    pub fn begin(&mut self, state: &NodeState) {
        match self.try_begin(state) {
            Ok((file, size)) => {
                (self.file, self.size) = (Some(file), size);
                self.limit = SIZE_MAX.max(2 * size);
                if self.refused.take().is_some() {
                    tracing::info!("inputs are logged again: if this node is killed, its programs continue");
                }
            }
            Err(error) => self.refuse(&error, state.at),
        }
    }

    fn try_begin(&self, state: &NodeState) -> io::Result<(File, u64)> {
        let unfinished = self.unfinished();
        let mut file = file::created(&unfinished, Privacy::Own)?;
        let head = record(&self.head)?;
        let state = record(state)?;
        file.write_all(&head)?;
        file.write_all(&state)?;
        fs::rename(&unfinished, &self.path)?;
        Ok((file, (head.len() + state.len()) as u64))
    }

    /// Continues without a log: a log with a gap would give another agent. The log begins again when the disk accepts it.
    fn refuse(&mut self, error: &io::Error, at: Time) {
        if self.refused.replace(at).is_none() {
            let log = self.path.display();
            tracing::error!(%log, %error, "inputs cannot be logged: if this node is killed, its programs end");
        }
        // The incomplete file would only take space.
        drop(fs::remove_file(self.unfinished()));
        self.remove();
    }

    fn unfinished(&self) -> PathBuf {
        self.path.with_extension("new")
    }

    /// Removes the file, because there is nothing to adopt.
    pub fn remove(&mut self) {
        self.file = None;
        if let Err(error) = fs::remove_file(&self.path)
            && error.kind() != io::ErrorKind::NotFound
        {
            tracing::error!(log = %self.path.display(), %error, "the log of inputs cannot be removed");
        }
    }
}

/// The complete records at the beginning of a file.
struct Records<'a> {
    left: &'a [u8],
}

impl Records<'_> {
    /// Returns the next record, or why it cannot be read. Returns nothing after the last complete record.
    fn next<T: DeserializeOwned>(&mut self) -> Option<Result<T, postcard::Error>> {
        let (length, rest) = self.left.split_first_chunk()?;
        let (sum, rest) = rest.split_first_chunk()?;
        let length = usize::try_from(u32::from_le_bytes(*length)).ok()?;
        let (payload, rest) = rest.split_at_checked(length)?;
        if crc32fast::hash(payload) != u32::from_le_bytes(*sum) {
            return None;
        }
        self.left = rest;
        Some(postcard::from_bytes(payload))
    }
}

fn record(payload: &impl Serialize) -> io::Result<Vec<u8>> {
    let mut record = postcard::to_extend(payload, vec![0; 8]).map_err(io::Error::other)?;
    let length = u32::try_from(record.len() - 8).map_err(io::Error::other)?;
    let sum = crc32fast::hash(&record[8..]);
    record[..4].copy_from_slice(&length.to_le_bytes());
    record[4..8].copy_from_slice(&sum.to_le_bytes());
    Ok(record)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::agent::{Agent, Identity};
    use crate::logic::programs::Programs;
    use crate::logic::protocol::{Request, StartMode};
    use language::{Options, Source, compile};
    use std::fs::OpenOptions;

    fn state() -> NodeState {
        let (host, machine) = ("c1".to_owned(), "here".to_owned());
        let identity = Identity {
            host,
            boot: 7,
            pid: 1,
            machine,
            epoch: 3,
            open: Vec::new(),
            is_guarded: false,
            estop: None,
            earlier: Default::default(),
        };
        NodeState::new(Agent::new(identity, Programs::default(), Time::ZERO), Time::ZERO)
    }

    fn at(number: u64) -> Time {
        Time::ZERO + Duration::from_millis(number)
    }

    /// A file that is cut at any place gives the state after its last complete record. Earlier damage is reported.
    #[test]
    fn a_log_that_was_cut_off_ends_with_its_last_whole_record() {
        let folder = std::env::temp_dir().join(format!("dca-inputs-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let mut log = InputLog::new(&folder, "here", true);
        assert!(log.replay().unwrap().is_none());
        log.begin(&state());
        let begin = fs::metadata(folder.join(FILE)).unwrap().len();
        let mut ends = vec![begin];
        for number in 1..=20 {
            log.append(at(number), &Input::Appeared { host: format!("c{number}"), boot: number });
            ends.push(fs::metadata(folder.join(FILE)).unwrap().len());
        }
        let whole = fs::read(folder.join(FILE)).unwrap();
        for length in (0..=whole.len() as u64).rev() {
            fs::write(folder.join(FILE), &whole[..usize::try_from(length).unwrap()]).unwrap();
            let records = ends.iter().filter(|end| **end <= length).count();
            match log.replay() {
                Ok(Some(found)) => assert_eq!(found.at, at(records as u64 - 1), "of {length} bytes"),
                Ok(None) => panic!("{length} bytes are something"),
                Err(_) => assert_eq!(records, 0, "of {length} bytes"),
            }
        }
        let other = InputLog::new(&folder, "another boot", true);
        fs::write(folder.join(FILE), &whole).unwrap();
        assert!(other.replay().unwrap().is_none(), "nothing of another boot runs any more");
        let newer = record(&Head { form: FORM + 1, version: "9".to_owned(), machine: "here".to_owned() }).unwrap();
        fs::write(folder.join(FILE), newer).unwrap();
        assert!(log.replay().unwrap_err().to_string().contains(&format!("form {}", FORM + 1)));
        fs::remove_dir_all(&folder).unwrap();
    }

    /// A log with a gap is useless, so there is none while the disk is full. Later, the log begins with the present state.
    #[test]
    fn after_a_full_disk_the_log_begins_again() {
        let text = "module A(host) { exec \"true\"; plain; done; }
            process main() { host { \"c1\" } instantiated_processes { a instof A(\"c1\"); } internal_event_actions { a } }";
        let plan = compile(&Source::new("test.dca", text), &[], &Options::named("test")).plan.unwrap();
        let request = Box::new(Request::Deploy { request: 1, plan, by: "ann".to_owned(), start: StartMode::AtOnce });
        let mut state = state();
        state.take(at(1), Input::Call { call: 1, request }, &mut Vec::new());
        let folder = std::env::temp_dir().join(format!("dca-full-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let mut log = InputLog::new(&folder, "here", true);
        let there = |log: &InputLog| log.replay().unwrap().map(|found| found.at);
        log.keep_up(&state);
        assert_eq!(there(&log), Some(at(1)));
        log.file = Some(OpenOptions::new().write(true).open("/dev/full").unwrap());
        log.append(at(2), &Input::Tick);
        // No file of this name can be made, as on a full disk.
        fs::create_dir(log.unfinished()).unwrap();
        for (millis, is_full, expected) in
            [(2, true, None), (10_002, true, None), (20_001, false, None), (20_002, false, Some(at(20_002)))]
        {
            if !is_full && log.unfinished().exists() {
                fs::remove_dir(log.unfinished()).unwrap();
            }
            state.take(at(millis), Input::Tick, &mut Vec::new());
            log.keep_up(&state);
            assert_eq!(there(&log), expected, "after {millis} ms");
        }
        fs::remove_dir_all(&folder).unwrap();
    }
}
