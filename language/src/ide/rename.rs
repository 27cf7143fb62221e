//! Renames a declaration and everything that means it.
//!
//! A rename is right when every name of the new text means the same as before. This is checked by reading the new text,
//! so it covers every rule of the language by which a name could change its meaning.

use super::index::{Index, Kind};
use super::{Analysis, Declaration};
use crate::source::{Origin, Role, Source, Span};
use crate::syntax::{SyntaxKind, lex};
use std::collections::{BTreeMap, BTreeSet};

/// The longest name.
const NAME_MAX: usize = 200;

/// Why something cannot have another name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RenameError {
    /// No declared name stands at that place.
    #[error("this place has no name that can be changed")]
    Nameless,
    /// The name is declared in the interface of a program.
    #[error("`{name}` is declared by the program {program}: rename it there")]
    Foreign {
        /// The name.
        name: String,
        /// The program that declares it.
        program: String,
    },
    /// The language gives it its meaning.
    #[error("`main` is where a deployment starts, so its name stays")]
    Main,
    /// The new text cannot be a name.
    #[error("`{to}` is not a name: letters, digits and `_`, and no digit first")]
    Invalid {
        /// The new name.
        to: String,
    },
    /// Something around it is called so.
    #[error("`{to}` is taken: {what} has this name")]
    Acquisition {
        /// The new name.
        to: String,
        /// The present owner of the name, such as "an instance of `main`".
        what: String,
    },
    /// Some name would mean something else.
    #[error("with `{to}` some name in {file} would mean something else")]
    Meaning {
        /// The new name.
        to: String,
        /// In which text.
        file: String,
    },
}

/// A change in one of several texts.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FileEdit {
    /// Name of the source.
    pub file: String,
    /// First byte of the replaced text.
    pub start: u32,
    /// One after its last byte.
    pub end: u32,
    /// The new text.
    pub text: String,
}

impl Analysis {
    /// Returns the place of the name at a byte offset of the spec, if it can have another one.
    ///
    /// # Errors
    /// No name stands there, or this text may not change it.
    pub fn prepare_rename(&self, offset: usize) -> Result<Span, RenameError> {
        let (span, symbol) = self.index().place_at(offset).ok_or(RenameError::Nameless)?;
        self.check_own(symbol)?;
        Ok(span)
    }

    /// Whether the texts at hand are all that declare a symbol.
    fn check_own(&self, symbol: usize) -> Result<(), RenameError> {
        let is_foreign = |span: &Span| span.origin != Origin::Spec && self.source(*span).role != Role::Part;
        let foreign = self.index().places(symbol).find(is_foreign);
        let symbol = &self.index().symbols[symbol];
        if let Some(span) = foreign {
            let program = self.source(span).name.clone();
            return Err(RenameError::Foreign { name: symbol.name.clone(), program });
        }
        let is_main = matches!(symbol.kind, Kind::Process(_)) && symbol.name == "main";
        if is_main { Err(RenameError::Main) } else { Ok(()) }
    }

    /// Returns the owner of the name `to` among symbols of the same sort, if there is one.
    fn taken(&self, symbol: usize, to: &str) -> Option<String> {
        let kind = self.index().symbols[symbol].kind;
        let group = |process: usize| self.model.processes[process].name.text.as_str();
        let what = match kind {
            Kind::Process(_) | Kind::Module(_) => "a type".to_owned(),
            Kind::Constant => "a constant".to_owned(),
            Kind::Param(..) => "a parameter".to_owned(),
            Kind::Instance(process, _) => format!("an instance of `{}`", group(process)),
            Kind::Export(process, _) => format!("a port of `{}`", group(process)),
            Kind::Port(module, _) => format!("a port of `{}`", self.model.modules[module].name.text),
            Kind::Label(process, _) => format!("a connection set of `{}`", group(process)),
            Kind::Resource(process, _) => format!("a resource of `{}`", group(process)),
            Kind::Outcome => "an outcome".to_owned(),
            Kind::Type(_) => "another type".to_owned(),
            Kind::Field | Kind::Variable => return None,
        };
        let owner = |set: usize, process: usize| self.model.processes[process].sets[set].owner;
        let is_beside = |other: Kind| match (kind, other) {
            (Kind::Process(_) | Kind::Module(_), Kind::Process(_) | Kind::Module(_)) => true,
            (Kind::Constant, Kind::Constant) | (Kind::Outcome, Kind::Outcome) | (Kind::Type(_), Kind::Type(_)) => true,
            (Kind::Resource(one, _), Kind::Resource(other, _)) => one == other,
            (Kind::Param(one, _), Kind::Param(other, _)) => one == other,
            (Kind::Instance(one, _), Kind::Instance(other, _)) => one == other,
            (Kind::Export(one, _), Kind::Export(other, _)) => one == other,
            (Kind::Port(one, _), Kind::Port(other, _)) => one == other,
            (Kind::Label(one, a), Kind::Label(other, b)) => one == other && owner(a, one) == owner(b, one),
            (_, _) => false,
        };
        let mut others = self.index().symbols.iter();
        let is_taken = others.any(|other| other.name == to && is_beside(other.kind));
        is_taken.then_some(what)
    }

    /// The edits of this spec and of the files it uses.
    fn rename_edits(&self, symbol: usize, to: &str) -> Vec<(Span, String)> {
        let name = &self.index().symbols[symbol].name;
        let edit = |span: Span| {
            // `robot_0` is an instance of the array `robot`.
            let element = self.text(span).strip_prefix(name.as_str()).filter(|rest| is_element(rest));
            (span, format!("{to}{}", element.unwrap_or_default()))
        };
        self.index().places(symbol).map(edit).collect()
    }

    /// The same spec with other texts.
    fn with(&self, edits: &[(Span, String)]) -> Self {
        let of = |origin: Origin, source: &Source| {
            let own = edits.iter().filter(|(span, _)| span.origin == origin);
            Source { text: edited(&source.text, own), ..source.clone() }
        };
        let others = (0..).map(Origin::Interface).zip(&self.others).map(|(origin, other)| of(origin, other));
        Self::new(of(Origin::Spec, &self.spec), others.collect(), &self.options)
    }
}

/// Returns the edits that rename a declaration in all of the texts, each once. The specs have to be all that may use
/// the name; unrelated ones are left alone.
///
/// # Errors
/// A sentence for a person: the name belongs to another text, is not a valid name, is taken, or would change the
/// meaning.
pub fn rename(specs: &[&Analysis], declaration: &Declaration, to: &str) -> Result<Vec<FileEdit>, RenameError> {
    if !is_name(to) {
        return Err(RenameError::Invalid { to: to.to_owned() });
    }
    let mut edits = BTreeSet::new();
    let mut is_known = false;
    for spec in specs {
        let Some(symbol) = spec.find(declaration) else { continue };
        is_known = true;
        spec.check_own(symbol)?;
        if spec.index().symbols[symbol].name == to {
            continue;
        }
        if let Some(what) = spec.taken(symbol, to) {
            return Err(RenameError::Acquisition { to: to.to_owned(), what });
        }
        if matches!(spec.index().symbols[symbol].kind, Kind::Process(_)) && to == "main" {
            return Err(RenameError::Main);
        }
        let own = spec.rename_edits(symbol, to);
        let renamed = spec.with(&own);
        // Names outside the index would be left unchanged.
        let is_broken = spec.plan().is_some() && renamed.plan().is_none();
        if is_broken || !same_meaning(spec.index(), renamed.index(), &own) {
            return Err(RenameError::Meaning { to: to.to_owned(), file: spec.spec.name.clone() });
        }
        edits.extend(own.into_iter().map(|(span, text)| FileEdit {
            file: spec.source(span).name.clone(),
            start: span.start,
            end: span.end,
            text,
        }));
    }
    if is_known { Ok(edits.into_iter().collect()) } else { Err(RenameError::Nameless) }
}

/// Whether a text is one name.
fn is_name(text: &str) -> bool {
    let tokens = lex(text);
    text.len() <= NAME_MAX && tokens.len() == 1 && tokens[0].kind == SyntaxKind::Ident
}

fn is_element(rest: &str) -> bool {
    rest.strip_prefix('_').is_some_and(|number| !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit()))
}

/// Whether each name means the same as before: the same places, moved by the edits, have the same declarations.
fn same_meaning(before: &Index, after: &Index, edits: &[(Span, String)]) -> bool {
    let moved: BTreeMap<Span, Span> = before.all().map(|(span, _)| (span, moved(span, edits))).collect();
    let old = before.all().map(|(span, symbol)| (moved[&span], moved[&before.symbols[symbol].declaration]));
    let new = after.all().map(|(span, symbol)| (span, after.symbols[symbol].declaration));
    old.eq(new)
}

/// Where a span lies after the edits.
fn moved(span: Span, edits: &[(Span, String)]) -> Span {
    let (mut start, mut end) = (i64::from(span.start), i64::from(span.end));
    for (edit, text) in edits.iter().filter(|(edit, _)| edit.origin == span.origin) {
        let growth = i64::try_from(text.len()).unwrap_or_default() - i64::from(edit.end - edit.start);
        if edit.start < span.start {
            start += growth;
        }
        if edit.start < span.end {
            end += growth;
        }
    }
    let offset = |value: i64| u32::try_from(value).unwrap_or_default();
    Span { start: offset(start), end: offset(end), ..span }
}

/// A text with edits, which are in its order.
fn edited<'a>(text: &str, edits: impl Iterator<Item = &'a (Span, String)>) -> String {
    let mut edited = String::with_capacity(text.len());
    let mut end = 0;
    for (span, new) in edits {
        edited.push_str(text.get(end..span.start as usize).unwrap_or_default());
        edited.push_str(new);
        end = span.end as usize;
    }
    edited + text.get(end..).unwrap_or_default()
}
