//! The output of a program as lines for a person.

/// How many lines of output are told at most with a program's failure.
pub const LAST_LINES_MAX: usize = 20;
/// The length of the longest of these lines, in characters.
const LAST_LINE_MAX: usize = 400;

/// The line for output that was rotated away before it was read.
pub const GAP: &str = "[dca: output may be missing here; it was rotated away before it was read]";

/// Returns the last lines of a program's output in a form for a person. Blank lines at the end are removed, and control
/// characters are replaced. If `output` `is_cut`, its first line may be incomplete, and is left out.
pub fn last_lines(output: &[u8], is_cut: bool) -> Vec<String> {
    let text = String::from_utf8_lossy(output);
    let whole = if is_cut { text.split_once('\n').map_or("", |(_, whole)| whole) } else { &text };
    let mut lines: Vec<&str> = whole.trim_end().lines().rev().take(LAST_LINES_MAX).collect();
    lines.reverse();
    lines.into_iter().map(|line| plain(line).chars().take(LAST_LINE_MAX).collect()).collect()
}

/// Returns a line of a program's output as a terminal would show it, without control sequences.
pub fn plain(line: &str) -> String {
    // A progress bar overwrites itself. Only its last state is visible.
    let line = line.trim_end_matches('\r');
    let line = line.rsplit('\r').next().unwrap_or(line);
    let (mut text, mut chars) = (String::with_capacity(line.len()), line.chars().peekable());
    while let Some(c) = chars.next() {
        match c {
            '\t' => text.push_str("    "),
            // ESC [ parameters letter: a colour or a movement. Source: ECMA-48, 5.4.
            '\x1b' if chars.next_if_eq(&'[').is_some() => {
                while chars.next().is_some_and(|c| !('@'..='~').contains(&c)) {}
            }
            c if c.is_control() => text.push('\u{fffd}'),
            c => text.push(c),
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_lines_are_those_that_a_person_would_see() {
        let many: String = (1..=30).map(|line| format!("line {line}\n")).collect();
        let lines = last_lines(many.as_bytes(), false);
        assert_eq!((lines.len(), lines[0].as_str(), lines[19].as_str()), (LAST_LINES_MAX, "line 11", "line 30"));
        let check = |output: &[u8], is_cut, expect: &[&str]| assert_eq!(last_lines(output, is_cut), expect);
        check(b"", false, &[]);
        check(b"\n \n", false, &[]);
        check(b"half\nTraceback:\n\n  x\r\nValueError\n\n", true, &["Traceback:", "", "  x", "ValueError"]);
        check(
            b"10 %\r20 %\rdone\n\x1b[1;31mred\x1b[0m\tx\x07\x9b\xff",
            false,
            &["done", "red    x\u{fffd}\u{fffd}\u{fffd}"],
        );
        check("é".repeat(500).as_bytes(), false, &["é".repeat(400).as_str()]);
    }
}
