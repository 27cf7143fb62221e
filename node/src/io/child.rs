//! Starts programs and sends signals to them; no other module does this. Each program has a shim, which takes orders
//! and makes reports as lines.
//!
//! If this node has started a shim, it exchanges lines with it over two pipes. If an earlier run of the node has
//! started it, this node attaches to its socket. Both ends count the lines as `shim::protocol` defines, so that no line
//! is lost or carried out twice.
//!
//! Dropping these values kills no program: if its node has died, a shim follows its own rule, and a living node sends orders.

mod executable;
pub mod leftovers;
mod overdue;
pub mod reach;

pub use executable::check_executable;

use crate::logic::output_lines::last_lines;
use comms::io::{clock, file};
use comms::logic::bytes::SecretBytes;
use language::plan::Usage;
use overdue::Overdue;
use rustix::net::sockopt::{Timeout, set_socket_timeout};
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, connect, socket_with};
use shim::protocol::{
    AttachReply, AttachRequest, EXIT_FILE, LEVELS, Limits, OUTPUT_FILE, OUTPUT_FILE_OLD, Realtime, SOCKET_FILE,
    ShimOrder, ShimReport, ShimStart,
};
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, BufReader};
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::process::{ChildStdin, ChildStdout};
use tokio::sync::mpsc::{Receiver, Sender};

/// The part of a program's output that is searched for its last lines, in bytes.
const LAST_OUTPUT_MAX: u64 = 32 << 10;
/// How long a shim may take for each step of an attachment; a suspended shim takes no step.
const ATTACH_WITHIN: Duration = Duration::from_secs(3);
/// The longest record of an instance, in bytes.
const RECORD_MAX: usize = 1 << 20;
/// The longest reply to an attachment, including its end, in bytes.
const REPLY_MAX: usize = 64;
/// The file in the instance directory with the length of [`OUTPUT_FILE`] at the start of the program, in bytes. A later node reads it.
const OUTPUT_BEGIN_FILE: &str = "out.begin";

/// The way for orders to a shim.
#[derive(Debug)]
pub struct ShimOrders {
    channel: OrderChannel,
    /// The secrets that the shim gets before the first order.
    secrets: SecretBytes,
}

#[derive(Debug)]
enum OrderChannel {
    Started(ChildStdin),
    Attached(OwnedWriteHalf),
}

/// The reports of a shim, until it ends.
#[derive(Debug)]
pub struct ShimReports {
    channel: ReportChannel,
    dir: PathBuf,
    /// The length of the output file at the start of the program. Earlier bytes do not belong to this program.
    written_before: u64,
}

#[derive(Debug)]
enum ReportChannel {
    Started(std::process::Child, ChildStdout),
    /// The bytes that were read together with the reply, and the rest of the stream.
    Attached(Vec<u8>, OwnedReadHalf),
}

/// A shim that an earlier run of the node has started, and that now takes orders from this run.
#[derive(Debug)]
pub struct Attached {
    /// Takes further orders, after the orders that the shim has already taken.
    pub orders: ShimOrders,
    /// The reports that the node did not know yet.
    pub reports: ShimReports,
    /// How many orders the shim has taken from all runs of the node.
    pub taken: u64,
    /// How many of these reports the shim had made before the attachment.
    pub missed: usize,
}

/// Starts a shim. Blocks while files are written.
///
/// # Errors
/// The shim cannot be started, or files of an earlier shim cannot be removed.
///
/// # Panics
/// Outside a tokio runtime.
pub fn start(shim: &Path, start: &ShimStart) -> io::Result<(ShimOrders, ShimReports)> {
    let written_before = std::fs::metadata(start.dir.join(OUTPUT_FILE)).map_or(0, |file| file.len());
    // This node may have died and been restarted a moment ago. Until the new shim has written these
    // files, they would be the files of an earlier program.
    for stale in [EXIT_FILE, SOCKET_FILE] {
        remove_stale(&start.dir.join(stale))?;
    }
    // Without this file, a later node would count the output of earlier programs as output of this one.
    if let Err(error) = file::write(&start.dir.join(OUTPUT_BEGIN_FILE), written_before.to_string().as_bytes()) {
        tracing::debug!(%error, "cannot store where the output of a program begins");
    }
    // The environment is not among the arguments, because every user of the machine can read these.
    let arguments = ShimStart { environment: Vec::new(), ..start.clone() }.arguments();
    let mut child = Command::new(shim)
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .env_clear()
        .envs(start.variables())
        .spawn()?;
    let missing = || io::Error::other("a pipe to the shim is missing");
    let orders = ChildStdin::from_std(child.stdin.take().ok_or_else(missing)?)?;
    let reports = ChildStdout::from_std(child.stdout.take().ok_or_else(missing)?)?;
    let channel = ReportChannel::Started(child, reports);
    let reports = ShimReports { channel, dir: start.dir.clone(), written_before };
    Ok((ShimOrders { channel: OrderChannel::Started(orders), secrets: SecretBytes::default() }, reports))
}

/// Attaches to the shim in `dir` that an earlier run of this node has started. `known_reports` is the number of its
/// reports that are known already; the returned reports begin after these. Blocks, for 10 s at most.
///
/// # Errors
/// `TimedOut`: the shim exists and does not answer; it is suspended, or another node is still attached. All other
/// kinds: the shim takes no orders. It is gone (`NotFound`, `ConnectionRefused`), is just leaving (`ConnectionReset`,
/// `UnexpectedEof`), or has never made so many reports (`UnexpectedEof`). [`ended`] then says how its program ended.
///
/// # Panics
/// Outside a tokio runtime.
pub fn attach(dir: &Path, known_reports: u64) -> io::Result<Attached> {
    let silent = |error: io::Error| {
        let is_late = error.kind() == io::ErrorKind::WouldBlock;
        if is_late { io::Error::new(io::ErrorKind::TimedOut, "the shim does not answer") } else { error }
    };
    let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, SocketFlags::CLOEXEC, None)?;
    // The time limit also applies to the connection: if the kernel's queue of connections is full, connecting waits.
    set_socket_timeout(&socket, Timeout::Send, Some(ATTACH_WITHIN))?;
    connect(&socket, &SocketAddrUnix::new(dir.join(SOCKET_FILE))?).map_err(|error| silent(error.into()))?;
    let mut stream = UnixStream::from(socket);
    stream.set_read_timeout(Some(ATTACH_WITHIN))?;
    stream.write_all(format!("{}\n", AttachRequest { reports: known_reports }).as_bytes()).map_err(silent)?;
    let reply = read_reply(&mut stream).map_err(silent)?;
    stream.set_nonblocking(true)?;
    // The shim has written these reports together with the reply.
    let ahead = read_ready(&mut stream)?;
    let missed = ahead.split_inclusive(|byte| *byte == b'\n').filter(|line| is_report(line)).count();
    let (reports, orders) = tokio::net::UnixStream::from_std(stream)?.into_split();
    let channel = ReportChannel::Attached(ahead, reports);
    Ok(Attached {
        orders: ShimOrders { channel: OrderChannel::Attached(orders), secrets: SecretBytes::default() },
        reports: ShimReports { channel, dir: dir.to_owned(), written_before: output_begin(dir) },
        taken: reply.orders,
        missed,
    })
}

/// Reads the available bytes, without waiting for more.
fn read_ready(stream: &mut UnixStream) -> io::Result<Vec<u8>> {
    let (mut ready, mut bytes) = (Vec::new(), [0; 4096]);
    while ready.len() < RECORD_MAX {
        match stream.read(&mut bytes) {
            Ok(0) => break,
            Ok(count) => ready.extend_from_slice(&bytes[..count]),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(ready)
}

/// Returns whether these bytes are a whole line with a report.
fn is_report(line: &[u8]) -> bool {
    let line = line.strip_suffix(b"\n").and_then(|line| std::str::from_utf8(line).ok());
    line.and_then(ShimReport::parse).is_some()
}

/// Reads the reply, but no byte of the reports after it.
fn read_reply(stream: &mut UnixStream) -> io::Result<AttachReply> {
    let mut line = Vec::new();
    let mut byte = [0];
    while line.len() < REPLY_MAX {
        stream.read_exact(&mut byte)?;
        if byte == *b"\n" {
            break;
        }
        line.extend(byte);
    }
    let reply = String::from_utf8_lossy(&line);
    AttachReply::parse(&reply)
        .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidData, format!("`{reply}` is not a reply")))
}

/// Returns how the program in `dir` ended, according to the record of its shim. Returns nothing if the program did not
/// end or was never started, or if its shim was killed. The record is about the program that was started last.
pub fn ended(dir: &Path) -> Option<ShimReport> {
    let record = text(&dir.join(EXIT_FILE))?;
    ShimReport::parse(record.strip_suffix('\n')?)
}

/// Kills the leftovers of a killed shim until there are none. If the kernel does not remove a process, it may still move something.
async fn end_left(dir: PathBuf) {
    let ending = |round| {
        let folder = dir.clone();
        tokio::task::spawn_blocking(move || leftovers::end_round(&folder, round))
    };
    let mut round = 0;
    while !ending(round).await.unwrap_or(true) {
        clock::sleep_until(clock::now() + leftovers::END_AGAIN).await;
        round += 1;
    }
    remove_stale(&dir.join(EXIT_FILE)).unwrap_or_default();
}

/// Removes the record of an end. The node is about to note this end.
async fn forget_end(dir: &Path) {
    let record = dir.join(EXIT_FILE);
    let removed = tokio::task::spawn_blocking(move || remove_stale(&record)).await;
    if let Ok(Err(error)) = removed {
        tracing::warn!(%error, "the record of an end stays");
    }
}

/// Returns the last output lines of the program in `dir`, if [`ended`] has returned its end.
pub fn ended_output(dir: &Path) -> Vec<String> {
    last_output(dir, output_begin(dir))
}

/// Returns the length of the output file at the start of the program, or 0 if it is not known.
fn output_begin(dir: &Path) -> u64 {
    let begin = text(&dir.join(OUTPUT_BEGIN_FILE));
    begin.and_then(|length| length.parse().ok()).unwrap_or(0)
}

/// Returns the text of a small file in an instance directory; nothing if the file does not exist.
fn text(path: &Path) -> Option<String> {
    String::from_utf8(file::bytes_itself(path, RECORD_MAX).ok()?).ok()
}

fn remove_stale(path: &Path) -> io::Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Returns the further levels of this shim's sandbox that the kernel supports, besides capabilities: `landlock`, `seccomp`. Blocks.
///
/// # Errors
/// The shim cannot be started, or does not print the levels.
pub fn sandbox_levels(shim: &Path) -> io::Result<Vec<String>> {
    let said = Command::new(shim).arg(LEVELS).stdin(Stdio::null()).stderr(Stdio::null()).env_clear().output()?;
    if !said.status.success() {
        return Err(io::Error::other("the shim does not report which parts its sandbox has"));
    }
    Ok(String::from_utf8_lossy(&said.stdout).split_whitespace().map(str::to_owned).collect())
}

impl ShimOrders {
    /// Adds the secrets of the program, in the form of [`shim::protocol::secret`].
    #[must_use]
    pub(crate) fn with(self, secrets: SecretBytes) -> Self {
        Self { secrets, ..self }
    }

    /// Sends the orders in `first` and then all others. If the shim is gone, orders are lost; the reports of the shim say how it ended.
    ///
    /// # Cancellation
    /// The shim then treats its node as gone.
    pub async fn pass(self, first: Vec<ShimOrder>, mut orders: Receiver<ShimOrder>) {
        let mut channel: Box<dyn AsyncWrite + Send + Unpin> = match self.channel {
            OrderChannel::Started(pipe) => Box::new(pipe),
            OrderChannel::Attached(socket) => Box::new(socket),
        };
        if let Err(error) = channel.write_all(self.secrets.expose()).await {
            tracing::debug!(%error, "shim does not listen");
        }
        drop(self.secrets);
        let mut first = first.into_iter();
        while let Some(order) = match first.next() {
            Some(order) => Some(order),
            None => orders.recv().await,
        } {
            if let Err(error) = channel.write_all(format!("{order}\n").as_bytes()).await {
                tracing::debug!(%error, "shim does not listen");
            }
        }
    }
}

impl ShimReports {
    /// Passes on every report. The report of an end comes with the last lines of output. The last report is always `Gone`.
    ///
    /// # Cancellation
    /// Not safe: reports would be lost. This runs in its own task until the shim ends.
    pub async fn listen(self, sink: Sender<(ShimReport, Vec<String>)>) {
        let Self { channel, dir, written_before } = self;
        let (mut child, reports): (_, Box<dyn AsyncRead + Send + Unpin>) = match channel {
            ReportChannel::Started(child, pipe) => (Some(child), Box::new(pipe)),
            ReportChannel::Attached(ahead, socket) => {
                (None, Box::new(AsyncReadExt::chain(io::Cursor::new(ahead), socket)))
            }
        };
        let mut lines = BufReader::new(reports).lines();
        let (mut gone, mut overdue) = (false, if child.is_some() { Overdue::No } else { Overdue::recorded(&dir) });
        loop {
            let line = tokio::select! {
                line = lines.next_line() => line,
                () = overdue.wait() => {
                    overdue.act(&dir).await;
                    continue;
                }
            };
            let Ok(Some(line)) = line else { break };
            let Some(report) = ShimReport::parse(&line) else { continue };
            if let ShimReport::Started { pid } = report {
                overdue = Overdue::of(pid);
            } else if report.end().is_some() || report == ShimReport::Gone {
                overdue = Overdue::No;
            }
            let output = if report.end().is_some() {
                let folder = dir.clone();
                let reading = tokio::task::spawn_blocking(move || last_output(&folder, written_before));
                reading.await.unwrap_or_default()
            } else {
                Vec::new()
            };
            gone |= report == ShimReport::Gone;
            if gone {
                // The record is removed before the node notes the end. So any later record belongs to the next program.
                forget_end(&dir).await;
            }
            if sink.send((report, output)).await.is_err() {
                return;
            }
        }
        let reaping = tokio::task::spawn_blocking(move || {
            // A shim that this node has attached to is the child of another process, so it is not waited for here.
            child.as_mut().map_or(Ok(()), |child| child.wait().map(drop))
        });
        // The shim may be traced, even by its own program. The tracer then has to collect its end first, so the
        // leftovers are killed before that.
        if !gone {
            end_left(dir).await;
            // The receiver is gone only if the node is leaving.
            sink.send((ShimReport::Gone, Vec::new())).await.unwrap_or_default();
        }
        drop(sink);
        if let Ok(Err(error)) = reaping.await {
            tracing::warn!(%error, "cannot reap a shim");
        }
    }
}

/// Returns the last lines of a program's output. The first `before` bytes of the file are not from this program.
fn last_output(dir: &Path, before: u64) -> Vec<String> {
    let now = dir.join(OUTPUT_FILE);
    let length = std::fs::metadata(&now).map_or(0, |file| file.len());
    // If the file is shorter than before, it is a new file: the previous one has been put aside.
    let rotated = length < before;
    let (mut output, cut) = end_of(&now, if rotated { 0 } else { before }).unwrap_or_default();
    if cut || !rotated {
        return last_lines(&output, cut);
    }
    let (mut whole, cut) = end_of(&dir.join(OUTPUT_FILE_OLD), before).unwrap_or_default();
    whole.append(&mut output);
    last_lines(&whole, cut)
}

/// Returns the end of a file, at most from `before` on, and whether bytes after `before` were left out.
fn end_of(path: &Path, before: u64) -> io::Result<(Vec<u8>, bool)> {
    use std::io::{Seek, SeekFrom};
    let mut file = file::opened_itself(path)?;
    let begin = file.metadata()?.len().saturating_sub(LAST_OUTPUT_MAX).max(before);
    file.seek(SeekFrom::Start(begin))?;
    let mut end = Vec::new();
    file.take(LAST_OUTPUT_MAX).read_to_end(&mut end)?;
    Ok((end, begin > before))
}

/// Converts the resources that a spec grants a program to the shim's form.
pub fn limits(usage: &Usage) -> Limits {
    let realtime = usage.realtime.map(|one| Realtime { priority: one.priority, is_optional: one.is_optional });
    Limits {
        memory: usage.memory,
        cpu: usage.cpu,
        files: usage.files,
        nice: usage.nice,
        realtime,
        pids: usage.pids,
        cpu_share: usage.cpu_share,
        file_size: usage.file_size,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_lines_are_of_this_program_and_reach_past_a_rotation() {
        let dir = std::env::temp_dir().join(format!("dca-child-{}", std::process::id()));
        std::fs::create_dir_all(&dir).unwrap();
        assert_eq!(last_output(&dir, 0), Vec::<String>::new());
        std::fs::write(dir.join(OUTPUT_FILE), "the one before\nValueError: no lens\n").unwrap();
        assert_eq!(last_output(&dir, 15), ["ValueError: no lens"]);
        assert_eq!(last_output(&dir, 35), Vec::<String>::new(), "this program has written nothing");
        std::fs::rename(dir.join(OUTPUT_FILE), dir.join(OUTPUT_FILE_OLD)).unwrap();
        std::fs::write(dir.join(OUTPUT_FILE), "b\n").unwrap();
        assert_eq!(last_output(&dir, 15), ["ValueError: no lens", "b"]);
        let long = "x".repeat(100) + "\n";
        std::fs::write(dir.join(OUTPUT_FILE), long.repeat(1000)).unwrap();
        assert_eq!(last_output(&dir, 0), vec![long.trim_end(); 20]);
        std::fs::remove_dir_all(&dir).unwrap();
    }
}
