//! The words of one sentence.

use super::{Place, Read, unreadable};
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, Ident, Number, Text, Unknown};
use crate::syntax::ast::{self, Node};
use crate::syntax::lex;
use crate::unit;
use std::time::Duration;

/// The words with a special meaning in sentences.
const WORDS: [&str; 44] = [
    "a",
    "after",
    "always",
    "any",
    "aborted",
    "assume",
    "at",
    "can",
    "crash",
    "done",
    "ended",
    "eventually",
    "exclusive",
    "finish",
    "finishes",
    "hang",
    "holds",
    "host",
    "implies",
    "loss",
    "ltl",
    "most",
    "never",
    "not",
    "of",
    "on",
    "once",
    "only",
    "running",
    "runs",
    "started",
    "stopped",
    "stopping",
    "stops",
    "takes",
    "the",
    "times",
    "with",
    "within",
    "s",
    "ms",
    "us",
    "min",
    "h",
];

/// The words for events after a number: `the 2nd start of a`. A process may have such a name.
const COUNTED: [&str; 3] = ["start", "end", "abort"];

/// Returns whether a word has a special meaning in sentences.
pub(crate) fn is_word(text: &str) -> bool {
    text != "a" && WORDS.contains(&text)
}

/// Returns the letters after a number that make it an ordinal: `1st`, `2nd`, `11th`.
fn ordinal_suffix(value: u8) -> &'static str {
    match (value / 10, value % 10) {
        (1, _) => "th",
        (_, 1) => "st",
        (_, 2) => "nd",
        (_, 3) => "rd",
        (_, _) => "th",
    }
}

/// Returns whether a text is written directly after a number: `2nd`.
pub(crate) fn is_ordinal_suffix(text: &str) -> bool {
    ["st", "nd", "rd", "th"].contains(&text)
}

/// A word, a number, a sign or a string.
#[derive(Clone, Debug)]
struct Token {
    kind: SyntaxKind,
    text: String,
    span: Span,
}

impl Token {
    fn of(token: &ast::Token) -> Self {
        Self { kind: token.kind(), text: token.text().to_owned(), span: token.span() }
    }
}

/// A word of a sentence, for an editor.
#[derive(Clone, Debug)]
pub(crate) struct Word {
    pub(crate) text: String,
    pub(crate) span: Span,
    pub(crate) is_name: bool,
    /// Whether the word is in the string of a formula.
    pub(crate) is_formula: bool,
}

impl Word {
    fn new(token: Token, is_formula: bool) -> Self {
        Self { is_name: token.kind == Ident, text: token.text, span: token.span, is_formula }
    }
}

/// The words of a sentence, including the words of a formula.
pub(crate) fn words_of(sentence: &Node) -> Vec<Word> {
    Words::new(sentence).all()
}

/// The kind of a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Sentence,
    /// The formula in the string of `holds ltl "..."`.
    Formula,
}

/// The words of a sentence or of a formula, read from left to right.
pub(super) struct Words {
    tokens: Vec<Token>,
    span: Span,
    at: usize,
    wanted: &'static str,
    kind: Kind,
}

impl Words {
    pub(super) fn new(node: &Node) -> Self {
        let mut tokens: Vec<Token> = node.tokens().map(|token| Token::of(&token)).collect();
        if tokens.last().is_some_and(|last| last.text == ";") {
            tokens.pop();
        }
        let span = match (tokens.first(), tokens.last()) {
            (Some(first), Some(last)) => Span { end: last.span.end, ..first.span },
            (_, _) => node.span(),
        };
        Self { tokens, span, at: 0, wanted: "a sentence", kind: Kind::Sentence }
    }

    /// Returns the words in the next string, each with its place in the text.
    pub(super) fn string(&mut self) -> Option<Self> {
        let string = self.tokens.get(self.at).filter(|token| token.kind == Text)?;
        let inner = string.text.strip_prefix('"')?;
        let (inner, span) = (inner.strip_suffix('"').unwrap_or(inner), string.span);
        let mut tokens = Vec::new();
        for token in lex(inner).into_iter().filter(|token| !token.kind.is_trivia()) {
            let text = &inner[token.start as usize..token.end as usize];
            // The lexer makes one token of text that it does not know. Here, each sign of it is a separate word.
            let is_unknown = token.kind == Unknown;
            let pieces: Vec<&str> =
                if is_unknown { text.split_inclusive(|_: char| true).collect() } else { vec![text] };
            let mut start = span.start + 1 + token.start;
            for piece in pieces {
                let end = start + u32::try_from(piece.len()).unwrap_or(0);
                tokens.push(Token { kind: token.kind, text: piece.to_owned(), span: Span { start, end, ..span } });
                start = end;
            }
        }
        self.at += 1;
        Some(Self { tokens, span, at: 0, wanted: "a formula", kind: Kind::Formula })
    }

    pub(super) fn kind(&self) -> Kind {
        self.kind
    }

    /// Returns the number of words.
    pub(super) fn count_all(&self) -> usize {
        self.tokens.len()
    }

    /// Returns all words. The words of a formula take the place of its string.
    fn all(mut self) -> Vec<Word> {
        let mut all = Vec::new();
        while !self.is_over() {
            let is_formula = self.at.checked_sub(1).is_some_and(|before| self.tokens[before].text == "ltl");
            if let Some(formula) = Some(&mut self).filter(|_| is_formula).and_then(Self::string) {
                all.extend(formula.tokens.into_iter().map(|token| Word::new(token, true)));
            } else {
                let word = Word::new(self.tokens[self.at].clone(), false);
                all.push(Word { is_name: word.is_name && !self.is_counted_event(), ..word });
                self.at += 1;
            }
        }
        all
    }

    /// Returns whether the next word is the event in `2nd start of a`, and not the name of a process.
    fn is_counted_event(&self) -> bool {
        let is_counted = self.at.checked_sub(1).is_some_and(|before| is_ordinal_suffix(&self.tokens[before].text));
        is_counted && COUNTED.iter().any(|word| self.at(word)) && self.is(1, "of")
    }

    /// Returns a copy of the words for looking ahead.
    pub(super) fn peek(&self) -> Self {
        Self { tokens: self.tokens.clone(), ..*self }
    }

    pub(super) fn span(&self) -> Span {
        self.span
    }

    /// Returns the sentence on one line.
    pub(super) fn text(&self) -> String {
        let mut text = String::new();
        for (index, token) in self.tokens.iter().enumerate() {
            let before = index.checked_sub(1).map(|before| self.tokens[before].text.as_str());
            let is_tight = [".", ",", ":", ")", "(", "]", "["].contains(&token.text.as_str());
            let is_open = before.is_none_or(|before| [".", "(", "["].contains(&before));
            let is_suffix = index > 0 && self.tokens[index - 1].kind == Number && is_ordinal_suffix(&token.text);
            if !is_tight && !is_open && !is_suffix {
                text.push(' ');
            }
            text.push_str(&token.text);
        }
        text
    }

    /// Returns the place of the next word. At the end, this is the place of the last word.
    pub(super) fn place(&self) -> Span {
        let token = self.tokens.get(self.at).or(self.tokens.last());
        token.map_or(self.span, |token| token.span)
    }

    pub(super) fn here(&self) -> String {
        let end = match self.kind {
            Kind::Sentence => "the end of the sentence",
            Kind::Formula => "the end of the formula",
        };
        self.tokens.get(self.at).map_or_else(|| end.to_owned(), |it| format!("`{}`", it.text))
    }

    pub(super) fn wanted(&self) -> &'static str {
        self.wanted
    }

    pub(super) fn want(&mut self, what: &'static str) -> &Self {
        self.wanted = what;
        self
    }

    pub(super) fn is_over(&self) -> bool {
        self.at >= self.tokens.len()
    }

    pub(super) fn is_name(&self) -> bool {
        self.next_name().is_some()
    }

    /// Returns the next word, if it has the form of a name.
    pub(super) fn next_name(&self) -> Option<&str> {
        self.tokens.get(self.at).filter(|token| token.kind == Ident).map(|token| token.text.as_str())
    }

    pub(super) fn is(&self, ahead: usize, word: &str) -> bool {
        self.tokens.get(self.at + ahead).is_some_and(|token| token.text == word)
    }

    pub(super) fn at(&self, word: &str) -> bool {
        self.is(0, word)
    }

    pub(super) fn eat(&mut self, word: &str) -> bool {
        let is_there = self.is(0, word);
        self.at += usize::from(is_there);
        is_there
    }

    pub(super) fn eat_two(&mut self, first: &str, second: &str) -> bool {
        let are_there = self.is(0, first) && self.is(1, second);
        self.at += if are_there { 2 } else { 0 };
        are_there
    }

    pub(super) fn need(&mut self, word: &'static str) -> Read<()> {
        if self.eat(word) {
            return Ok(());
        }
        Err(unreadable(self.want(match word {
            "with" => "`with`",
            "implies" => "`implies`",
            ":" => "`:`",
            "runs" => "`runs`",
            "takes" => "`takes`",
            ".." => "`..`",
            "host" => "`host`",
            "(" => "`(`",
            ")" => "`)`",
            "]" => "`]`",
            "ltl" => "`ltl`",
            _ => "`stopped`, `never` or `eventually`",
        })))
    }

    /// Reads the next name or string.
    pub(super) fn name(&mut self) -> Option<Place> {
        let token = self.tokens.get(self.at).filter(|token| [Ident, Text].contains(&token.kind))?;
        self.at += 1;
        let text = if token.kind == Text { ast::content(&token.text) } else { token.text.clone() };
        Some((text, token.span))
    }

    /// Reads `[2]`.
    pub(super) fn index(&mut self) -> Read<Option<usize>> {
        if !self.eat("[") {
            return Ok(None);
        }
        let value = self.tokens.get(self.at).and_then(|token| token.text.parse().ok());
        let Some(value) = value else { return Err(unreadable(self.want("an index"))) };
        self.at += 1;
        self.need("]")?;
        Ok(Some(value))
    }

    /// Reads `300 ms`.
    pub(super) fn time(&mut self) -> Read<Duration> {
        let number = self.tokens.get(self.at).filter(|token| token.kind == Number);
        let word = self.tokens.get(self.at + 1).filter(|token| token.kind == Ident);
        let text = number.zip(word).map(|(number, word)| format!("{} {}", number.text, word.text));
        let read = text.and_then(|text| unit::read(&text).ok());
        let seconds =
            read.filter(|(_, dimension)| *dimension == Some(unit::Dimension::TIME)).map(|(seconds, _)| seconds);
        let Some(time) = seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok()) else {
            return Err(unreadable(self.want("a time such as `5 s`")));
        };
        self.at += 2;
        Ok(time)
    }

    /// Reads `the 2nd`, up to `most`, if there is a number after `the`. Otherwise, `the` is the name of a process.
    pub(super) fn ordinal(&mut self, most: u8) -> Read<Option<u8>> {
        let Some(number) = self.tokens.get(self.at + 1).filter(|token| token.kind == Number && self.at("the")) else {
            return Ok(None);
        };
        let value: Option<u8> = number.text.parse().ok().filter(|value| (1..=most).contains(value));
        self.at += 1;
        match value.filter(|value| self.is(1, ordinal_suffix(*value))) {
            Some(value) => {
                self.at += 2;
                Ok(Some(value))
            }
            None => Err(unreadable(self.want("a number from `1st` to `16th`"))),
        }
    }

    /// Reads `3 times`.
    pub(super) fn count(&mut self, word: &'static str) -> Read<u32> {
        let value = self.tokens.get(self.at).and_then(|token| token.text.parse().ok());
        let value = value.filter(|_| self.is(1, word));
        let Some(value) = value.filter(|&value| value > 0 && value < 100) else {
            return Err(unreadable(self.want("`once`, or a number below 100 and `times`")));
        };
        self.at += 2;
        Ok(value)
    }
}
