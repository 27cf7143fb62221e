//! From text to tokens. The lexer never fails: a character without meaning becomes an [`SyntaxKind::Unknown`] token.

mod script;

use super::SyntaxKind;

/// A piece of text with a kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Token {
    /// The kind of the token.
    pub kind: SyntaxKind,
    /// The first byte.
    pub start: u32,
    /// The byte after the last one.
    pub end: u32,
}

/// The fixed tokens. The longest come first, so that the first match is the longest.
const SYMBOLS: &[(&str, SyntaxKind)] = &[
    ("->", SyntaxKind::Arrow),
    ("<-", SyntaxKind::BackArrow),
    ("=>", SyntaxKind::FatArrow),
    (";;", SyntaxKind::Recur),
    (":;", SyntaxKind::Recur),
    ("::", SyntaxKind::DoubleColon),
    ("..", SyntaxKind::DotDot),
    ("(", SyntaxKind::LeftParen),
    (")", SyntaxKind::RightParen),
    ("{", SyntaxKind::LeftBrace),
    ("}", SyntaxKind::RightBrace),
    ("[", SyntaxKind::LeftBracket),
    ("]", SyntaxKind::RightBracket),
    ("<", SyntaxKind::Less),
    (">", SyntaxKind::Greater),
    (",", SyntaxKind::Comma),
    (";", SyntaxKind::Semicolon),
    (":", SyntaxKind::Colon),
    (".", SyntaxKind::Dot),
    ("#", SyntaxKind::Hash),
    ("&", SyntaxKind::Ampersand),
    ("?", SyntaxKind::Question),
    ("=", SyntaxKind::Equals),
    ("|", SyntaxKind::Bar),
    ("/", SyntaxKind::Slash),
    ("-", SyntaxKind::Minus),
    ("*", SyntaxKind::Star),
];

/// The byte order mark, with which some editors begin a text. It has no meaning.
const MARK: char = '\u{feff}';

/// Returns the tokens of a text. They cover the text without a gap. The text may have at most
/// [`crate::source::SOURCE_MAX`] bytes.
pub fn lex(text: &str) -> Vec<Token> {
    lex_at_most(text, usize::MAX).unwrap_or_default()
}

/// Returns whether a text is one name.
pub(crate) fn is_name(text: &str) -> bool {
    let tokens = lex(text);
    tokens.len() == 1 && tokens[0].kind == SyntaxKind::Ident
}

/// Returns the tokens of a text, or none if there are more than `count_max`.
pub(super) fn lex_at_most(text: &str, count_max: usize) -> Option<Vec<Token>> {
    let mut tokens: Vec<Token> = Vec::with_capacity((text.len() / 4).min(count_max));
    let mut start = 0;
    while let Some(first) = text[start..].chars().next() {
        let (kind, length) = match first {
            MARK if start == 0 => (SyntaxKind::Whitespace, MARK.len_utf8()),
            '{' if script::begins(&tokens, text) => (SyntaxKind::Script, script::length(&text[start..])),
            first => token(&text[start..], first),
        };
        let end = start + length;
        match tokens.last_mut() {
            // Damaged text without a gap is one token, so it gives one diagnostic.
            Some(last) if kind == SyntaxKind::Unknown && last.kind == kind => last.end = offset(end),
            Some(_) | None => tokens.push(Token { kind, start: offset(start), end: offset(end) }),
        }
        if tokens.len() > count_max {
            return None;
        }
        start = end;
    }
    Some(tokens)
}

fn offset(bytes: usize) -> u32 {
    u32::try_from(bytes).unwrap_or(u32::MAX)
}

/// Returns the kind and the length in bytes of the first token of `rest`. The length is at least one character.
fn token(rest: &str, first: char) -> (SyntaxKind, usize) {
    if first.is_whitespace() {
        return (SyntaxKind::Whitespace, length_while(rest, char::is_whitespace));
    }
    if rest.starts_with("//") {
        let kind = match rest.starts_with("///") && !rest.starts_with("////") {
            true => SyntaxKind::DocComment,
            false => SyntaxKind::Comment,
        };
        return (kind, rest.find('\n').unwrap_or(rest.len()));
    }
    if let Some(inner) = rest.strip_prefix("/*") {
        return (SyntaxKind::Comment, inner.find("*/").map_or(rest.len(), |end| end + 4));
    }
    if first.is_alphabetic() || first == '_' {
        return (SyntaxKind::Ident, length_while(rest, |c| c.is_alphanumeric() || c == '_'));
    }
    if first.is_ascii_digit() {
        return (SyntaxKind::Number, number_length(rest));
    }
    if first == '"' {
        return (SyntaxKind::Text, text_length(rest));
    }
    let symbol = SYMBOLS.iter().find(|(symbol, _)| rest.starts_with(symbol));
    symbol.map_or((SyntaxKind::Unknown, first.len_utf8()), |&(symbol, kind)| (kind, symbol.len()))
}

fn length_while(rest: &str, belongs: impl Fn(char) -> bool) -> usize {
    rest.find(|c| !belongs(c)).unwrap_or(rest.len())
}

/// Returns the length of a number: `12`, `1_000`, `0.25`, `1e-3`. `0..4` begins with the number `0`, and `5 m` with the
/// number `5`.
fn number_length(rest: &str) -> usize {
    let digits = |from: usize| from + length_while(&rest[from..], |c| c.is_ascii_digit() || c == '_');
    let starts_digit = |from: usize| rest[from..].starts_with(|c: char| c.is_ascii_digit());
    let mut end = digits(0);
    if rest[end..].starts_with('.') && starts_digit(end + 1) {
        end = digits(end + 1);
    }
    if rest[end..].starts_with(['e', 'E']) {
        let sign = usize::from(rest[end + 1..].starts_with(['+', '-']));
        if starts_digit(end + 1 + sign) {
            end = digits(end + 1 + sign);
        }
    }
    end
}

/// Returns the length of a string. It ends at its quote, or at the end of the line if the quote is missing.
fn text_length(rest: &str) -> usize {
    let mut escaped = false;
    for (index, c) in rest.char_indices().skip(1) {
        match c {
            '\n' => return index,
            '"' if !escaped => return index + 1,
            _ => escaped = c == '\\' && !escaped,
        }
    }
    rest.len()
}

/// Returns whether a string or a comment lacks its end.
pub(super) fn is_open(kind: SyntaxKind, text: &str) -> bool {
    if kind == SyntaxKind::Text {
        let Some(inner) = text.strip_prefix('"').and_then(|rest| rest.strip_suffix('"')) else { return true };
        // An odd number of `\\` before the quote escapes it.
        return inner.chars().rev().take_while(|&c| c == '\\').count() % 2 == 1;
    }
    if kind == SyntaxKind::Script {
        return !script::is_closed(text);
    }
    kind == SyntaxKind::Comment && text.starts_with("/*") && (text.len() < 4 || !text.ends_with("*/"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use SyntaxKind::{Arrow, BackArrow, DotDot, Ident, Number, Recur, Semicolon, Text, Unknown};
    use proptest::prelude::*;

    fn check(text: &str, expect: &[SyntaxKind]) {
        let kinds: Vec<SyntaxKind> =
            lex(text).iter().map(|token| token.kind).filter(|kind| !kind.is_trivia()).collect();
        assert_eq!(kinds, expect, "{text}");
    }

    #[test]
    fn the_longest_token_wins() {
        check("a;;b:;c ; ;", &[Ident, Recur, Ident, Recur, Ident, Semicolon, Semicolon]);
        check("a->b<-c", &[Ident, Arrow, Ident, BackArrow, Ident]);
        check("0..4 1.5e-3m 1_000", &[Number, DotDot, Number, Number, Ident, Number]);
        check(r#""a\"b" "open"#, &[Text, Text]);
        check("$$ €", &[Unknown, Unknown]);
        check("/* a */ /// doc\n// x", &[]);
    }

    proptest! {
        #[test]
        fn tokens_cover_the_text(text in ".{0,200}") {
            let mut end = 0;
            for token in lex(&text) {
                prop_assert_eq!(token.start, end);
                prop_assert!(token.end > token.start);
                prop_assert!(text.get(token.start as usize..token.end as usize).is_some());
                end = token.end;
            }
            prop_assert_eq!(end as usize, text.len());
        }
    }
}
