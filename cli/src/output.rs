//! The output of a command that has a live line. The live line is removed before other output. Commands without a live
//! line use `node::console`.

use crate::logic::mission::{Line, Style};
use node::console;
use std::fmt;
use std::io::{self, IsTerminal, Write};

/// The rows and columns that a terminal counts as having if it does not report its size.
pub const SCREEN_DEFAULT: (usize, usize) = (24, 80);

/// Returns whether text on standard error may be coloured.
pub fn is_coloured() -> bool {
    has_colours(&io::stderr())
}

/// Returns whether text on a stream may be coloured. Sources: <https://no-color.org>; `dumb` in terminfo(5).
pub(crate) fn has_colours(stream: &impl IsTerminal) -> bool {
    let is_unwanted = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    stream.is_terminal() && !is_unwanted && !is_dumb()
}

fn is_dumb() -> bool {
    std::env::var_os("TERM").is_some_and(|terminal| terminal == "dumb")
}

/// Returns standard output, for a check whether it has a reader.
pub(crate) fn results() -> io::Stdout {
    io::stdout()
}

fn columns(stream: impl std::os::fd::AsFd) -> usize {
    let columns = rustix::termios::tcgetwinsize(stream).map_or(0, |size| usize::from(size.ws_col));
    if columns == 0 { SCREEN_DEFAULT.1 } else { columns }
}

/// Returns the rows and columns of the terminal for results, if it can redraw a line.
pub fn screen() -> Option<(usize, usize)> {
    if !io::stdout().is_terminal() || is_dumb() {
        return None;
    }
    let rows = rustix::termios::tcgetwinsize(io::stdout()).map_or(0, |size| usize::from(size.ws_row));
    Some((if rows == 0 { SCREEN_DEFAULT.0 } else { rows }, columns(io::stdout())))
}

/// Both streams of a command, and whether standard error has a live line.
pub struct Output {
    results: Box<dyn Write + Send>,
    notes: Box<dyn Write + Send>,
    terminal: bool,
    live: bool,
}

impl fmt::Debug for Output {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Output").field("terminal", &self.terminal).field("live", &self.live).finish_non_exhaustive()
    }
}

impl Output {
    /// Returns the streams of this process.
    pub fn standard() -> Self {
        // No other property shows that a terminal cannot redraw a line.
        let terminal = io::stderr().is_terminal() && !is_dumb();
        Self { results: Box::new(console::results()), notes: Box::new(io::stderr()), terminal, live: false }
    }

    /// Returns the present style of lines for a person.
    pub fn style(&self) -> Style {
        if !self.terminal {
            return Style::Plain;
        }
        Style::Terminal(columns(io::stderr()))
    }

    /// Returns how wide a result may be; nothing if it does not go to a terminal.
    pub fn columns(&self) -> Option<usize> {
        io::stdout().is_terminal().then(|| columns(io::stdout()))
    }

    /// Writes a result. Adds a line feed if it ends without one.
    ///
    /// # Errors
    /// Standard output has no reader any more. Then the command has no reason to continue.
    pub fn result(&mut self, text: &str) -> io::Result<()> {
        self.clear();
        console::write_result(&mut self.results, text)
    }

    /// Writes the output of a program unchanged.
    ///
    /// # Errors
    /// The same as for [`Output::result`].
    pub fn raw(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.clear();
        self.results.write_all(bytes)?;
        self.results.flush()
    }

    /// Writes a line for a person, such as an error, a warning or a completed step.
    pub fn note(&mut self, text: &str) {
        self.clear();
        self.write(&format!("{}\n", console::written_out(text).trim_end_matches('\n')));
    }

    /// Writes a question, and leaves the cursor after it.
    pub(crate) fn prompt(&mut self, question: &str) {
        self.clear();
        self.write(question);
    }

    /// Writes a line of a [`crate::logic::mission::Progress`]. On a terminal, a live line replaces the previous live line.
    pub fn line(&mut self, line: &Line) {
        match line {
            Line::Live(text) if self.terminal => {
                // The line flickers less if the rest of the line is erased after the text is written.
                self.write(&format!("\r{text}\x1b[K"));
                self.live = true;
            }
            Line::Live(text) | Line::Kept(text) => self.note(text),
        }
    }

    /// Removes the live line.
    pub fn clear(&mut self) {
        if self.live {
            self.write("\r\x1b[K");
            self.live = false;
        }
    }

    fn write(&mut self, text: &str) {
        // If standard error is lost, this cannot be reported anywhere.
        let written = self.notes.write_all(text.as_bytes()).and_then(|()| self.notes.flush());
        drop(written);
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use std::sync::{Arc, Mutex};

    #[derive(Clone, Default)]
    pub(crate) struct Stream(Arc<Mutex<Vec<u8>>>);

    impl Stream {
        pub(crate) fn text(&self) -> String {
            String::from_utf8(self.0.lock().unwrap().clone()).unwrap()
        }
    }

    impl Write for Stream {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap().write(bytes)
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// Returns an output with its two streams: for results and for notes.
    pub(crate) fn output(terminal: bool) -> (Output, Stream, Stream) {
        let (results, notes) = (Stream::default(), Stream::default());
        let output =
            Output { results: Box::new(results.clone()), notes: Box::new(notes.clone()), terminal, live: false };
        (output, results, notes)
    }

    #[test]
    fn a_live_line_is_taken_away_before_anything_else() {
        let (mut output, results, notes) = output(true);
        output.line(&Line::Live("1 s".to_owned()));
        output.line(&Line::Live("2 s".to_owned()));
        output.line(&Line::Kept("over".to_owned()));
        output.line(&Line::Live("3 s".to_owned()));
        output.result("42").unwrap();
        assert_eq!(notes.text(), "\r1 s\x1b[K\r2 s\x1b[K\r\x1b[Kover\n\r3 s\x1b[K\r\x1b[K");
        assert_eq!(results.text(), "42\n");
    }

    #[test]
    fn a_file_gets_plain_lines() {
        let (mut output, results, notes) = output(false);
        output.line(&Line::Live("1 s".to_owned()));
        output.line(&Line::Kept("over".to_owned()));
        output.raw(b"x").unwrap();
        assert_eq!((notes.text().as_str(), results.text().as_str()), ("1 s\nover\n", "x"));
        assert_eq!(output.style(), Style::Plain);
    }
}
