//! A terminal that a view draws on. Its previous state is restored at every end, including a panic.

use crate::logic::keys::{Key, keys};
use crate::output;
use anyhow::Context as _;
use ratatui_core::backend::{Backend, ClearType, WindowSize};
use ratatui_core::buffer::Cell;
use ratatui_core::layout::{Position, Size};
use ratatui_core::style::{Color, Modifier};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::termios::{OptionalActions, Termios, tcgetattr, tcsetattr};
use std::fmt::Write as _;
use std::io::{self, Write};
use std::sync::{Mutex, PoisonError};
use tokio::sync::mpsc::{self, Receiver, Sender};

/// The longest wait for a key, in nanoseconds. [`Keys::rest`] also waits at most this long.
const KEY_WITHIN: i64 = 100_000_000;
/// Switch to the other screen and hide the cursor; and the reverse. Source: ctlseqs of xterm, DECSET 1049 and DECTCEM.
const ENTER: &str = "\x1b[?1049h\x1b[?25l\x1b[2J";
const LEAVE: &str = "\x1b[0m\x1b[?25h\x1b[?1049l";

/// The original settings of the terminal, while a view uses it.
static BEFORE: Mutex<Option<Termios>> = Mutex::new(None);

/// The terminal while a view uses it. Dropping this restores the terminal.
#[derive(Debug)]
pub(crate) struct Taken(());

/// Returns whether standard input and output are a terminal that can be drawn on.
pub(crate) fn is_there() -> bool {
    output::screen().is_some() && tcgetattr(io::stdin()).is_ok()
}

impl Taken {
    /// Takes over the terminal. Each key is read at once, and is not shown.
    ///
    /// # Errors
    /// Standard input or output is not a terminal.
    pub(crate) fn take() -> anyhow::Result<Self> {
        let before = tcgetattr(io::stdin()).context("reading the settings of the terminal")?;
        let mut raw = before.clone();
        raw.make_raw();
        *BEFORE.lock().unwrap_or_else(PoisonError::into_inner) = Some(before);
        let taken = Self(());
        tcsetattr(io::stdin(), OptionalActions::Flush, &raw).context("changing the settings of the terminal")?;
        write(ENTER).context("writing to the terminal")?;
        Ok(taken)
    }

    /// Lets a panic restore the terminal before the panic is reported.
    pub(crate) fn give_back_on_panic() {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            give_back();
            before(panic);
        }));
    }
}

impl Drop for Taken {
    fn drop(&mut self) {
        give_back();
    }
}

/// Restores the terminal, if a view uses it.
fn give_back() {
    let before = BEFORE.lock().unwrap_or_else(PoisonError::into_inner).take();
    if let Some(before) = before {
        // If the terminal does not exist any more, nothing has to be restored.
        drop(write(LEAVE));
        tcsetattr(io::stdin(), OptionalActions::Flush, &before).unwrap_or_default();
    }
}

fn write(text: &str) -> io::Result<()> {
    let mut out = output::results();
    out.write_all(text.as_bytes())?;
    out.flush()
}

/// Reads keys, but only on request. Between two requests, another part of the command may read the terminal.
#[derive(Debug)]
pub(crate) struct Keys {
    requests: Sender<()>,
    pressed: Receiver<io::Result<Vec<Key>>>,
    is_waiting: bool,
}

impl Keys {
    /// Starts the reader.
    ///
    /// # Errors
    /// The system cannot start another thread.
    pub(crate) fn new() -> io::Result<Self> {
        let (requests, mut asked) = mpsc::channel(1);
        let (sink, pressed) = mpsc::channel(1);
        // The thread ends with the process, or when the sender of requests is dropped.
        std::thread::Builder::new().name("dca-keys".to_owned()).spawn(move || {
            while asked.blocking_recv().is_some() {
                if sink.blocking_send(read_keys()).is_err() {
                    return;
                }
            }
        })?;
        Ok(Self { requests, pressed, is_waiting: false })
    }

    /// Returns the next keys. Returns no keys if no key was pressed for a short time.
    ///
    /// # Errors
    /// The terminal does not exist any more.
    ///
    /// # Cancellation
    /// Safe.
    pub(crate) async fn next(&mut self) -> io::Result<Vec<Key>> {
        if !self.is_waiting {
            self.is_waiting = self.requests.try_send(()).is_ok();
        }
        let pressed = self.pressed.recv().await;
        self.is_waiting = false;
        pressed.unwrap_or_else(|| Err(io::ErrorKind::BrokenPipe.into()))
    }

    /// Waits until the thread does not read the terminal.
    pub(crate) async fn rest(&mut self) {
        if self.is_waiting {
            drop(self.next().await);
        }
    }
}

fn read_keys() -> io::Result<Vec<Key>> {
    let within = Timespec { tv_sec: 0, tv_nsec: KEY_WITHIN };
    let stdin = io::stdin();
    let ready = poll(&mut [PollFd::new(&stdin, PollFlags::IN)], Some(&within));
    match ready {
        Ok(0) | Err(rustix::io::Errno::INTR) => return Ok(Vec::new()),
        Ok(_) => {}
        Err(error) => return Err(error.into()),
    }
    let mut bytes = [0; 256];
    match rustix::io::read(&stdin, &mut bytes) {
        Ok(0) => Err(io::ErrorKind::UnexpectedEof.into()),
        Ok(count) => Ok(keys(&bytes[..count])),
        Err(rustix::io::Errno::INTR | rustix::io::Errno::AGAIN) => Ok(Vec::new()),
        Err(error) => Err(error.into()),
    }
}

/// Writes the cells of a view to the terminal.
#[derive(Debug, Default)]
pub(crate) struct Drawer {
    pending: String,
}

impl Backend for Drawer {
    type Error = io::Error;

    fn draw<'a, I: Iterator<Item = (u16, u16, &'a Cell)>>(&mut self, content: I) -> io::Result<()> {
        let mut last: Option<(u16, u16)> = None;
        let mut style = None;
        for (x, y, cell) in content {
            if last != Some((x, y)) {
                write!(self.pending, "\x1b[{};{}H", y + 1, x + 1).unwrap_or_default();
            }
            let new = (cell.fg, cell.bg, cell.modifier);
            if style != Some(new) {
                self.pending.push_str(&sgr(cell));
                style = Some(new);
            }
            self.pending.push_str(cell.symbol());
            // Terminals disagree about the position of the cursor after a wide character.
            last = (cell.symbol().len() == 1).then_some((x + 1, y));
        }
        self.pending.push_str("\x1b[0m");
        Ok(())
    }

    fn hide_cursor(&mut self) -> io::Result<()> {
        self.pending.push_str("\x1b[?25l");
        Ok(())
    }

    fn show_cursor(&mut self) -> io::Result<()> {
        self.pending.push_str("\x1b[?25h");
        Ok(())
    }

    fn get_cursor_position(&mut self) -> io::Result<Position> {
        Ok(Position::ORIGIN)
    }

    fn set_cursor_position<P: Into<Position>>(&mut self, position: P) -> io::Result<()> {
        let Position { x, y } = position.into();
        write!(self.pending, "\x1b[{};{}H", y + 1, x + 1).unwrap_or_default();
        Ok(())
    }

    fn clear(&mut self) -> io::Result<()> {
        self.pending.push_str("\x1b[2J");
        Ok(())
    }

    fn clear_region(&mut self, _: ClearType) -> io::Result<()> {
        self.clear()
    }

    fn size(&self) -> io::Result<Size> {
        let (rows, columns) = output::screen().unwrap_or(output::SCREEN_DEFAULT);
        let bounded = |count: usize| u16::try_from(count).unwrap_or(u16::MAX);
        Ok(Size::new(bounded(columns), bounded(rows)))
    }

    fn window_size(&mut self) -> io::Result<WindowSize> {
        Ok(WindowSize { columns_rows: self.size()?, pixels: Size::new(0, 0) })
    }

    fn flush(&mut self) -> io::Result<()> {
        write(&std::mem::take(&mut self.pending))
    }
}

/// Returns the sequence that sets colours and modifiers. Source: ECMA-48, SGR.
fn sgr(cell: &Cell) -> String {
    let mut codes = vec!["0".to_owned()];
    let modifiers =
        [(Modifier::BOLD, "1"), (Modifier::DIM, "2"), (Modifier::UNDERLINED, "4"), (Modifier::REVERSED, "7")];
    codes
        .extend(modifiers.into_iter().filter(|(one, _)| cell.modifier.contains(*one)).map(|(_, code)| code.to_owned()));
    codes.extend(colour(cell.fg).map(|code| (30 + code).to_string()));
    codes.extend(colour(cell.bg).map(|code| (40 + code).to_string()));
    format!("\x1b[{}m", codes.join(";"))
}

/// Returns the number of one of the eight colours that every terminal has.
fn colour(colour: Color) -> Option<u8> {
    let colours =
        [Color::Black, Color::Red, Color::Green, Color::Yellow, Color::Blue, Color::Magenta, Color::Cyan, Color::White];
    let place = colours.iter().position(|one| *one == colour)?;
    u8::try_from(place).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::fs::{Mode, OFlags};
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    use std::process::Command;

    /// Panics while a view uses the terminal.
    #[test]
    #[ignore = "started by `a_panic_gives_the_terminal_back`, on a terminal"]
    fn panics_on_the_terminal() {
        Taken::give_back_on_panic();
        let taken = Taken::take().unwrap();
        assert!(!tcgetattr(io::stdin()).unwrap().local_modes.contains(rustix::termios::LocalModes::ICANON));
        // In a real view, `Taken` may be lost with its task, so it is not dropped.
        std::mem::forget(taken);
        panic!("the view is broken");
    }

    #[test]
    fn a_panic_gives_the_terminal_back() {
        let screen = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&screen).and_then(|()| unlockpt(&screen)).unwrap();
        let name = ptsname(&screen, Vec::new()).unwrap();
        let line = rustix::fs::open(name.as_c_str(), OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty());
        let line = line.unwrap();
        let modes = |line: &rustix::fd::OwnedFd| format!("{:?}", tcgetattr(line).unwrap().local_modes);
        let before = modes(&line);
        let end = || line.try_clone().unwrap();
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "io::screen::tests::panics_on_the_terminal", "--ignored", "--nocapture"]);
        let mut child = command.env("TERM", "xterm").stdin(end()).stdout(end()).stderr(end()).spawn().unwrap();
        let (mut written, mut chunk) = (Vec::new(), [0; 4096]);
        let gone = |written: &[u8]| String::from_utf8_lossy(written).contains("test result: FAILED");
        while !gone(&written) {
            let count = rustix::io::read(&screen, &mut chunk).unwrap();
            written.extend_from_slice(&chunk[..count]);
        }
        assert!(!child.wait().unwrap().success());
        let written = String::from_utf8_lossy(&written).into_owned();
        let (given_back, panic) = (written.find(LEAVE), written.find("the view is broken"));
        assert!(given_back.is_some() && given_back < panic, "{written}");
        assert_eq!(modes(&line), before);
    }
}
