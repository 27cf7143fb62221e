//! Makes the output of programs safe for a terminal. Afterwards, nothing in it moves the cursor, changes colours or hides other text.

/// Makes the pieces of a byte stream printable. A piece may end inside a character.
#[derive(Debug, Default)]
pub struct Printable {
    /// The first bytes of a character, or a carriage return, whose continuation may be in the next piece.
    rest: Vec<u8>,
}

impl Printable {
    /// Returns the printable form of a piece. An end that depends on the next piece is kept back.
    pub fn push(&mut self, bytes: &[u8]) -> String {
        self.rest.extend_from_slice(bytes);
        let bytes = std::mem::take(&mut self.rest);
        let whole = bytes.len() - unfinished(&bytes);
        self.rest = bytes[whole..].to_vec();
        printable(&String::from_utf8_lossy(&bytes[..whole]))
    }

    /// Returns the rest that was kept back.
    pub fn finish(&mut self) -> String {
        printable(&String::from_utf8_lossy(&std::mem::take(&mut self.rest)))
    }
}

/// Returns a text in which control characters and changes of direction are written as text, such as `\x1b`. Line ends and tabs stay.
pub fn printable(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    let mut characters = text.chars().peekable();
    while let Some(character) = characters.next() {
        match character {
            '\n' | '\t' => shown.push(character),
            '\r' if characters.peek() == Some(&'\n') => {}
            '\0'..='\x7f' if character.is_control() => shown.push_str(&format!("\\x{:02x}", u32::from(character))),
            _ if character.is_control() || is_direction(character) => {
                shown.push_str(&format!("\\u{{{:x}}}", u32::from(character)));
            }
            _ => shown.push(character),
        }
    }
    shown
}

/// Returns a text on one line. It is treated as in [`printable`], and line ends and tabs are also written as text.
pub fn one_line(text: &str) -> String {
    printable(&text.replace('\n', "\\n").replace('\t', "\\t"))
}

/// Returns whether a character changes the direction of the text around it. Source: Unicode Standard Annex 9, table 3-4.
fn is_direction(character: char) -> bool {
    matches!(character, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{200e}' | '\u{200f}' | '\u{61c}')
}

/// Returns how many bytes at the end need the next piece.
fn unfinished(bytes: &[u8]) -> usize {
    if bytes.last() == Some(&b'\r') {
        return 1;
    }
    // The longest character has four bytes. So an incomplete one has at most three.
    let lead = (1..=bytes.len().min(3)).find(|back| bytes[bytes.len() - back] & 0xc0 != 0x80);
    lead.filter(|back| {
        std::str::from_utf8(&bytes[bytes.len() - back..]).is_err_and(|error| error.error_len().is_none())
    })
    .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_of_it_commands_a_terminal() {
        let check = |text: &str, shown: &str| assert_eq!(printable(text), shown);
        check("plain ß😀\tx\r\ny\n", "plain ß😀\tx\ny\n");
        check("\x1b]0;owned\x07\x1b[2J", "\\x1b]0;owned\\x07\\x1b[2J");
        check("100 %\rdone", "100 %\\x0ddone");
        check("\u{9b}31m\u{7f}", "\\u{9b}31m\\x7f");
        check("a\u{202e}b", "a\\u{202e}b");
    }

    #[test]
    fn a_name_is_on_one_line() {
        assert_eq!(one_line("a\nb\r\n\tc\x1b"), "a\\nb\\x0d\\n\\tc\\x1b");
        assert_eq!(one_line("plain ß"), "plain ß");
    }

    #[test]
    fn pieces_are_what_the_whole_is() {
        let text = "ß😀\r\n\x1b[0m€\r x\u{85}".as_bytes();
        let whole = printable(&String::from_utf8_lossy(text));
        for size in 1..=text.len() {
            let mut state = Printable::default();
            let mut shown: String = text.chunks(size).map(|piece| state.push(piece)).collect();
            shown += &state.finish();
            assert_eq!(shown, whole, "pieces of {size}");
        }
        let mut state = Printable::default();
        assert_eq!(state.push(b"a\xff\xe2\x82b\xf0"), "a\u{fffd}\u{fffd}b");
        assert_eq!(state.finish(), "\u{fffd}");
    }
}
