//! Checks that this process was given a writable standard output, resets its signals, and escapes the text of its
//! arguments for output.
//! Before `main`, the runtime of Rust replaces a closed standard stream by `/dev/null`. If a stream is open only for
//! reading, the runtime treats each write to it as done. So a result would be lost unnoticed. Once the runtime has
//! begun, its `/dev/null` looks the same as one from the caller: Python's `subprocess.DEVNULL` has the same flags. So
//! the streams are checked earlier: the loader calls the functions in `.init_array` before the runtime. Source: System
//! V ABI, "Initialization and Termination Functions"; `std::sys::pal::unix::init`.
//!
//! If the caller has blocked signals, they stay blocked in a program that it starts, and in the program's children.
//! SIGTERM could not stop such a node. If SIGCHLD is ignored, the kernel discards the exit status of children. Source:
//! signal(7), "Execution of signal handlers"; sigaction(2). An ignored SIGHUP is intended (`nohup`), and stays ignored.

use crate::logic::printable::one_line;
use std::collections::BTreeSet;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether standard output cannot be written.
static IS_LOST: AtomicBool = AtomicBool::new(false);

#[used]
#[expect(unsafe_code, reason = "nothing else is called before the runtime of Rust begins")]
// SAFETY: the section holds addresses of functions of the C ABI. Each is called once, in the only thread. This function
// needs nothing of the runtime.
#[unsafe(link_section = ".init_array")]
static BEGIN: extern "C" fn() = begin;

extern "C" fn begin() {
    look();
    take_signals_back();
}

#[expect(unsafe_code, reason = "the number may be that of no open descriptor, so it cannot be borrowed")]
fn look() {
    // SAFETY: the call takes two numbers and touches no memory. For a descriptor that is not open, it returns -1.
    let flags = unsafe { libc::fcntl(libc::STDOUT_FILENO, libc::F_GETFL) };
    let is_lost = flags == -1 || flags & libc::O_ACCMODE == libc::O_RDONLY;
    IS_LOST.store(is_lost, Ordering::Relaxed);
}

#[expect(unsafe_code, reason = "there is no safe call that sets the mask of signals of a process")]
fn take_signals_back() {
    // SAFETY: `sigemptyset` initialises `none` before it is used, and only this function has it. Only one thread runs,
    // and no handler is set yet.
    unsafe {
        let mut none: libc::sigset_t = std::mem::zeroed();
        libc::sigemptyset(&raw mut none);
        libc::sigprocmask(libc::SIG_SETMASK, &raw const none, std::ptr::null_mut());
        libc::signal(libc::SIGCHLD, libc::SIG_DFL);
    }
}

/// Checks that standard output was open for writing when this process began.
///
/// # Errors
/// Standard output was closed, or open only for reading.
pub(super) fn check() -> io::Result<()> {
    if IS_LOST.load(Ordering::Relaxed) {
        return Err(io::Error::other("it is closed, or open for reading alone"));
    }
    Ok(())
}

/// The separators between the names in an argument: `DEPLOYMENT:INSTANCE`, `KEY=VALUE`. In a text without colours, a
/// part that begins with an escape may have been left out.
const BETWEEN: [char; 7] = [':', '/', '=', '.', ',', ' ', '\x1b'];

/// Returns a text in which the arguments of this process, and the names in them, are safe for a terminal.
pub(super) fn written_out(text: &str) -> String {
    let arguments = std::env::args_os().skip(1).map(|argument| argument.to_string_lossy().into_owned());
    of_arguments(text, arguments)
}

fn of_arguments(text: &str, arguments: impl Iterator<Item = String>) -> String {
    let mut given = BTreeSet::new();
    for argument in arguments.filter(|argument| *argument != one_line(argument)) {
        given.extend(argument.split(BETWEEN).map(str::to_owned));
        given.insert(argument);
    }
    let mut given: Vec<String> = given.into_iter().filter(|name| *name != one_line(name)).collect();
    // A whole argument is replaced before its parts.
    given.sort_by_key(|name| std::cmp::Reverse(name.len()));
    given.iter().fold(text.to_owned(), |text, name| text.replace(name.as_str(), &one_line(name)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_were_given_are_on_one_line() {
        let check = |text: &str, arguments: &[&str], expected: &str| {
            assert_eq!(of_arguments(text, arguments.iter().map(|one| (*one).to_owned())), expected);
        };
        check("two\nlines of `plain`", &["stop", "plain"], "two\nlines of `plain`");
        check("no `a\nb` runs\nsee `c`", &["stop", "a\nb"], "no `a\\nb` runs\nsee `c`");
        check("no `a\nb` in `d`", &["get", "d:a\nb"], "no `a\\nb` in `d`");
        check("`d\r:a\nb` and `a\nb`", &["get", "d\r:a\nb"], "`d\\x0d:a\\nb` and `a\\nb`");
        check("`\x1b[31m`", &["\x1b[31m"], "`\\x1b[31m`");
        check("no `a\nb`", &["a\nb\x1b[31m"], "no `a\\nb`");
    }
}
