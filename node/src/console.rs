//! Streams and exit codes of all programs. Results go to standard output, everything else goes to standard error.
//!
//! Exit codes: 0 done, 1 refused or failed, 2 usage, 3 unreachable, 4 not decided within the limits.

mod given;

use crate::logic::printable::printable;
use anyhow::anyhow;
use clap::{ArgMatches, FromArgMatches, Parser};
use comms::io::stack;
use serde::Serialize;
use std::io::{self, Write};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{LazyLock, OnceLock};
use std::time::Duration;
use tokio::sync::Notify;
use tokio::task::JoinSet;

/// The longest line of an error, in characters. A line may contain an argument of the command, which may be very long.
const ERROR_LINE_MAX: usize = 1000;

/// The version of a program and its origin, such as `0.1.0 (commit 1a2b3c4d5e6f, x86_64, musl)`. The programs of
/// `packaging/` give the commit to the compiler.
pub static VERSION: LazyLock<String> = LazyLock::new(|| {
    let commit =
        option_env!("DCA_COMMIT").map_or_else(|| "commit unknown".to_owned(), |commit| format!("commit {commit}"));
    let library = if cfg!(target_env = "musl") { "musl" } else { "glibc" };
    format!("{} ({commit}, {}, {library})", env!("CARGO_PKG_VERSION"), std::env::consts::ARCH)
});
/// The first reason why a result could not be written.
static FAILED: OnceLock<io::Error> = OnceLock::new();
/// Set if the command was asked for JSON.
static IN_JSON: AtomicBool = AtomicBool::new(false);
/// Notified when a result could not be written, for any reason.
static UNWRITTEN: Notify = Notify::const_new();

/// The reason why a verb failed; each has its exit code.
#[derive(Debug)]
pub enum Failure {
    /// The command was refused, or it failed: exit code 1.
    Refused(anyhow::Error),
    /// The command was refused, and every reason has been printed: exit code 1.
    Reported,
    /// The command names something that does not exist: exit code 2.
    Usage(anyhow::Error),
    /// A node or program could not be reached: exit code 3.
    Unreachable(anyhow::Error),
    /// A node or program could not be reached, and this has been printed: exit code 3.
    ReportedUnreachable,
    /// A limit was reached before everything was decided. The decided and the undecided parts have been printed: exit code 4.
    Limited,
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Refused(error.into())
    }
}

/// Reads the arguments of this process. If the arguments ask only for information, such as `--help`, this function prints it.
///
/// # Errors
/// The exit code, if the program has nothing left to do.
pub fn parsed<T: Parser>() -> Result<T, ExitCode> {
    parsed_by(T::command())
}

/// Reads the arguments with a command line that differs from the command line of their type.
///
/// # Errors
/// The same as for [`parsed`].
pub fn parsed_by<T: FromArgMatches>(mut command: clap::Command) -> Result<T, ExitCode> {
    let matches = command.try_get_matches_from_mut(std::env::args_os());
    let read = matches.and_then(|matches| {
        if asks_for_json(&matches) {
            IN_JSON.store(true, Ordering::Relaxed);
        }
        T::from_arg_matches(&matches).map_err(|error| error.format(&mut command))
    });
    read.map_err(|answer| {
        let is_result = !answer.use_stderr();
        let taken = if is_result { results().flush() } else { Ok(()) };
        let text = answer.render().to_string();
        let shown = given::written_out(&text);
        if !is_result && shown != text {
            note(&shown);
            return u8::try_from(answer.exit_code()).map_or(ExitCode::FAILURE, ExitCode::from);
        }
        match taken.and_then(|()| answer.print()).and_then(|()| io::stdout().flush()) {
            Err(error) if is_result && error.kind() != io::ErrorKind::BrokenPipe => finish(Err(unwritten(&error))),
            _ => u8::try_from(answer.exit_code()).map_or(ExitCode::FAILURE, ExitCode::from),
        }
    })
}

/// Returns whether `--json` was given to a command, or to the verb in it.
fn asks_for_json(matches: &ArgMatches) -> bool {
    let is_given = matches.try_get_one::<bool>("json").is_ok_and(|json| json == Some(&true));
    is_given || matches.subcommand().is_some_and(|(_, verb)| asks_for_json(verb))
}

/// Standard output, for results. If this process has no standard output that can be written, every write fails.
#[derive(Debug)]
struct Results(io::Stdout);

/// Returns standard output, for results.
pub fn results() -> impl Write + Send {
    Results(io::stdout())
}

impl Write for Results {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        given::check()?;
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        given::check()?;
        self.0.flush()
    }
}

fn unwritten(error: &io::Error) -> Failure {
    Failure::Refused(anyhow!("the result could not be written to standard output: {error}"))
}

/// Reports why something was not done; returns the exit code for this reason.
pub fn finish(result: Result<(), Failure>) -> ExitCode {
    let (error, code) = match result {
        Ok(()) => match failed() {
            None => return ExitCode::SUCCESS,
            Some(error) => return finish(Err(unwritten(error))),
        },
        Err(Failure::Reported) => return ExitCode::from(1),
        Err(Failure::ReportedUnreachable) => return ExitCode::from(3),
        Err(Failure::Limited) => return ExitCode::from(4),
        Err(Failure::Refused(error)) => (error, 1),
        Err(Failure::Usage(error)) => (error, 2),
        Err(Failure::Unreachable(error)) => (error, 3),
    };
    complain(&error);
    ExitCode::from(code)
}

/// Writes a result: a text, or the object `{"text": …}` if the command was asked for JSON.
pub fn say(text: &str) {
    if is_json() {
        return answer(&serde_json::json!({ "text": text }));
    }
    put(text);
}

/// Returns whether the command was asked for JSON: `--json` is one of its arguments.
pub fn is_json() -> bool {
    IN_JSON.load(Ordering::Relaxed)
}

/// Writes a result as JSON, on one line.
pub fn answer(value: &impl Serialize) {
    match serde_json::to_string(value) {
        Ok(line) => put(&line),
        // The first reason is the most helpful.
        Err(error) => drop(FAILED.set(error.into())),
    }
}

/// Writes a result. If the result no longer has a reader, this is not reported. Any other failure is a failure of the
/// command ([`failed`]).
fn put(text: &str) {
    let Err(error) = write_result(&mut results(), text) else { return };
    if error.kind() != io::ErrorKind::BrokenPipe {
        // The first reason is the most helpful.
        drop(FAILED.set(error));
    }
    UNWRITTEN.notify_one();
}

/// Returns as soon as a result could not be written, so that an endless command can stop.
///
/// # Cancellation
/// Safe.
pub async fn write_failed() {
    UNWRITTEN.notified().await;
}

/// Writes a result to a stream, and a line feed if the result does not end with one.
///
/// # Errors
/// The result cannot be written to the stream.
pub fn write_result(stream: &mut impl Write, text: &str) -> io::Result<()> {
    stream.write_all(text.as_bytes())?;
    if !text.ends_with('\n') {
        stream.write_all(b"\n")?;
    }
    stream.flush()
}

/// Returns why a result of this command could not be written; nothing if all were written.
pub fn failed() -> Option<&'static io::Error> {
    FAILED.get()
}

/// Writes the output of a program. Returns whether standard output has a reader. Without a reader, the command has no reason to continue.
///
/// # Errors
/// The output cannot be written.
pub fn pass(bytes: &[u8]) -> anyhow::Result<bool> {
    let mut out = results();
    match out.write_all(bytes).and_then(|()| out.flush()) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(false),
        Err(error) => Err(anyhow::Error::new(error).context("writing to standard output")),
    }
}

/// Returns a text for a person in a form that is safe for a terminal. If a name in this process's arguments has a line
/// break, the break does not begin a new line of the text.
pub fn written_out(text: &str) -> String {
    given::written_out(text)
}

/// Writes a line for a person, such as a warning or a finished step.
pub fn note(text: &str) {
    let (mut err, text) = (io::stderr(), written_out(text));
    // The loss of standard error cannot be reported anywhere.
    drop(err.write_all(format!("{}\n", text.trim_end_matches('\n')).as_bytes()).and_then(|()| err.flush()));
}

/// Writes the reason why a command failed.
pub fn complain(error: &anyhow::Error) {
    note(&format!("error: {}", complaint(&format!("{error:#}"))));
}

/// Returns the text of an error in a form that is safe for a terminal. If a line is too long, its middle is left out.
fn complaint(text: &str) -> String {
    let clipped = |line: &str| {
        let length = line.chars().count();
        if length <= ERROR_LINE_MAX {
            return line.to_owned();
        }
        let begin: String = line.chars().take(ERROR_LINE_MAX / 2).collect();
        let end: String = line.chars().skip(length - ERROR_LINE_MAX / 2).collect();
        format!("{begin} … {end}")
    };
    printable(&written_out(text)).lines().map(clipped).collect::<Vec<_>>().join("\n")
}

/// Waits until the first of some tasks has ended, and returns its result.
///
/// # Errors
/// The ended task has failed or panicked.
///
/// # Cancellation
/// Safe.
pub async fn ended(tasks: &mut JoinSet<anyhow::Result<()>>) -> anyhow::Result<()> {
    let ended = tasks.join_next().await;
    ended.map_or(Ok(()), |joined| joined.unwrap_or_else(|panic| Err(panic.into())))
}

/// Runs a program on a stack of the usual size, even if the caller of the process has limited the stack.
pub fn on_own_stack(program: fn() -> ExitCode) -> ExitCode {
    let no_thread = |error| finish(Err(anyhow!("its main thread cannot be started: {error}").into()));
    stack::on_own_stack(program).unwrap_or_else(no_thread)
}

/// Runs work that communicates with nodes.
///
/// # Errors
/// `work` has failed, or the threads cannot be started.
pub fn block_on<T>(work: impl Future<Output = Result<T, Failure>>) -> Result<T, Failure> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    let result = runtime.block_on(work);
    runtime.shutdown_timeout(Duration::from_secs(2));
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_is_short_and_moves_no_cursor() {
        assert_eq!(complaint("the key `a\x1b[31m`\nis refused"), "the key `a\\x1b[31m`\nis refused");
        let long = complaint(&format!("the number {} is too large", "1".repeat(100_000)));
        assert_eq!(long.chars().count(), ERROR_LINE_MAX + 3);
        assert!(long.starts_with("the number 111") && long.ends_with("111 is too large"), "{long}");
    }
}
