//! A command on a terminal with a person's input. It shows the content of the screen, and whether the terminal is
//! restored at the end.

use super::SOON;
use super::terminal::{self, ROWS, Terminal};
use comms::io::clock::now;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::OwnedFd;
use rustix::process::{Pid, Signal, kill_process};
use rustix::termios::tcgetattr;
use std::fmt::Write as _;
use std::process::{Child, Command};
use std::time::Duration;

/// The end of a command at a terminal.
#[derive(Debug)]
pub struct Left {
    /// The exit code.
    pub code: Option<i32>,
    /// All text that the command wrote.
    pub written: String,
    /// Whether the terminal reads lines and shows keys as before the command.
    pub is_restored: bool,
}

/// A command at a terminal.
#[derive(Debug)]
pub struct TypedTerminal {
    screen: OwnedFd,
    line: OwnedFd,
    child: Child,
    written: Vec<u8>,
    settings: String,
}

impl TypedTerminal {
    pub(super) fn start(mut command: Command, columns: u16) -> Self {
        let Terminal { screen, line } = terminal::open(columns);
        let settings = settings(&line);
        let end = || line.try_clone().expect("a descriptor is left");
        command.stdin(end()).stdout(end()).stderr(end());
        let child = command.spawn().expect("it can be started");
        Self { screen, line, child, written: Vec::new(), settings }
    }

    /// Waits until the screen shows a text, and returns the screen.
    ///
    /// # Panics
    /// Panics if the text does not appear within `SOON`, or if the command ends before.
    #[track_caller]
    pub fn wait_for(&mut self, wanted: &str) -> String {
        let deadline = now() + SOON;
        loop {
            let shown = self.shown();
            if shown.contains(wanted) {
                return shown;
            }
            let left = deadline.since(now());
            assert!(!left.is_zero() && self.read(left), "the screen does not show `{wanted}`:\n{shown}");
        }
    }

    /// Types some keys.
    ///
    /// # Panics
    /// Panics if the terminal is gone.
    pub fn press(&self, keys: &str) {
        let written = rustix::io::write(&self.screen, keys.as_bytes()).expect("the terminal is there");
        assert_eq!(written, keys.len());
    }

    /// Sends a signal to the command.
    ///
    /// # Panics
    /// Panics if the command has already been waited for.
    pub fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).expect("it has not been waited for");
    }

    /// Waits for the end of the command.
    ///
    /// # Panics
    /// Panics if the command does not end within `SOON`.
    #[track_caller]
    pub fn left(mut self) -> Left {
        let deadline = now() + SOON;
        let status = loop {
            if let Some(status) = self.child.try_wait().expect("it was started here") {
                break status;
            }
            let left = deadline.since(now());
            if left.is_zero() {
                drop(self.child.kill());
                panic!("it has not ended:\n{}", self.shown());
            }
            self.read(left.min(Duration::from_millis(50)));
        };
        while self.read(Duration::ZERO) {}
        let is_restored = settings(&self.line) == self.settings;
        Left { code: status.code(), written: String::from_utf8_lossy(&self.written).into_owned(), is_restored }
    }

    /// Reads new output, and returns whether it found some.
    fn read(&mut self, within: Duration) -> bool {
        let within = Timespec::try_from(within).expect("half a minute is a time");
        let ready = poll(&mut [PollFd::new(&self.screen, PollFlags::IN)], Some(&within));
        let mut chunk = [0; 4096];
        match ready.map(|ready| ready > 0) {
            Ok(true) => match rustix::io::read(&self.screen, &mut chunk) {
                Ok(size) if size > 0 => {
                    self.written.extend(&chunk[..size]);
                    true
                }
                _ => false,
            },
            _ => false,
        }
    }

    /// Returns the lines of the screen.
    fn shown(&self) -> String {
        screen(&String::from_utf8_lossy(&self.written))
    }
}

/// Returns the settings by which a terminal reads and shows keys.
fn settings(line: &OwnedFd) -> String {
    let settings = tcgetattr(line).expect("it is a terminal");
    let mut text = String::new();
    write!(text, "{:?} {:?} {:?}", settings.input_modes, settings.output_modes, settings.local_modes)
        .expect("a text grows");
    text
}

/// Returns the final screen after a text. It handles texts at positions and cleared screens, and leaves out colours.
fn screen(written: &str) -> String {
    let (mut cells, mut row, mut column) = (vec![Vec::<char>::new(); usize::from(ROWS)], 0, 0);
    let mut characters = written.chars().peekable();
    while let Some(character) = characters.next() {
        match character {
            '\x1b' if characters.peek() == Some(&'[') => {
                characters.next();
                let mut parameters = String::new();
                let mut last = ' ';
                for character in characters.by_ref() {
                    if ('@'..='~').contains(&character) {
                        last = character;
                        break;
                    }
                    parameters.push(character);
                }
                let mut numbers = parameters.split(';').map(|number| number.parse::<usize>().unwrap_or(1));
                match last {
                    'H' => (row, column) = (numbers.next().unwrap_or(1) - 1, numbers.next().unwrap_or(1) - 1),
                    'J' => cells.iter_mut().for_each(Vec::clear),
                    _ => {}
                }
            }
            '\n' => row += 1,
            '\r' => column = 0,
            _ => {
                if let Some(line) = cells.get_mut(row) {
                    line.resize(line.len().max(column + 1), ' ');
                    line[column] = character;
                }
                column += 1;
            }
        }
    }
    cells.into_iter().map(|line| line.into_iter().collect::<String>().trim_end().to_owned() + "\n").collect()
}

#[test]
fn a_screen_has_the_last_text_at_each_place() {
    let shown = screen("\x1b[2J\x1b[2;3Habc\x1b[0;1md\x1b[2;4HX\x1b[1;1Htop");
    assert_eq!(shown.lines().take(2).collect::<Vec<_>>(), ["top", "  aXcd"]);
}
