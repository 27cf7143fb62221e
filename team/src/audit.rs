//! The audit log of a node, on its disk: a thread of its own writes it, so that nobody waits for the disk who is refused.
//!
//! `STATE/r1/team/audit` is the log, `audit.1` the one before it, which ends where the log begins.

use anyhow::Context as _;
use comms::io::file::{self, Privacy};
use std::fs::{self, File, OpenOptions};
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use tokio::sync::watch;
use trust::audit::{Decision, Entry, LINE_MAX, Log, Position, Verifier};
use trust::identity::KeyId;
use trust::name::UnixTime;

/// The name of the log.
pub const FILE: &str = "audit";
/// The most bytes of the log; then a new one begins.
const SIZE_MAX: u64 = 16 << 20;
/// How many records wait for the disk; more are counted.
const WAITING_MAX: usize = 256;
/// How many more records than one are written at once.
const TOGETHER_MAX: usize = 63;
/// How many of them are refusals: who is refused again and again keeps nothing out that was done.
const REFUSED_MAX: usize = 128;
/// How many records of either decision there are in a minute; more are counted, so that nobody fills the disk.
const PER_MINUTE: u32 = 600;

/// Somebody wanted something, and what became of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AuditEntry {
    /// What became of it.
    pub decision: Decision,
    /// Who wanted it, as far as that is known.
    pub who: String,
    /// What that was.
    pub what: String,
    /// Why it was refused, or not done; else empty.
    pub reason: String,
}

/// An open log. Dropped, it writes what it was given, and ends.
#[derive(Debug)]
pub struct Audit {
    records: Option<SyncSender<(UnixTime, AuditEntry)>>,
    writer: Option<JoinHandle<()>>,
    /// How many refusals wait.
    refused: Arc<AtomicUsize>,
    /// Of what was done, and of what was refused.
    quotas: Mutex<[Quota; 2]>,
    /// Where the log has come to on the disk.
    position: watch::Receiver<Option<Position>>,
}

/// How many records there were in this minute, and how many there would have been.
#[derive(Debug, Default)]
struct Quota {
    minute: u64,
    count: u32,
    lost: u32,
}

impl Audit {
    /// Goes on with the log in a folder, or begins one.
    ///
    /// # Errors
    /// The disk refuses.
    pub fn open(folder: &Path, team: KeyId, node: KeyId) -> anyhow::Result<Self> {
        let (records, waiting) = sync_channel(WAITING_MAX);
        let writer = Writer::open(folder.join(FILE), team, node)?;
        let (positions, position) = watch::channel(writer.log.position());
        let thread = std::thread::Builder::new().name("dca-audit".to_owned());
        let refused = Arc::new(AtomicUsize::new(0));
        let taken = Arc::clone(&refused);
        let writer = thread
            .spawn(move || writer.run(&waiting, &taken, &positions))
            .context("starting the thread of the audit log")?;
        Ok(Self { records: Some(records), writer: Some(writer), refused, quotas: Mutex::default(), position })
    }

    /// Tells where the log has come to, which is on the disk; nothing before its first record.
    pub fn position(&self) -> watch::Receiver<Option<Position>> {
        self.position.clone()
    }

    /// Has a record written. What comes too fast is only counted, and told of in the next minute, or at the end.
    pub fn record(&self, entry: AuditEntry) {
        let now = crate::now();
        let mut quotas = self.quotas.lock().unwrap_or_else(PoisonError::into_inner);
        let quota = &mut quotas[usize::from(entry.decision == Decision::Refused)];
        let told = quota.begin(now).map(|count| more(entry.decision, count));
        for entry in told.into_iter().chain([entry]) {
            let taken = quota.takes() && self.send(now, entry);
            quota.lost += u32::from(!taken);
        }
    }

    /// Gives a record to the writer; says whether there was room.
    fn send(&self, now: UnixTime, entry: AuditEntry) -> bool {
        let is_refusal = entry.decision == Decision::Refused;
        if is_refusal && self.refused.fetch_add(1, Ordering::Relaxed) >= REFUSED_MAX {
            self.refused.fetch_sub(1, Ordering::Relaxed);
            return false;
        }
        let is_sent = self.records.iter().all(|records| records.try_send((now, entry.clone())).is_ok());
        if is_refusal && !is_sent {
            self.refused.fetch_sub(1, Ordering::Relaxed);
        }
        is_sent
    }
}

/// Says how many records were left out.
fn more(decision: Decision, count: u32) -> AuditEntry {
    let what = if decision == Decision::Refused { "refused" } else { "done" };
    let (who, what) = ("many".to_owned(), format!("{count} more that were {what}"));
    AuditEntry { decision, who, what, reason: "too many in a minute".to_owned() }
}

impl Drop for Audit {
    fn drop(&mut self) {
        let quotas = std::mem::take(self.quotas.get_mut().unwrap_or_else(PoisonError::into_inner));
        if let Some(records) = self.records.take() {
            for (quota, decision) in quotas.into_iter().zip([Decision::Done, Decision::Refused]) {
                if quota.lost > 0 {
                    // The writer takes what waits, and then this: there is nobody else any more.
                    drop(records.send((crate::now(), more(decision, quota.lost))));
                }
            }
        }
        if let Some(writer) = self.writer.take() {
            drop(writer.join());
        }
    }
}

impl Quota {
    /// Begins a new minute, if it is one; returns how many were left out in the last one.
    fn begin(&mut self, now: UnixTime) -> Option<u32> {
        if now.0 / 60 == self.minute {
            return None;
        }
        let lost = self.lost;
        *self = Self { minute: now.0 / 60, count: 0, lost: 0 };
        (lost > 0).then_some(lost)
    }

    fn takes(&mut self) -> bool {
        self.count = self.count.saturating_add(1);
        self.count <= PER_MINUTE
    }
}

/// The end of the log on the disk.
#[derive(Debug)]
struct Writer {
    path: PathBuf,
    log: Log,
    file: File,
    size: u64,
}

impl Writer {
    fn open(path: PathBuf, team: KeyId, node: KeyId) -> anyhow::Result<Self> {
        let before = match read(&path) {
            Ok(before) => before.filter(|log| log.of() == (team, node)),
            Err(error) => {
                // What somebody has worked on is kept, and not gone on with.
                tracing::error!(
                    error = format!("{error:#}"),
                    "the audit log is not as it was written; a new one begins"
                );
                None
            }
        };
        if let Some(log) = before {
            let file = append(&path)?;
            let size = file.metadata().map_or(0, |there| there.len());
            return Ok(Self { path, log, file, size });
        }
        if path.exists() {
            let kept = path.with_extension(format!("of-{}", crate::now().0));
            fs::rename(&path, &kept).with_context(|| format!("keeping `{}`", kept.display()))?;
        }
        Self::begin(path, (team, node), None)
    }

    fn begin(path: PathBuf, (team, node): (KeyId, KeyId), before: Option<&Log>) -> anyhow::Result<Self> {
        let (log, line) = Log::begin(team, node, before);
        let mut writer = Self { file: append(&path)?, path, log, size: 0 };
        writer.write(&line)?;
        Ok(writer)
    }

    fn write(&mut self, line: &str) -> anyhow::Result<()> {
        let line = format!("{line}\n");
        let written = self.file.write_all(line.as_bytes()).and_then(|()| self.file.sync_data());
        self.size += line.len() as u64;
        written.with_context(|| format!("writing `{}`", self.path.display()))
    }

    fn run(
        mut self,
        records: &Receiver<(UnixTime, AuditEntry)>,
        refused: &AtomicUsize,
        positions: &watch::Sender<Option<Position>>,
    ) {
        while let Ok(first) = records.recv() {
            // Those that wait are one write to the disk.
            let mut lines = Vec::new();
            for (at, entry) in std::iter::once(first).chain(records.try_iter().take(TOGETHER_MAX)) {
                if entry.decision == Decision::Refused {
                    refused.fetch_sub(1, Ordering::Relaxed);
                }
                let AuditEntry { decision, who, what, reason } = &entry;
                lines.push(self.log.add(&Entry { at, decision: *decision, who, what, request: [0; 16], reason }));
            }
            let position = self.log.position();
            match self.write(&lines.join("\n")).and_then(|()| self.turn_over()) {
                // The first record of a log says where the one before ended: what was signed of that counts.
                Ok(()) => drop(positions.send_replace(position)),
                Err(error) => tracing::error!(error = format!("{error:#}"), "the audit log cannot be written"),
            }
        }
    }

    fn turn_over(&mut self) -> anyhow::Result<()> {
        if self.size < SIZE_MAX {
            return Ok(());
        }
        let kept = self.path.with_extension("1");
        fs::rename(&self.path, &kept).with_context(|| format!("keeping `{}`", kept.display()))?;
        *self = Self::begin(self.path.clone(), self.log.of(), Some(&self.log))?;
        Ok(())
    }
}

fn append(path: &Path) -> anyhow::Result<File> {
    file::appended(path, Privacy::Own).with_context(|| format!("writing `{}`", path.display()))
}

/// Returns the end of a log; nothing if there is none. A last line that a power cut has left without its end is not there.
fn read(path: &Path) -> anyhow::Result<Option<Log>> {
    let file = match file::opened(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        opened => opened.with_context(|| format!("reading `{}`", path.display()))?,
    };
    let (mut verifier, mut file) = (Verifier::new(Vec::new())?, BufReader::new(file));
    let mut line = String::new();
    let mut whole = 0;
    while file.read_line(&mut line)? > 0 {
        let Some(text) = line.strip_suffix('\n').filter(|text| text.len() <= LINE_MAX) else { break };
        verifier.line(text)?;
        whole += line.len() as u64;
        line.clear();
    }
    if fs::metadata(path)?.len() != whole {
        OpenOptions::new().write(true).open(path)?.set_len(whole)?;
    }
    Ok(Some(verifier.finish()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(who: &str) -> AuditEntry {
        AuditEntry { decision: Decision::Refused, who: who.into(), what: "link".into(), reason: "no".into() }
    }

    fn lines(folder: &Path) -> Vec<String> {
        fs::read_to_string(folder.join(FILE)).unwrap().lines().map(str::to_owned).collect()
    }

    #[test]
    fn a_log_goes_on_over_restarts_and_power_cuts() {
        let folder = std::env::temp_dir().join(format!("dca-audit-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let (team, node) = (KeyId([1; 32]), KeyId([2; 32]));
        for number in 0..3 {
            let audit = Audit::open(&folder, team, node).unwrap();
            audit.record(entry(&format!("somebody {number}")));
            drop(audit);
            append(&folder.join(FILE)).unwrap().write_all(b"half a li").unwrap();
        }
        let log = read(&folder.join(FILE)).unwrap().unwrap();
        assert_eq!((log.last(), log.of()), (3, (team, node)));
        // What somebody has worked on is kept beside a new one.
        let changed = lines(&folder).join("\n").replace("somebody 1", "somebody 9") + "\n";
        fs::write(folder.join(FILE), changed).unwrap();
        drop(Audit::open(&folder, team, node).unwrap());
        assert_eq!(lines(&folder).len(), 1);
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 2);
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn who_is_refused_again_and_again_keeps_nothing_out_that_was_done() {
        let folder = std::env::temp_dir().join(format!("dca-audit-flood-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let audit = Audit::open(&folder, KeyId([1; 32]), KeyId([2; 32])).unwrap();
        for number in 0..10_000 {
            audit.record(entry("a stranger"));
            if number % 1000 == 999 {
                let (who, what, reason) = ("dan".into(), format!("write {number}"), String::new());
                audit.record(AuditEntry { decision: Decision::Done, who, what, reason });
            }
        }
        drop(audit);
        let lines = lines(&folder);
        assert_eq!(lines.iter().filter(|line| line.contains("\tdan\t")).count(), 10);
        let strangers = lines.iter().filter(|line| line.contains("a stranger")).count();
        // A minute may have ended meanwhile.
        let more = |line: &String| -> Option<usize> {
            line.split_once(" more that were refused")?.0.split('\t').next_back()?.parse().ok()
        };
        let more: usize = lines.iter().filter_map(more).sum();
        assert_eq!(strangers + more, 10_000, "all are counted");
        assert!(lines.iter().all(|line| !line.contains("more that were done")));
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn too_many_are_counted() {
        let (mut quota, at) = (Quota::default(), UnixTime(6000));
        assert_eq!(quota.begin(at), None);
        let taken = (0..1000).filter(|_| quota.takes()).count();
        assert_eq!(taken, 600);
        quota.lost = 400;
        assert_eq!((quota.begin(at.plus(59)), quota.begin(at.plus(60))), (None, Some(400)));
    }
}
