//! Tokens to tree. The parser accepts any tokens and keeps all of them in the tree.
//!
//! A recursive-descent parser that never gives up: it reports each mistake, puts unreadable text
//! into an error node, and continues at the next `;`, `}` or section keyword. A missing bracket is
//! reported and then taken as read, so that one damaged token costs one diagnostic in most places.

mod activity;
mod expression;
mod habit;
mod module;
mod policy;
mod process;
mod property;
mod repair;
mod value;

use super::{SyntaxKind, SyntaxNode, Token, lexer};
use crate::diagnostic::{Code, DIAGNOSTICS_MAX, Diagnostic, Edit, Fix, Label, Severity};
use crate::plan::DEPTH_MAX;
use crate::source::{Origin, SOURCE_MAX, Source, Span};
use rowan::{Checkpoint, GreenNodeBuilder, Language};

/// As many tokens have to be read after an error before the next one is believed to have a cause of its own.
const SHADOW: usize = 3;
/// As many characters of a token are repeated in a remark.
const EXCERPT_MAX: usize = 40;
/// The most tokens of one text, comments and blanks too: some hundred bytes of memory each.
const TOKENS_MAX: usize = 1_000_000;

/// A parsed text.
pub(crate) struct Parse {
    /// The tree of the whole text.
    pub(crate) root: SyntaxNode,
    /// The lexical and syntactic mistakes.
    pub(crate) diagnostics: Vec<Diagnostic>,
    /// How much more there would be to say of it.
    pub(crate) omitted: usize,
    /// Where it is damaged.
    pub(crate) damage: Vec<Span>,
}

/// Returns the tree of a text. If the text is too long, returns an empty tree and the reason.
pub(crate) fn parse(source: &Source, origin: Origin) -> Parse {
    let read = match source.text.len() <= SOURCE_MAX {
        true => lexer::lex_at_most(&source.text, TOKENS_MAX)
            .ok_or_else(|| format!("the text has more than {TOKENS_MAX} words, signs, blanks and comments")),
        false => Err(format!("the text is longer than {} MiB", SOURCE_MAX >> 20)),
    };
    let mut parser = match read {
        Ok(tokens) => Parser::new(&source.text, tokens, origin),
        Err(why) => {
            let mut parser = Parser::new("", Vec::new(), origin);
            parser.report(Code::E0007, why);
            parser
        }
    };
    parser.check_tokens();
    parser.file();
    let root = SyntaxNode::new_root(parser.builder.finish());
    debug_assert!(parser.text.is_empty() || root.text() == source.text.as_str(), "the tree keeps every byte");
    let Reports { diagnostics, omitted, damage, .. } = parser.reports;
    Parse { root, diagnostics, omitted, damage }
}

struct Parser<'t> {
    text: &'t str,
    origin: Origin,
    tokens: Vec<Token>,
    /// Indices of the tokens that mean something.
    solid: Vec<usize>,
    /// Index into `solid` of the next token.
    cursor: usize,
    /// Index into `tokens` of the first token that is not in the tree yet.
    placed: usize,
    builder: GreenNodeBuilder<'static>,
    reports: Reports,
    depth: usize,
    /// Where the expression that is being read ends, besides a closing bracket.
    ends: Ends,
}

/// The errors and warnings about the text.
#[derive(Default)]
struct Reports {
    diagnostics: Vec<Diagnostic>,
    /// How many remarks found no room.
    omitted: usize,
    /// Where the text is damaged, also if this was not reported.
    damage: Vec<Span>,
    /// Where the last error was found.
    reported_at: Option<usize>,
}

/// The signs that end an expression.
#[derive(Clone, Copy, Default)]
struct Ends {
    /// A `;`: a state runs the expression.
    at_semicolon: bool,
    /// The word `until`: the expression is the operand of a `repeat`.
    at_until: bool,
}

impl<'t> Parser<'t> {
    fn new(text: &'t str, mut tokens: Vec<Token>, origin: Origin) -> Self {
        signs_of_activities(text, &mut tokens);
        let is_solid = |&index: &usize| !tokens[index].kind.is_trivia() && tokens[index].kind != SyntaxKind::Unknown;
        let solid = (0..tokens.len()).filter(is_solid).collect();
        Self {
            text,
            origin,
            tokens,
            solid,
            cursor: 0,
            placed: 0,
            builder: GreenNodeBuilder::new(),
            reports: Reports::default(),
            depth: 0,
            ends: Ends::default(),
        }
    }

    // ---- looking ----

    fn token(&self, ahead: usize) -> Option<Token> {
        self.solid.get(self.cursor + ahead).map(|&index| self.tokens[index])
    }

    fn kind(&self, ahead: usize) -> SyntaxKind {
        self.token(ahead).map_or(SyntaxKind::End, |token| token.kind)
    }

    fn word(&self, ahead: usize) -> &'t str {
        self.token(ahead).map_or("", |token| &self.text[token.start as usize..token.end as usize])
    }

    fn at(&self, kind: SyntaxKind) -> bool {
        self.kind(0) == kind
    }

    fn at_any(&self, kinds: &[SyntaxKind]) -> bool {
        kinds.contains(&self.kind(0))
    }

    fn at_word(&self, word: &str) -> bool {
        self.at(SyntaxKind::Ident) && self.word(0) == word
    }

    fn span(&self) -> Span {
        let end = u32::try_from(self.text.len()).unwrap_or(u32::MAX);
        let (start, end) = self.token(0).map_or((end, end), |token| (token.start, token.end));
        Span { origin: self.origin, start, end }
    }

    /// The empty span after the last token that was read.
    fn after_last(&self) -> Span {
        let end = match self.cursor.checked_sub(1) {
            Some(last) => self.tokens[self.solid[last]].end,
            None => 0,
        };
        Span { origin: self.origin, start: end, end }
    }

    /// The last token that was read.
    fn last(&self) -> Option<Token> {
        self.cursor.checked_sub(1).map(|last| self.tokens[self.solid[last]])
    }

    /// Whether the last token that was read is of a kind.
    fn follows(&self, kind: SyntaxKind) -> bool {
        self.last().is_some_and(|last| last.kind == kind)
    }

    /// Whether a character that means nothing stands before the next token.
    fn follows_unknown(&self) -> bool {
        let end = self.solid.get(self.cursor).copied().unwrap_or(self.tokens.len());
        let start = self.cursor.checked_sub(1).map_or(0, |last| self.solid[last]);
        self.tokens[start..end].iter().any(|token| token.kind == SyntaxKind::Unknown)
    }

    /// Whether the last token that was read is a string without an end.
    fn follows_open_string(&self) -> bool {
        let is_open = |last: Token| lexer::is_open(last.kind, &self.text[last.start as usize..last.end as usize]);
        self.last().is_some_and(is_open)
    }

    // ---- building ----

    fn place_trivia(&mut self) {
        let until = self.solid.get(self.cursor).copied().unwrap_or(self.tokens.len());
        while self.placed < until {
            self.place();
        }
    }

    fn place(&mut self) {
        let token = self.tokens[self.placed];
        let text = &self.text[token.start as usize..token.end as usize];
        self.builder.token(super::Dca::kind_to_raw(token.kind), text);
        self.placed += 1;
    }

    fn start(&mut self, kind: SyntaxKind) {
        self.place_trivia();
        self.builder.start_node(super::Dca::kind_to_raw(kind));
    }

    fn checkpoint(&mut self) -> Checkpoint {
        self.place_trivia();
        self.builder.checkpoint()
    }

    fn start_at(&mut self, checkpoint: Checkpoint, kind: SyntaxKind) {
        self.builder.start_node_at(checkpoint, super::Dca::kind_to_raw(kind));
    }

    fn finish(&mut self) {
        self.builder.finish_node();
    }

    fn bump(&mut self) {
        if self.cursor < self.solid.len() {
            self.place_trivia();
            self.place();
            self.cursor += 1;
        }
    }

    fn eat(&mut self, kind: SyntaxKind) -> bool {
        let is_there = self.at(kind);
        if is_there {
            self.bump();
        }
        is_there
    }

    fn eat_word(&mut self, word: &str) -> bool {
        let is_there = self.at_word(word);
        if is_there {
            self.bump();
        }
        is_there
    }

    // ---- reporting ----

    /// Reports something about the next token. Errors close to the last one have the same cause: they leave a mark for
    /// the checker and are not reported again.
    fn report(&mut self, code: Code, message: impl Into<String>) -> Option<&mut Diagnostic> {
        if code.severity() == Severity::Error {
            self.reports.damage.push(self.span());
            let last = self.reports.reported_at.replace(self.cursor);
            // A character before it that means nothing is the cause.
            if self.follows_unknown() {
                return None;
            }
            if last.is_some_and(|last| self.cursor < last + SHADOW) {
                return None;
            }
        }
        let report = Diagnostic::new(code, self.span(), message);
        self.add(report)
    }

    /// Adds a remark unless there are too many.
    fn add(&mut self, report: Diagnostic) -> Option<&mut Diagnostic> {
        if self.reports.diagnostics.len() >= DIAGNOSTICS_MAX {
            self.reports.omitted += 1;
            return None;
        }
        self.reports.diagnostics.push(report);
        self.reports.diagnostics.last_mut()
    }

    /// Reports that something else stands here; reads nothing.
    fn expected(&mut self, what: &str) -> Option<&mut Diagnostic> {
        let found = match self.at(SyntaxKind::End) {
            true => SyntaxKind::End.describe().to_owned(),
            false => format!("`{}`", excerpt(self.word(0))),
        };
        self.report(Code::E0001, format!("expected {what}, found {found}"))
    }

    /// Reads a token that has to be there, or reports it with a fix and takes it as read.
    fn expect(&mut self, kind: SyntaxKind) -> bool {
        // The token behind a missing opening bracket may as well be the wrong one.
        let is_only = if kind == SyntaxKind::LeftParen {
            self.at(SyntaxKind::LeftBrace)
        } else if kind == SyntaxKind::LeftBrace {
            self.ends_block()
        } else {
            kind != SyntaxKind::LeftBracket
        };
        self.expect_at(kind, is_only)
    }

    /// The same; `is_only` says whether there is no other place for a token that is missing.
    fn expect_at(&mut self, kind: SyntaxKind, is_only: bool) -> bool {
        if self.eat(kind) {
            return true;
        }
        let place = self.after_last();
        // A bracket behind a string without an end is a part of it; one before a new section or a comma has no counterpart.
        let is_lost = kind == SyntaxKind::LeftParen && (self.ends_block() || self.at(SyntaxKind::Comma))
            || kind == SyntaxKind::Colon && self.at_any(&[SyntaxKind::LeftBrace, SyntaxKind::DoubleColon])
            || kind == SyntaxKind::Dot && self.at(SyntaxKind::DotDot);
        let has_place = !is_lost && !self.follows_open_string();
        let found = self.span();
        // Nothing can stand between the two.
        let is_pair = kind == SyntaxKind::LeftParen && self.at_any(&[SyntaxKind::LeftBrace, SyntaxKind::Semicolon]);
        let text = if is_pair { "()".to_owned() } else { kind.describe().trim_matches('`').to_owned() };
        let is_above = self.text.get(place.end as usize..found.start as usize).is_some_and(|gap| gap.contains('\n'));
        if let Some(diagnostic) = self.expected(kind.describe()).filter(|_| has_place) {
            if kind == SyntaxKind::Semicolon && is_above {
                // It is missed lines below the place where it belongs.
                diagnostic.primary.span = place;
                diagnostic.secondary.push(Label { span: found, text: "found instead".to_owned() });
            }
            let fix = Fix { title: format!("insert `{text}`"), edits: vec![Edit { span: place, text }] };
            if is_only {
                diagnostic.fix = Some(fix);
            } else {
                diagnostic.choices.push(fix);
            }
        }
        false
    }

    fn expect_name(&mut self, what: &str) -> bool {
        let is_there = self.eat(SyntaxKind::Ident);
        if !is_there {
            self.expected(what);
        }
        is_there
    }

    /// Enters one more level; at the limit reports it and returns false.
    fn descend(&mut self) -> bool {
        if self.depth >= DEPTH_MAX {
            self.report(Code::E0004, format!("nested deeper than {DEPTH_MAX} levels"));
            return false;
        }
        self.depth += 1;
        true
    }

    fn ascend(&mut self) {
        self.depth -= 1;
    }

    /// Reports the tokens that are wrong wherever they stand.
    fn check_tokens(&mut self) {
        for index in 0..self.tokens.len() {
            let token = self.tokens[index];
            let text = &self.text[token.start as usize..token.end as usize];
            let span = Span { origin: self.origin, start: token.start, end: token.end };
            let report = match token.kind == SyntaxKind::Unknown {
                true => {
                    let found = Diagnostic::new(Code::E0003, span, format!("`{}` means nothing here", visible(text)));
                    habit::instead_of(text).into_iter().fold(found, Diagnostic::help)
                }
                false if lexer::is_open(token.kind, text) => {
                    Diagnostic::new(Code::E0002, span, format!("{} does not end", token.kind.describe()))
                }
                false => continue,
            };
            self.add(report);
            self.reports.damage.push(span);
        }
    }
}

/// `+` and `!` have a meaning inside of an activity alone.
fn signs_of_activities(text: &str, tokens: &mut [Token]) {
    let word = |token: &Token| &text[token.start as usize..token.end as usize];
    let mut depth = None;
    let mut solid: Vec<usize> = (0..tokens.len()).filter(|&index| !tokens[index].kind.is_trivia()).collect();
    solid.extend([tokens.len(); 2]);
    for place in 0..solid.len() - 2 {
        let index = solid[place];
        let token = tokens[index];
        let kind = |ahead: usize| tokens.get(solid[place + ahead]).map_or(SyntaxKind::End, |token| token.kind);
        let opens = [SyntaxKind::LeftParen, SyntaxKind::LeftBrace].contains(&kind(2));
        if token.kind == SyntaxKind::Ident && kind(1) == SyntaxKind::Ident && opens {
            match word(&token) {
                "activity" => depth = Some(0),
                "process" | "module" => depth = None,
                _ => {}
            }
        }
        let Some(level) = &mut depth else { continue };
        if token.kind == SyntaxKind::LeftBrace {
            *level += 1;
        } else if token.kind == SyntaxKind::RightBrace {
            *level -= 1;
            if *level <= 0 {
                depth = None;
            }
        } else if token.kind == SyntaxKind::Unknown {
            match word(&token) {
                "+" => tokens[index].kind = SyntaxKind::Plus,
                "!" => tokens[index].kind = SyntaxKind::Bang,
                _ => {}
            }
        }
    }
}

/// Characters as they are, and those that cannot be seen by their number.
fn visible(text: &str) -> String {
    let is_hidden = |c: char| {
        c.is_control()
            || matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}')
    };
    let shown = |c: char| if is_hidden(c) { format!("U+{:04X}", u32::from(c)) } else { c.to_string() };
    excerpt(text).chars().map(shown).collect()
}

/// Returns a piece of text for a message, shortened if it is long.
fn excerpt(text: &str) -> String {
    match text.char_indices().nth(EXCERPT_MAX) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}
