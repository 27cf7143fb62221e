//! Completes the word at the cursor.
//!
//! A rare letter is inserted at the cursor, and the text is read again. So there is always a word at the cursor. The parser accepts any
//! text, so it gives the kind of this word.

mod names;
mod place;
mod records;
mod sentence;

use super::Analysis;
use super::words::{self, Place};
use crate::source::Source;
use crate::syntax::SyntaxKind;
use crate::syntax::ast::{Node, catches};

/// The mark at the cursor: a letter that no spec has.
const MARK: char = 'ꙮ';

/// The kind of a completion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CompletionKind {
    /// A word of the language.
    Keyword,
    /// A process or module.
    Type,
    /// An instance.
    Instance,
    /// A port.
    Port,
    /// The label of a connection set.
    Label,
    /// A parameter, or the name of an argument.
    Parameter,
    /// An outcome.
    Outcome,
    /// A named constant.
    Constant,
    /// A host.
    Host,
    /// A unit.
    Unit,
}

/// A completion for the word at the cursor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Completion {
    /// The kind of the completion.
    pub kind: CompletionKind,
    /// The text that is inserted.
    pub label: String,
    /// A short description. It may be empty.
    pub detail: String,
    /// The documentation in Markdown. It may be empty.
    pub documentation: String,
    /// The text that is inserted instead of the label. `$0` and `${1:name}` mark the parts that the user fills in.
    pub snippet: Option<String>,
}

impl Completion {
    fn new(kind: CompletionKind, label: impl Into<String>) -> Self {
        Self { kind, label: label.into(), detail: String::new(), documentation: String::new(), snippet: None }
    }

    fn detail(self, detail: impl Into<String>) -> Self {
        Self { detail: detail.into(), ..self }
    }

    fn documentation(self, documentation: impl Into<String>) -> Self {
        Self { documentation: documentation.into(), ..self }
    }
}

impl Analysis {
    /// Returns the bytes of the word at a byte offset of the spec, and the words that could replace
    /// it. The most likely words come first, even if some text is already typed.
    pub fn complete(&self, offset: usize) -> (std::ops::Range<usize>, Vec<Completion>) {
        let text = &self.spec.text;
        let offset = text.floor_char_boundary(offset);
        let part = |c: char| c.is_alphanumeric() || c == '_';
        let start =
            text[..offset].rfind(|c| !part(c)).map_or(0, |at| at + text[at..].chars().next().map_or(1, char::len_utf8));
        let end = text[offset..].find(|c| !part(c)).map_or(text.len(), |length| offset + length);
        let marked = Source { text: format!("{}{MARK}{}", &text[..offset], &text[offset..]), ..self.spec.clone() };
        let marked = Self::new(marked, self.others.clone(), &self.options);
        // A number that is only partly typed is not a name.
        let start = text[start..offset].find(|c: char| !c.is_ascii_digit()).map_or(offset, |digits| start + digits);
        (start..end, marked.candidates(offset))
    }

    /// Returns every completion that may replace the marked word.
    fn candidates(&self, offset: usize) -> Vec<Completion> {
        let Some(token) = self.token_at(offset) else { return Vec::new() };
        let Some(at) = place::Cursor::new(&token) else { return Vec::new() };
        // The string of a formula also contains names.
        let is_word = match at.parent.kind() {
            SyntaxKind::Sentence => [SyntaxKind::Ident, SyntaxKind::Text].contains(&token.kind()),
            _ => token.kind() == SyntaxKind::Ident,
        };
        if !is_word {
            return Vec::new();
        }
        let mut found = match at.parent.kind() {
            SyntaxKind::Sentence => self.sentence(&at),
            SyntaxKind::Endpoint => self.end_of_connection(&at),
            SyntaxKind::Owner if at.place == 0 => self.instances(&at),
            SyntaxKind::Labels => self.labels_of(&at),
            SyntaxKind::Run if at.follows_repeat() => [inside("until"), keywords(Place::Suffix)].concat(),
            SyntaxKind::Run if at.follows_operand() => keywords(Place::Suffix),
            SyntaxKind::Run => self.actions(&at),
            SyntaxKind::Type => self.types(&at),
            SyntaxKind::Field => self.fields(&at),
            SyntaxKind::Host => self.values(&at, true),
            SyntaxKind::OnBoot => at.on_boot(),
            SyntaxKind::Constant if at.before == "," && at.grand_is(SyntaxKind::Retry) => inside("pause"),
            SyntaxKind::Constant => self.constants(&at),
            SyntaxKind::Claim => self.claims(),
            SyntaxKind::Instance if at.place > 0 => inside("instof"),
            SyntaxKind::Connection | SyntaxKind::Quality => keywords(Place::Quality),
            SyntaxKind::Count | SyntaxKind::AllOf => self.values(&at, false),
            SyntaxKind::Port if at.place > 1 => inside("optional"),
            SyntaxKind::Policy => at.policy(),
            SyntaxKind::AnyOf => inside("of"),
            SyntaxKind::Match | SyntaxKind::Arm if at.inside(SyntaxKind::Match).is_some_and(catches) => at.causes(),
            SyntaxKind::Match | SyntaxKind::Arm => self.outcomes(&at),
            SyntaxKind::Until => self.ends_of_repeat(&at),
            SyntaxKind::Resources if at.inside(SyntaxKind::Using).is_some() => self.resources(&at),
            _ => at.words(),
        };
        found.retain(|offer| !offer.label.contains(MARK));
        found
    }

    /// Returns the completions for `instance, Port`.
    fn end_of_connection(&self, at: &place::Cursor) -> Vec<Completion> {
        if at.place == 0 {
            return if at.begins_statement() { self.instances(at) } else { keywords(Place::Quality) };
        }
        let Some(name) = at.parent.names().next() else { return Vec::new() };
        self.ports_of(at, &name.text)
    }

    /// Returns the completions that may begin an event action.
    fn actions(&self, at: &place::Cursor) -> Vec<Completion> {
        let mut found = self.instances(at);
        found.extend(keywords(Place::Action));
        found
    }

    /// Returns the completions for a type of an instance, of a parameter, or of messages.
    fn types(&self, at: &place::Cursor) -> Vec<Completion> {
        match at.grand.as_ref().map(Node::kind) {
            Some(SyntaxKind::Instance) if at.before != "instof" => inside("instof"),
            Some(SyntaxKind::Instance) => self.instance_types(at),
            Some(SyntaxKind::Param) => [value_types(), self.named_types()].concat(),
            Some(SyntaxKind::TypeItem) => [value_types(), self.named_types(), self.message_types()].concat(),
            _ => [self.named_types(), self.message_types()].concat(),
        }
    }
}

/// Returns the words of the language for a place.
fn keywords(place: Place) -> Vec<Completion> {
    words::at(place).map(keyword).collect()
}

fn inside(word: &str) -> Vec<Completion> {
    words::find(word, &[Place::Inside]).map(keyword).into_iter().collect()
}

fn keyword(word: &words::Word) -> Completion {
    let mut offer = Completion::new(CompletionKind::Keyword, word.text).documentation(word.meaning);
    offer.snippet = (word.snippet != word.text).then(|| word.snippet.to_owned());
    offer
}

/// Returns the types that a parameter can have.
fn value_types() -> Vec<Completion> {
    let plain = [
        ("Host", "a host"),
        ("Text", "a string"),
        ("Number", "a number"),
        ("Truth", "`true` or `false`"),
        ("Secret", "a secret of the database"),
    ];
    let quantities = crate::unit::types();
    let all = plain.into_iter().chain(quantities);
    all.map(|(name, detail)| Completion::new(CompletionKind::Type, name).detail(detail)).collect()
}
