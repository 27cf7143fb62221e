//! The text of a script, `where = script { … }`: one token from the opening brace to its closing brace.
//!
//! The text is in Rhai, so it has other strings and comments than a spec. Only the braces matter here.

use super::Token;
use crate::syntax::SyntaxKind;

/// The word before the brace.
const WORD: &str = "script";

/// Returns whether a `{` after these tokens begins a script: after `= script`, where no other brace can be. In
/// `when mode == script {`, the brace begins actions.
pub(super) fn begins(tokens: &[Token], text: &str) -> bool {
    let mut before = tokens.iter().rev().filter(|token| !token.kind.is_trivia());
    let (Some(word), Some(equals)) = (before.next(), before.next()) else { return false };
    let is_word = word.kind == SyntaxKind::Ident && &text[word.start as usize..word.end as usize] == WORD;
    let compares = || text[..equals.start as usize].ends_with(['=', '!', '<', '>']);
    is_word && equals.kind == SyntaxKind::Equals && !compares()
}

/// The part of a script that the scan is in.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Inside {
    Braces,
    /// A text in backquotes, which may contain code: `${ … }`.
    Template,
}

/// Returns the number of bytes up to the closing brace. Without a closing brace, the script is the whole rest.
pub(super) fn length(rest: &str) -> usize {
    closed(rest).unwrap_or(rest.len())
}

/// Returns whether the text is a whole script.
pub(super) fn is_closed(text: &str) -> bool {
    closed(text) == Some(text.len())
}

fn closed(rest: &str) -> Option<usize> {
    let (bytes, mut open, mut at) = (rest.as_bytes(), Vec::new(), 0);
    while let Some(&byte) = bytes.get(at) {
        let here = &bytes[at..];
        at += match (open.last(), byte) {
            (Some(Inside::Template), b'`') if here.starts_with(b"``") => 2,
            (Some(Inside::Template), b'`') => {
                open.pop();
                1
            }
            (Some(Inside::Template), b'$') if here.starts_with(b"${") => {
                open.push(Inside::Braces);
                2
            }
            (Some(Inside::Template), _) => 1,
            (_, b'{') => {
                open.push(Inside::Braces);
                1
            }
            (_, b'}') => {
                open.pop();
                if open.is_empty() {
                    return Some(at + 1);
                }
                1
            }
            (_, b'`') => {
                open.push(Inside::Template);
                1
            }
            (_, b'"') => quoted(here, b'"'),
            (_, b'\'') => quoted(here, b'\''),
            (_, b'#') => raw(here),
            (_, b'/') => comment(here),
            (_, _) => 1,
        };
    }
    None
}

/// Returns the length of a text or a letter in quotes. Without its end, it ends at the end of the line.
fn quoted(here: &[u8], quote: u8) -> usize {
    let mut at = 1;
    while let Some(&byte) = here.get(at) {
        match byte {
            b'\\' => at += 2,
            b'\n' => return at,
            byte if byte == quote => return at + 1,
            _ => at += 1,
        }
    }
    here.len()
}

/// Returns the length of a raw text, `#"…"#`, or of the `#` of a record.
fn raw(here: &[u8]) -> usize {
    let hashes = here.iter().take_while(|&&byte| byte == b'#').count();
    if here.get(hashes) != Some(&b'"') {
        return hashes;
    }
    let end = [&b"\""[..], &b"#".repeat(hashes)].concat();
    let inner = &here[hashes + 1..];
    inner.windows(end.len()).position(|found| found == end).map_or(here.len(), |place| hashes + 1 + place + end.len())
}

/// Returns the length of a comment, or of a `/`. Comments between `/*` and `*/` may contain others.
fn comment(here: &[u8]) -> usize {
    if here.starts_with(b"//") {
        return here.iter().position(|&byte| byte == b'\n').unwrap_or(here.len());
    }
    if !here.starts_with(b"/*") {
        return 1;
    }
    let (mut depth, mut at) = (0_usize, 0);
    while at < here.len() {
        let rest = &here[at..];
        if rest.starts_with(b"/*") {
            (depth, at) = (depth + 1, at + 2);
        } else if rest.starts_with(b"*/") {
            (depth, at) = (depth - 1, at + 2);
            if depth == 0 {
                return at;
            }
        } else {
            at += 1;
        }
    }
    here.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::syntax::lexer::lex;

    /// Returns the scripts of a text.
    fn scripts(text: &str) -> Vec<&str> {
        let found = lex(text).into_iter().filter(|token| token.kind == SyntaxKind::Script);
        found.map(|token| &text[token.start as usize..token.end as usize]).collect()
    }

    #[test]
    fn a_script_ends_at_its_own_brace() {
        let bodies = [
            "{}",
            "{ let a = #{ x: 1 }; if a.x > 0 { a } else { () } }",
            "{ \"}\" + '}' + `}` }",
            "{ \"\\\"}\" }",
            "{ '\\'' }",
            "{ `a ${ let b = \"}\"; #{ c: `}${ 1 }` } } `` }` }",
            "{ // }\n 1 }",
            "{ /* } /* } */ } */ 1 }",
            "{ #\"}\"# + ##\"}\"#}\"## }",
            "{ let p = 'a' / 2; p }",
        ];
        for body in bodies {
            assert_eq!(scripts(&format!("where = script {body}; tries += 1;")), [body], "{body}");
            assert_eq!(scripts(&format!("where=script/* }} */{body}}}")), [body], "{body}");
        }
    }

    #[test]
    fn only_the_value_of_an_assignment_is_a_script() {
        for text in [
            "when mode == script { a }",
            "mode != script {",
            "mode <= script {",
            "state script { }",
            "script {",
            "a = scripts {",
        ] {
            assert_eq!(scripts(text), Vec::<&str>::new(), "{text}");
        }
        assert_eq!(scripts("a = script { open"), ["{ open"]);
        assert!(is_closed("{ 1 }") && !is_closed("{ 1") && !is_closed("{ \"}"));
    }
}
