//! Compares the cost of DCA with the cost of the same work without it. One run measures both, in turn: `cargo bench -p
//! dca-tests`.
//!
//! The benchmarks measure a hop between two controllers, one writer with many readers, the greatest rate, a call and a
//! message to a queue, a row of stages, the time from the end of one process to the run of the next, the end of a
//! killed program, and the start of a whole deployment. The measured programs are this executable again, with other
//! arguments.

mod call;
mod caterpillar;
mod dora;
mod event;
mod faults;
mod figures;
mod hop;
mod node;
mod programs;
mod raw;
mod raw_memory;
mod raw_streams;
mod ros;
mod sdk;
mod start;
mod streams;

use anyhow::Context;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

fn main() -> ExitCode {
    comms::io::session::prepare_process(comms::io::session::Role::End);
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let result = match arguments.first().map(String::as_str) {
        Some("raw") => raw::side(&arguments[1..]),
        Some("stream") => raw_streams::side(&arguments[1..]),
        Some("ros") => ros::side(&arguments[1..]),
        Some(_) if arguments.iter().any(|argument| argument == "--bench") => {
            bench(arguments.iter().map(String::as_str).find(|argument| !argument.starts_with('-')))
        }
        Some(_) => return controllers::sdk::process::run(&programs::registry()),
        None => say("this measures only when it is started by `cargo bench`"),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            writeln!(std::io::stderr(), "the benchmark failed: {error:#}").unwrap_or_default();
            ExitCode::FAILURE
        }
    }
}

/// Measures everything, or only the benchmark with this name: `hop`, `fan`, `rate`, `call`, `caterpillar`, `event`,
/// `faults` or `start`.
fn bench(only: Option<&str>) -> anyhow::Result<()> {
    let folder = Folder::new()?;
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    let wanted = |name| only.is_none_or(|only| only == name);
    let mut table = figures::Table::default();
    runtime.block_on(async {
        if wanted("hop") {
            say("one hop between two controllers …")?;
            hop::measure(&folder.0, &mut table).await?;
        }
        if wanted("fan") {
            say("one controller to 20 …")?;
            streams::measure_fan(&folder.0, &mut table).await?;
        }
        if wanted("rate") {
            say("as fast as it goes …")?;
            streams::measure_rate(&folder.0, &mut table).await?;
        }
        if wanted("caterpillar") {
            say("a source, eight stages, eight sinks …")?;
            caterpillar::measure(&folder.0, &mut table).await?;
        }
        if wanted("call") {
            say("a call to what a program exports, and a message to its queue …")?;
            call::measure(&folder.0, &mut table).await?;
        }
        if wanted("event") {
            say("from the end of one process to the run of the next …")?;
            event::measure(&folder.0, &mut table).await?;
        }
        if wanted("faults") {
            say("programs are killed; a loop of 1 kHz …")?;
            faults::measure(&folder.0, &mut table).await?;
        }
        if wanted("start") {
            say("from PREPARE to GO …")?;
            start::measure(&folder.0, &mut table).await?;
        }
        if wanted("ros") {
            say("through a bridge to ROS 2 …")?;
            ros::measure(&folder.0, &mut table).await?;
        }
        anyhow::Ok(())
    })?;
    say(&table.text())
}

fn say(text: &str) -> anyhow::Result<()> {
    Ok(writeln!(std::io::stdout(), "{text}")?)
}

/// The folder for files in memory on a Linux machine. It is in memory like `/run`, where the node of a service has its
/// own folder.
const MEMORY: &str = "/dev/shm";

/// A folder for sockets and the records of nodes, in memory if possible. It is removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new() -> anyhow::Result<Self> {
        let name = format!("dca-bench-{}", std::process::id());
        let in_memory = Path::new(MEMORY).join(&name);
        if std::fs::create_dir(&in_memory).is_ok() {
            return Ok(Self(in_memory));
        }
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir(&path).with_context(|| format!("making {}", path.display()))?;
        Ok(Self(path))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        remove(&self.0);
    }
}

fn remove(path: &Path) {
    if let Err(error) = std::fs::remove_dir_all(path) {
        writeln!(std::io::stderr(), "{} stays behind: {error}", path.display()).unwrap_or_default();
    }
}
