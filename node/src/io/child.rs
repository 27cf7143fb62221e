//! The one place that starts and signals programs: each under a shim, which is told with lines and answers with lines.
//!
//! Nothing here kills on drop: a node that dies leaves its shims to their own rule, a node that lives tells them.

pub mod leftovers;

use crate::logic::output_lines::last_lines;
use language::plan::Usage;
use shim::protocol::{Limits, OUTPUT_FILE, OUTPUT_FILE_OLD, Realtime, ShimOrder, ShimReport, ShimStart};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::process::{ChildStdin, ChildStdout};
use tokio::sync::mpsc::{Receiver, Sender};

/// How much of a program's output is read to find its last lines, in bytes.
const LAST_OUTPUT_MAX: u64 = 32 << 10;

/// A started shim, seen from the node: its orders go in here.
#[derive(Debug)]
pub struct ShimOrders {
    orders: ChildStdin,
}

/// The other side of a started shim: what it says, until it ends.
#[derive(Debug)]
pub struct ShimEar {
    child: std::process::Child,
    reports: ChildStdout,
    dir: PathBuf,
    /// How long the file of output was: what was written before is not this program's.
    written_before: u64,
}

/// Starts a shim.
///
/// # Errors
/// The shim itself cannot be started.
pub fn start(shim: &Path, start: &ShimStart) -> io::Result<(ShimOrders, ShimEar)> {
    let written_before = std::fs::metadata(start.dir.join(OUTPUT_FILE)).map_or(0, |file| file.len());
    let mut child = Command::new(shim)
        .args(start.arguments())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .env_clear()
        .spawn()?;
    let missing = || io::Error::other("a pipe to the shim is missing");
    let orders = ChildStdin::from_std(child.stdin.take().ok_or_else(missing)?)?;
    let reports = ChildStdout::from_std(child.stdout.take().ok_or_else(missing)?)?;
    Ok((ShimOrders { orders }, ShimEar { child, reports, dir: start.dir.clone(), written_before }))
}

/// Checks that a command names something that can be executed, so that a spec is refused before anything runs.
///
/// # Errors
/// It is not there, or must not be executed by this user.
pub fn check_executable(command: &[String]) -> io::Result<()> {
    let name = command.first().map_or("", String::as_str);
    let found = if name.contains('/') {
        vec![PathBuf::from(name)]
    } else {
        let path = std::env::var_os("PATH").unwrap_or_default();
        std::env::split_paths(&path).map(|folder| folder.join(name)).filter(|file| file.is_file()).collect()
    };
    let Some(file) = found.first().filter(|file| file.is_file()) else {
        return Err(io::Error::new(io::ErrorKind::NotFound, format!("there is no program `{name}`")));
    };
    if rustix::fs::access(file, rustix::fs::Access::EXEC_OK).is_err() {
        return Err(io::Error::new(
            io::ErrorKind::PermissionDenied,
            format!("`{name}` is not executable by this user"),
        ));
    }
    Ok(())
}

impl ShimOrders {
    /// Passes orders on until there are no more. A shim that is gone is told nothing; its reports say what became of it.
    ///
    /// # Cancellation
    /// The shim then counts its node as gone.
    pub async fn pass(mut self, mut orders: Receiver<ShimOrder>) {
        while let Some(order) = orders.recv().await {
            if let Err(error) = self.orders.write_all(format!("{order}\n").as_bytes()).await {
                tracing::debug!(%error, "shim does not listen");
            }
        }
    }
}

impl ShimEar {
    /// Passes every report on, with the last lines of output beside an exit; the last one is always `Gone`.
    ///
    /// # Cancellation
    /// Not safe: reports are lost. Runs in a task of its own until the shim ends.
    pub async fn listen(self, sink: Sender<(ShimReport, Vec<String>)>) {
        let Self { mut child, reports, dir, written_before } = self;
        let mut lines = BufReader::new(reports).lines();
        let mut gone = false;
        while let Ok(Some(line)) = lines.next_line().await {
            let Some(report) = ShimReport::parse(&line) else { continue };
            let output = match report {
                ShimReport::Exited { .. } | ShimReport::Signalled { .. } => {
                    let folder = dir.clone();
                    let reading = tokio::task::spawn_blocking(move || last_output(&folder, written_before));
                    reading.await.unwrap_or_default()
                }
                ShimReport::Ready | ShimReport::Started { .. } | ShimReport::ExecFailed { .. } | ShimReport::Gone => {
                    Vec::new()
                }
            };
            gone |= report == ShimReport::Gone;
            if sink.send((report, output)).await.is_err() {
                return;
            }
        }
        let reaped = tokio::task::spawn_blocking(move || {
            let reaped = child.wait();
            if !gone {
                leftovers::end_instance(&dir);
            }
            reaped
        });
        if let Ok(Err(error)) = reaped.await {
            tracing::warn!(%error, "cannot reap a shim");
        }
        if !gone {
            // Nobody is left to hear it only when the node itself is leaving.
            sink.send((ShimReport::Gone, Vec::new())).await.unwrap_or_default();
        }
    }
}

/// Returns the last lines that a program has written, of what stands in its folder behind the first `before` bytes.
fn last_output(dir: &Path, before: u64) -> Vec<String> {
    let now = dir.join(OUTPUT_FILE);
    let length = std::fs::metadata(&now).map_or(0, |file| file.len());
    // A file that is shorter than it was is another: the one before has been put aside.
    let rotated = length < before;
    let (mut output, cut) = end_of(&now, if rotated { 0 } else { before }).unwrap_or_default();
    if cut || !rotated {
        return last_lines(&output, cut);
    }
    let (mut whole, cut) = end_of(&dir.join(OUTPUT_FILE_OLD), before).unwrap_or_default();
    whole.append(&mut output);
    last_lines(&whole, cut)
}

/// Returns the end of a file, from `before` on, and whether something in between was left out.
fn end_of(path: &Path, before: u64) -> io::Result<(Vec<u8>, bool)> {
    use std::io::{Read, Seek, SeekFrom};
    let mut file = std::fs::File::open(path)?;
    let begin = file.metadata()?.len().saturating_sub(LAST_OUTPUT_MAX).max(before);
    file.seek(SeekFrom::Start(begin))?;
    let mut end = Vec::new();
    file.take(LAST_OUTPUT_MAX).read_to_end(&mut end)?;
    Ok((end, begin > before))
}

/// Returns what a spec lets a program use, in the shim's words.
pub fn limits(usage: &Usage) -> Limits {
    let realtime = usage.realtime.map(|one| Realtime { priority: one.priority, is_optional: one.is_optional });
    Limits { memory: usage.memory, cpu: usage.cpu, files: usage.files, nice: usage.nice, realtime }
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
