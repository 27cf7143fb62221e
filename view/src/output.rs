//! The output of programs, as lines.

use crate::identity::MissionId;
use crate::text::{TEXT_MAX, clean};
use std::collections::BTreeMap;

/// How many programs may have a line that has not ended.
const BEGUN_MAX: usize = 64;
/// The longest line, in bytes; a longer one becomes several.
const LINE_MAX: usize = TEXT_MAX;

/// A line that a program has written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OutputLine {
    /// Its place among all lines, from 0 on, those that have left included.
    pub ordinal: u64,
    /// The deployment of the program.
    pub mission: MissionId,
    /// The absolute path of its process.
    pub path: String,
    /// The line, without control characters.
    pub text: String,
}

/// Puts lines together from the pieces of each program.
#[derive(Clone, Debug, Default)]
pub struct Lines {
    begun: BTreeMap<(MissionId, String), Vec<u8>>,
}

impl Lines {
    /// Takes a piece in; returns the lines that it completes. They have no control characters, and a limited length.
    pub fn push(&mut self, mission: &MissionId, path: &str, bytes: &[u8]) -> Vec<String> {
        let key = (mission.clone(), path.to_owned());
        if !self.begun.contains_key(&key) && self.begun.len() >= BEGUN_MAX {
            self.begun.pop_first();
        }
        let begun = self.begun.entry(key).or_default();
        let mut lines = Vec::new();
        let mut line = |bytes: &[u8]| {
            let text = String::from_utf8_lossy(bytes);
            lines.push(clean(text.strip_suffix('\r').unwrap_or(&text)));
        };
        let mut pieces = bytes.split(|byte| *byte == b'\n').peekable();
        while let Some(piece) = pieces.next() {
            begun.extend(piece);
            while begun.len() > LINE_MAX {
                let end = whole_characters(begun, LINE_MAX);
                line(&begun[..end]);
                begun.drain(..end);
            }
            if pieces.peek().is_some() {
                line(begun);
                begun.clear();
            }
        }
        lines
    }

    /// Drops the line of a program that has not ended.
    pub fn forget(&mut self, mission: &MissionId, path: &str) {
        self.begun.remove(&(mission.clone(), path.to_owned()));
    }
}

/// Returns the end of the last whole character within the first `limit` bytes.
fn whole_characters(bytes: &[u8], limit: usize) -> usize {
    let is_begin = |at: &usize| bytes.get(*at).is_none_or(|byte| byte & 0xC0 != 0x80);
    (limit.saturating_sub(3)..=limit).rev().find(is_begin).unwrap_or(limit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identity::Fleet;
    use node::logic::protocol::Deployment;

    fn door() -> MissionId {
        let deployment = Deployment { name: "door".into(), epoch: 1 };
        MissionId { deployment, home: "r1".into(), fleet: Fleet::Standing }
    }

    #[test]
    fn pieces_become_lines_of_one_program_each() {
        let door = door();
        let mut lines = Lines::default();
        assert_eq!(lines.push(&door, "main/a", b"one\r\ntw"), ["one"]);
        assert_eq!(lines.push(&door, "main/b", b"other\n"), ["other"]);
        assert_eq!(lines.push(&door, "main/a", b"o\x1b[2J\n\n"), ["two\\x1b[2J", ""]);
    }

    #[test]
    fn a_line_without_an_end_has_a_limit() {
        let door = door();
        let mut lines = Lines::default();
        let shown = lines.push(&door, "main/a", "é".repeat(1000).as_bytes());
        assert!(shown.iter().all(|line| line.chars().all(|c| c == 'é')), "{shown:?}");
        assert_eq!(shown.len(), 4);
        (0..1000).for_each(|number| drop(lines.push(&door, &format!("main/{number}"), b"x")));
        assert_eq!(lines.begun.len(), BEGUN_MAX);
    }
}
