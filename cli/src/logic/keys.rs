//! The keys that a person presses at a terminal, from the bytes that the terminal sends.
//!
//! Source: ECMA-48 for control sequences; ctlseqs of xterm, "PC-Style Function Keys".

/// A key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Key {
    Char(char),
    Enter,
    Escape,
    Backspace,
    Tab,
    BackTab,
    Up,
    Down,
    Left,
    Right,
    PageUp,
    PageDown,
    Home,
    End,
    /// A function key, from 1 on.
    Function(u8),
    /// Ctrl with a letter, in lower case.
    Control(char),
}

/// Returns the keys in a piece of input. Leaves out unknown sequences.
pub(crate) fn keys(bytes: &[u8]) -> Vec<Key> {
    let (mut keys, mut rest) = (Vec::new(), bytes);
    while let Some(first) = rest.first() {
        let (key, length) = match first {
            0x1b => escaped(rest),
            b'\r' | b'\n' => (Some(Key::Enter), 1),
            b'\t' => (Some(Key::Tab), 1),
            0x7f | 0x08 => (Some(Key::Backspace), 1),
            control @ 1..=26 => (Some(Key::Control(char::from(control - 1 + b'a'))), 1),
            0..=31 => (None, 1),
            _ => character(rest),
        };
        keys.extend(key);
        rest = &rest[length.min(rest.len())..];
    }
    keys
}

/// Reads a character in UTF-8.
fn character(bytes: &[u8]) -> (Option<Key>, usize) {
    let length = match bytes[0] {
        0xC0..0xE0 => 2,
        0xE0..0xF0 => 3,
        0xF0.. => 4,
        _ => 1,
    };
    let text = bytes.get(..length).and_then(|bytes| std::str::from_utf8(bytes).ok());
    match text.and_then(|text| text.chars().next()).filter(|character| !character.is_control()) {
        Some(character) => (Some(Key::Char(character)), length),
        None => (None, 1),
    }
}

/// Reads a sequence that begins with an escape character.
fn escaped(bytes: &[u8]) -> (Option<Key>, usize) {
    match bytes.get(1) {
        Some(b'[') => {
            let end = bytes.iter().skip(2).position(|byte| (0x40..=0x7e).contains(byte));
            // If the sequence has no end, it contains all bytes that have arrived.
            let Some(end) = end.map(|end| end + 2) else { return (None, bytes.len()) };
            // The Linux console sends `[[A` to `[[E` for F1 to F5.
            if bytes.get(2) == Some(&b'[') {
                let number = bytes.get(3).and_then(|byte| byte.checked_sub(b'A')).filter(|number| *number < 5);
                return (number.map(|number| Key::Function(number + 1)), 4);
            }
            (sequence(&bytes[2..end], bytes[end]), end + 1)
        }
        Some(b'O') => (bytes.get(2).and_then(|last| sequence(b"", *last)), 3),
        // This is a key that was pressed together with Alt, or the escape key followed by another key.
        Some(_) | None => (Some(Key::Escape), 1),
    }
}

/// Returns the key of a control sequence, given its parameters and its last byte.
fn sequence(parameters: &[u8], last: u8) -> Option<Key> {
    let number = parameters.split(|byte| *byte == b';').next().and_then(|number| std::str::from_utf8(number).ok());
    Some(match (last, number.and_then(|number| number.parse::<u8>().ok())) {
        (b'A', _) => Key::Up,
        (b'B', _) => Key::Down,
        (b'C', _) => Key::Right,
        (b'D', _) => Key::Left,
        (b'H', _) | (b'~', Some(1 | 7)) => Key::Home,
        (b'F', _) | (b'~', Some(4 | 8)) => Key::End,
        (b'Z', _) => Key::BackTab,
        (b'P'..=b'S', _) => Key::Function(last - b'P' + 1),
        (b'~', Some(5)) => Key::PageUp,
        (b'~', Some(6)) => Key::PageDown,
        (b'~', Some(number @ 11..=15)) => Key::Function(number - 10),
        (b'~', Some(number @ 17..=21)) => Key::Function(number - 11),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_of_a_terminal_are_keys() {
        let check = |bytes: &[u8], expected: &[Key]| assert_eq!(keys(bytes), expected, "{}", bytes.escape_ascii());
        check(b"q?", &[Key::Char('q'), Key::Char('?')]);
        check("é√".as_bytes(), &[Key::Char('é'), Key::Char('√')]);
        check(b"\r\t\x7f\x03", &[Key::Enter, Key::Tab, Key::Backspace, Key::Control('c')]);
        check(b"\x1b[A\x1bOB\x1b[1;5C\x1b[D", &[Key::Up, Key::Down, Key::Right, Key::Left]);
        check(b"\x1b[5~\x1b[6~\x1b[H\x1b[4~\x1b[Z", &[Key::PageUp, Key::PageDown, Key::Home, Key::End, Key::BackTab]);
        check(b"\x1bOP\x1b[21~\x1b[[A", &[Key::Function(1), Key::Function(10), Key::Function(1)]);
        check(b"\x1b", &[Key::Escape]);
        check(b"\x1bx", &[Key::Escape, Key::Char('x')]);
        // These are an answer of the terminal, a part of a sequence, and bytes without a meaning.
        check(b"\x1b[?1;2c", &[]);
        check(b"\x1b[1;", &[]);
        check(b"\xff\xc3a", &[Key::Char('a')]);
        check(b"", &[]);
    }

    #[test]
    fn any_bytes_have_an_end() {
        for first in 0..=255_u8 {
            for second in 0..=255_u8 {
                assert!(keys(&[0x1b, first, second, b'~']).len() <= 4);
            }
        }
    }
}
