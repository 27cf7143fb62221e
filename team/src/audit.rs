//! The audit log of a node, on its disk. A separate thread writes it, so that refusing a request does not wait for the disk.
//!
//! `STATE/r1/team/audit` is the log. `audit.1` is the previous one, which ends where the log begins.

use crate::folder;
use anyhow::Context as _;
use comms::io::file::{self, Privacy};
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::sync::watch;
use trust::audit::{Decision, Entry, LINE_MAX, Log, Position, Verifier};
use trust::identity::KeyId;
use trust::name::UnixTime;

/// The name of the log.
pub const FILE: &str = "audit";
/// The most bytes of the log. When it reaches them, a new log begins.
const SIZE_MAX: u64 = 16 << 20;
/// The most bytes of a log that is read. A log may exceed `SIZE_MAX` if no new log could begin.
const LOG_MAX: usize = 64 << 20;
/// How many records may wait for the disk; further records are only counted.
const WAITING_MAX: usize = 256;
/// How many further records are written together with the first one.
const TOGETHER_MAX: usize = 63;
/// How many of the waiting records may be refusals. Repeated refusals must not displace the records of actions.
const REFUSED_MAX: usize = 128;
/// The most records of actions in a minute, and the most records of refused members. Further records are only counted, so that they do not
/// fill the disk.
const PER_MINUTE: u32 = 600;
/// The most records of refused strangers in a minute. Strangers are counted separately, so they cannot hide refusals of members.
const STRANGERS_PER_MINUTE: u32 = 8;
/// The pause before the next attempt after the disk has refused a write.
const AGAIN_AFTER: Duration = Duration::from_secs(1);
const TOO_MANY: &str = "too many in a minute";

/// An attempt, and its result.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AuditEntry {
    /// The result.
    pub decision: Decision,
    /// The client that made the attempt, as far as known.
    pub who: String,
    /// The requested action.
    pub what: String,
    /// Why the attempt was refused or failed; otherwise empty.
    pub reason: String,
}

/// An open log. Dropping it writes the pending records and ends its thread.
#[derive(Debug)]
pub struct Audit {
    records: Option<SyncSender<(UnixTime, AuditEntry)>>,
    writer: Option<JoinHandle<()>>,
    /// How many refusals wait.
    refused: Arc<AtomicUsize>,
    /// By the place of their [`Class`].
    quotas: Mutex<[Quota; 3]>,
    /// The position of the log on the disk.
    position: watch::Receiver<Option<Position>>,
}

/// The kinds of records; each kind is counted separately.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Class {
    Done,
    Refused,
    Stranger,
}

impl Class {
    const ALL: [Self; 3] = [Self::Done, Self::Refused, Self::Stranger];

    const fn per_minute(self) -> u32 {
        if matches!(self, Self::Stranger) { STRANGERS_PER_MINUTE } else { PER_MINUTE }
    }

    /// Says how many records were left out.
    fn more(self, count: u32, reason: &str) -> AuditEntry {
        let decision = if self == Self::Done { Decision::Done } else { Decision::Refused };
        let who = if self == Self::Stranger { "strangers" } else { "many" };
        AuditEntry { who: who.to_owned(), ..more(decision, count, reason) }
    }
}

/// How many records were written in this minute (`count`), and how many more were left out (`lost`).
#[derive(Debug, Default)]
struct Quota {
    minute: u64,
    count: u32,
    lost: u32,
}

impl Audit {
    /// Continues the log in a folder, or begins a new one.
    ///
    /// # Errors
    /// If the disk refuses.
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

    /// Returns a receiver of the log's position on the disk; none before its first record.
    pub fn position(&self) -> watch::Receiver<Option<Position>> {
        self.position.clone()
    }

    /// Writes a record. Records above the rate limit are only counted. The count is recorded in the next minute, or at the end.
    pub fn record(&self, entry: AuditEntry) {
        let class = if entry.decision == Decision::Refused { Class::Refused } else { Class::Done };
        self.record_of(class, entry);
    }

    /// Writes a record of a refused stranger, like [`Audit::record`], but only a few per minute. Returns whether it is written.
    pub fn record_stranger(&self, entry: AuditEntry) -> bool {
        self.record_of(Class::Stranger, entry)
    }

    fn record_of(&self, class: Class, entry: AuditEntry) -> bool {
        let now = crate::now();
        let mut quotas = self.quotas.lock().unwrap_or_else(PoisonError::into_inner);
        let quota = &mut quotas[class as usize];
        if let Some(count) = quota.begin(now)
            && !self.send(now, class.more(count, TOO_MANY))
        {
            quota.lost += count;
        }
        let is_taken = quota.takes(class.per_minute()) && self.send(now, entry);
        quota.lost += u32::from(!is_taken);
        is_taken
    }

    /// Gives a record to the writer; returns whether the queue had room.
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
fn more(decision: Decision, count: u32, reason: &str) -> AuditEntry {
    let what = if decision == Decision::Refused { "refused" } else { "done" };
    let (who, what) = ("many".to_owned(), format!("{count} more requests that were {what}"));
    AuditEntry { decision, who, what, reason: reason.to_owned() }
}

impl Drop for Audit {
    fn drop(&mut self) {
        let quotas = std::mem::take(self.quotas.get_mut().unwrap_or_else(PoisonError::into_inner));
        if let Some(records) = self.records.take() {
            for (quota, class) in quotas.into_iter().zip(Class::ALL) {
                if quota.lost > 0 {
                    // The writer takes the waiting records first, and then this one: no other sender is left.
                    drop(records.send((crate::now(), class.more(quota.lost, TOO_MANY))));
                }
            }
        }
        if let Some(writer) = self.writer.take() {
            drop(writer.join());
        }
    }
}

impl Quota {
    /// Begins a new minute, if the last one is over. Returns how many records were left out in the last minute.
    fn begin(&mut self, now: UnixTime) -> Option<u32> {
        if now.0 / 60 == self.minute {
            return None;
        }
        let lost = self.lost;
        *self = Self { minute: now.0 / 60, count: 0, lost: 0 };
        (lost > 0).then_some(lost)
    }

    fn takes(&mut self, per_minute: u32) -> bool {
        self.count = self.count.saturating_add(1);
        self.count <= per_minute
    }
}

/// The end of the log on the disk, and the records that are not on the disk yet.
#[derive(Debug)]
struct Writer {
    path: PathBuf,
    /// The log, up to the last record on the disk.
    log: Log,
    file: File,
    /// The size in bytes of the records on the disk.
    size: u64,
    /// Whether a part of a record may follow them.
    is_torn: bool,
    /// Records that wait, the oldest first.
    waiting: Vec<(UnixTime, AuditEntry)>,
    /// How many records were left out: first the records of actions, then the records of refusals.
    lost: [u32; 2],
}

impl Writer {
    fn open(path: PathBuf, team: KeyId, node: KeyId) -> anyhow::Result<Self> {
        match read(&path) {
            Ok(Some(log)) if log.of() == (team, node) => {
                let file = append(&path)?;
                let size = file.metadata().with_context(|| format!("reading `{}`", path.display()))?.len();
                return Ok(Self::at(path, log, file, size));
            }
            Ok(None) => {
                // A node that was killed between two logs has only the previous log.
                let before = read(&path.with_extension("1")).ok().flatten().filter(|log| log.of() == (team, node));
                return Self::begin(path, team, node, before.as_ref());
            }
            Ok(Some(_of_another)) => {}
            Err(error) => {
                // A manipulated log is kept, but not continued.
                tracing::error!(
                    error = format!("{error:#}"),
                    "the audit log was changed after it was written; a new log begins"
                );
            }
        }
        let kept = path.with_extension(format!("of-{}", crate::now().0));
        fs::rename(&path, &kept).with_context(|| format!("keeping `{}`", kept.display()))?;
        Self::begin(path, team, node, None)
    }

    const fn at(path: PathBuf, log: Log, file: File, size: u64) -> Self {
        Self { path, log, file, size, is_torn: false, waiting: Vec::new(), lost: [0; 2] }
    }

    /// Makes a log with this name. The file has its first line, or is not made at all.
    fn begin(path: PathBuf, team: KeyId, node: KeyId, before: Option<&Log>) -> anyhow::Result<Self> {
        let (log, line) = Log::begin(team, node, before);
        folder::write(&path, format!("{line}\n").as_bytes())?;
        let file = append(&path)?;
        Ok(Self::at(path, log, file, line.len() as u64 + 1))
    }

    fn run(
        mut self,
        records: &Receiver<(UnixTime, AuditEntry)>,
        refused: &AtomicUsize,
        positions: &watch::Sender<Option<Position>>,
    ) {
        let mut is_open = true;
        while is_open {
            let first = if self.waiting.is_empty() {
                records.recv().map_err(|_closed| RecvTimeoutError::Disconnected)
            } else {
                records.recv_timeout(AGAIN_AFTER)
            };
            is_open = first != Err(RecvTimeoutError::Disconnected);
            // The waiting records are written together.
            for (at, entry) in first.into_iter().chain(records.try_iter().take(TOGETHER_MAX)) {
                if entry.decision == Decision::Refused {
                    refused.fetch_sub(1, Ordering::Relaxed);
                }
                self.take(at, entry);
            }
            self.write(positions);
        }
    }

    /// Adds a record to the waiting ones. A record without room is only counted.
    fn take(&mut self, at: UnixTime, entry: AuditEntry) {
        let is_refusal = |entry: &AuditEntry| entry.decision == Decision::Refused;
        let refused = self.waiting.iter().filter(|(_, waiting)| is_refusal(waiting)).count();
        let has_room =
            self.waiting.len() < WAITING_MAX && !(is_refusal(&entry) && refused >= REFUSED_MAX) && self.lost == [0; 2];
        if has_room {
            self.waiting.push((at, entry));
        } else {
            let lost = &mut self.lost[usize::from(is_refusal(&entry))];
            *lost = lost.saturating_add(1);
        }
    }

    /// Writes the waiting records. If this fails, the log is unchanged.
    fn write(&mut self, positions: &watch::Sender<Option<Position>>) {
        let lost = [Decision::Done, Decision::Refused].into_iter().zip(self.lost).filter(|(_, count)| *count > 0);
        let lost = lost.map(|(decision, count)| (crate::now(), more(decision, count, "the disk has refused them")));
        let (mut log, mut lines) = (self.log, String::new());
        for (at, AuditEntry { decision, who, what, reason }) in self.waiting.iter().cloned().chain(lost) {
            let entry = Entry { at, decision, who: &who, what: &what, request: [0; 16], reason: &reason };
            lines += &(log.add(&entry) + "\n");
        }
        if lines.is_empty() {
            return;
        }
        if let Err(error) = self.append(lines.as_bytes()) {
            tracing::error!(%error, waiting = self.waiting.len(), "the audit log cannot be written; its records wait");
            return;
        }
        self.log = log;
        self.waiting.clear();
        self.lost = [0; 2];
        // The first record of a log contains the end of the previous log, so a signature on that end also covers the previous log.
        positions.send_replace(log.position());
        if self.size >= SIZE_MAX
            && let Err(error) = self.turn_over()
        {
            tracing::error!(
                error = format!("{error:#}"),
                "the audit log grows beyond its size limit, because no new log can begin"
            );
        }
    }

    /// Appends complete records. If the disk refuses a part of them, the part that it has taken is cut off, now or before the next
    /// attempt.
    fn append(&mut self, lines: &[u8]) -> io::Result<()> {
        self.mend()?;
        self.is_torn = true;
        let written = self.file.write_all(lines).and_then(|()| self.file.sync_data());
        if written.is_ok() {
            self.is_torn = false;
            self.size += lines.len() as u64;
        } else if let Err(error) = self.mend() {
            tracing::error!(%error, "an incomplete record stays at the end of the audit log until the disk lets it be removed");
        }
        written
    }

    fn mend(&mut self) -> io::Result<()> {
        if self.is_torn {
            self.file.set_len(self.size)?;
            self.is_torn = false;
        }
        Ok(())
    }

    /// Begins the next log. It is complete before it gets the name, so after any failure one of the two logs can be continued.
    fn turn_over(&mut self) -> anyhow::Result<()> {
        let (next, kept) = (self.path.with_extension("next"), self.path.with_extension("1"));
        let (team, node) = self.log.of();
        let begun = Self::begin(next.clone(), team, node, Some(&self.log))?;
        fs::rename(&self.path, &kept).with_context(|| format!("keeping `{}`", kept.display()))?;
        if let Err(error) = fs::rename(&next, &self.path) {
            fs::rename(&kept, &self.path).with_context(|| format!("after {error}"))?;
            return Err(error).with_context(|| format!("beginning `{}`", self.path.display()));
        }
        *self = Self { path: self.path.clone(), ..begun };
        Ok(())
    }
}

/// Returns whether the log of a node in a folder, or the previous one, has a record with a field that begins with `what`. An unreadable
/// log counts as having none, and so does a log that the node wrote with earlier keys.
pub fn mentions(folder: &Path, node: KeyId, what: &str) -> bool {
    let path = folder.join(FILE);
    let what = format!("\t{what}");
    [path.with_extension("1"), path].iter().any(|path| {
        let log = file::bytes(path, LOG_MAX).unwrap_or_default();
        let begin = log.split(|byte| *byte == b'\n').next().and_then(|line| std::str::from_utf8(line).ok());
        begin.and_then(Log::node_of) == Some(node) && log.windows(what.len()).any(|text| text == what.as_bytes())
    })
}

fn append(path: &Path) -> anyhow::Result<File> {
    file::appended(path, Privacy::Own).with_context(|| format!("writing `{}`", path.display()))
}

/// Returns the end of a log; none if the log is missing, or has no complete line. An incomplete
/// last line, after a power cut or on a full disk, is ignored.
fn read(path: &Path) -> anyhow::Result<Option<Log>> {
    let file = match file::opened(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
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
    if whole == 0 {
        return Ok(None);
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
        // A manipulated log is kept beside the new one.
        let changed = lines(&folder).join("\n").replace("somebody 1", "somebody 9") + "\n";
        fs::write(folder.join(FILE), changed).unwrap();
        drop(Audit::open(&folder, team, node).unwrap());
        assert_eq!(lines(&folder).len(), 1);
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 2);
        fs::remove_dir_all(&folder).unwrap();
    }

    fn writer(name: &str) -> (PathBuf, Writer) {
        let folder = std::env::temp_dir().join(format!("dca-audit-{name}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let writer = Writer::open(folder.join(FILE), KeyId([1; 32]), KeyId([2; 32])).unwrap();
        (folder, writer)
    }

    #[test]
    fn what_a_full_disk_has_refused_waits_and_is_written_whole() {
        let (folder, mut writer) = writer("full");
        let positions = watch::Sender::new(None);
        let give = |writer: &mut Writer, who: &str| {
            writer.take(UnixTime(7), entry(who));
            writer.write(&positions);
        };
        give(&mut writer, "before");
        // The disk takes only a part of a record, and this part cannot be removed either.
        append(&folder.join(FILE)).unwrap().write_all(b"2\t7\tref").unwrap();
        let disk = std::mem::replace(&mut writer.file, full());
        (0..200).for_each(|number| give(&mut writer, &format!("somebody {number}")));
        assert!(writer.is_torn && lines(&folder).len() == 3);
        assert_eq!(positions.borrow().map(|position| position.number), Some(1), "nobody signs what is not there");
        writer.file = disk;
        give(&mut writer, "after");
        let (lines, log) = (lines(&folder), read(&folder.join(FILE)).unwrap().unwrap());
        // The first line, the first record, the records for which there was room, and the count of the others.
        assert_eq!((lines.len(), log.last()), (2 + 128 + 1, 130));
        assert!(
            lines[130].contains("73 more requests that were refused\t") && lines[130].contains("the disk has refused")
        );
        assert_eq!(positions.borrow().map(|position| position.number), Some(130));
        give(&mut writer, "later");
        assert_eq!(read(&folder.join(FILE)).unwrap().unwrap().last(), 131);
        fs::remove_dir_all(&folder).unwrap();
    }

    fn full() -> File {
        OpenOptions::new().append(true).open("/dev/full").unwrap()
    }

    #[test]
    fn the_next_log_begins_whole_or_not_at_all() {
        let (folder, mut writer) = writer("next");
        let positions = watch::Sender::new(None);
        let give = |writer: &mut Writer| {
            writer.take(UnixTime(7), entry("somebody"));
            writer.size += SIZE_MAX;
            writer.write(&positions);
            writer.size %= SIZE_MAX;
        };
        // A folder of this name has the same effect as a full disk.
        fs::create_dir(folder.join("audit.next")).unwrap();
        give(&mut writer);
        assert_eq!((lines(&folder).len(), folder.join("audit.1").exists()), (2, false));
        fs::remove_dir(folder.join("audit.next")).unwrap();
        give(&mut writer);
        assert_eq!(lines(&folder).len(), 1);
        // A node that is killed between the two renames has the previous log, and continues from it.
        drop(writer);
        fs::remove_file(folder.join(FILE)).unwrap();
        let writer = Writer::open(folder.join(FILE), KeyId([1; 32]), KeyId([2; 32])).unwrap();
        assert_eq!((writer.log.last(), lines(&folder).len()), (2, 1));
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
        // A minute may have ended in the meantime.
        let more = |line: &String| -> Option<usize> {
            line.split_once(" more requests that were refused")?.0.split('\t').next_back()?.parse().ok()
        };
        let more: usize = lines.iter().filter_map(more).sum();
        assert_eq!(strangers + more, 10_000, "all are counted");
        assert!(lines.iter().all(|line| !line.contains("more requests that were done")));
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn strangers_hide_no_refusal_of_a_member_and_are_summed() {
        let folder = std::env::temp_dir().join(format!("dca-audit-strangers-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let audit = Audit::open(&folder, KeyId([1; 32]), KeyId([2; 32])).unwrap();
        for number in 0..10_000 {
            audit.record_stranger(entry(&format!("stranger {number}")));
            if number % 1000 == 999 {
                audit.record(entry("vera"));
            }
        }
        drop(audit);
        let lines = lines(&folder);
        assert_eq!(lines.iter().filter(|line| line.contains("\tvera\t")).count(), 10);
        let strangers = lines.iter().filter(|line| line.contains("\tstranger ")).count();
        let sums = lines.iter().filter(|line| line.contains("\tstrangers\t"));
        let counted = |line: &String| -> Option<usize> {
            line.split_once(" more requests that were refused")?.0.split('\t').next_back()?.parse().ok()
        };
        let counts: Vec<usize> = sums.filter_map(counted).collect();
        // A minute may have ended in the meantime.
        assert!(strangers <= 8 * counts.len() && counts.len() <= 2, "{strangers} {counts:?}");
        assert_eq!(strangers + counts.iter().sum::<usize>(), 10_000, "all are counted");
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn too_many_are_counted() {
        let (mut quota, at) = (Quota::default(), UnixTime(6000));
        assert_eq!(quota.begin(at), None);
        let taken = (0..1000).filter(|_| quota.takes(PER_MINUTE)).count();
        assert_eq!(taken, 600);
        quota.lost = 400;
        assert_eq!((quota.begin(at.plus(59)), quota.begin(at.plus(60))), (None, Some(400)));
    }
}
