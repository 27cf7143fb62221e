//! Splits the output of programs into whole lines.

use std::collections::BTreeMap;

/// The longest line, in bytes. A longer line is split.
const LINE_MAX: usize = 64 << 10;
/// The most output of one program that is kept, in bytes.
const OUTPUT_MAX: usize = 32 << 20;

/// Puts the lines of each program together from its pieces of output.
#[derive(Debug, Default)]
pub struct Lines {
    programs: BTreeMap<String, Program>,
}

#[derive(Debug, Default)]
struct Program {
    /// The line that has not ended yet.
    begun: Vec<u8>,
    size: usize,
}

impl Lines {
    /// Adds bytes. Returns the lines that they complete, joined, without the last line feed.
    pub fn push(&mut self, path: &str, bytes: &[u8]) -> Option<String> {
        let program = self.programs.entry(path.to_owned()).or_default();
        if program.size >= OUTPUT_MAX {
            return None;
        }
        program.size += bytes.len();
        program.begun.extend(bytes);
        if program.size >= OUTPUT_MAX {
            program.begun.extend(b"\n[dca: the rest is not recorded]\n");
        }
        let whole = match program.begun.iter().rposition(|byte| *byte == b'\n') {
            Some(end) => end + 1,
            None if program.begun.len() >= LINE_MAX => program.begun.len(),
            None => return None,
        };
        let rest = program.begun.split_off(whole);
        let lines = std::mem::replace(&mut program.begun, rest);
        Some(text(&lines))
    }

    /// Returns the lines that have no end yet, with their programs.
    pub fn end(self) -> impl Iterator<Item = (String, String)> {
        let begun = self.programs.into_iter().filter(|(_, program)| !program.begun.is_empty());
        begun.map(|(path, program)| (path, text(&program.begun)))
    }
}

fn text(lines: &[u8]) -> String {
    String::from_utf8_lossy(lines.strip_suffix(b"\n").unwrap_or(lines)).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_two_programs_are_put_together_from_pieces() {
        let mut lines = Lines::default();
        assert_eq!(lines.push("a", b"one\ntw"), Some("one".to_owned()));
        assert_eq!(lines.push("b", "é".as_bytes().split_at(1).0), None);
        assert_eq!(lines.push("a", b"o\n\nthree\n"), Some("two\n\nthree".to_owned()));
        assert_eq!(lines.push("b", "é!".as_bytes().split_at(1).1), None);
        assert_eq!(lines.push("a", b"last"), None);
        let rest: Vec<_> = lines.end().collect();
        assert_eq!(rest, [("a".to_owned(), "last".to_owned()), ("b".to_owned(), "é!".to_owned())]);
    }

    #[test]
    fn there_is_a_limit_to_a_line_and_to_a_program() {
        let mut lines = Lines::default();
        let long = vec![b'x'; LINE_MAX];
        assert_eq!(lines.push("a", &long).map(|line| line.len()), Some(LINE_MAX));
        let mut last = None;
        for _ in 1..OUTPUT_MAX / LINE_MAX {
            last = lines.push("a", &long);
        }
        assert!(last.unwrap().ends_with("xx\n[dca: the rest is not recorded]"));
        assert_eq!(lines.push("a", b"more\n"), None);
        assert_eq!(lines.push("b", b"more\n"), Some("more".to_owned()), "others go on");
    }
}
