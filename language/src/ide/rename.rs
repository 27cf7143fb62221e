//! Renames a declaration and all its uses.
//!
//! A rename is correct when every name of the new text has the same meaning as in the old text. This is checked by
//! reading the new text, so the check covers every rule of the language.

use super::index::{Index, Kind};
use super::{Analysis, Declaration};
use crate::source::{Origin, Role, Source, Span};
use crate::syntax::is_name;
use std::collections::{BTreeMap, BTreeSet};

/// The longest name, in bytes.
const NAME_MAX: usize = 200;

/// The reason why a rename is not possible.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RenameError {
    /// That place has no declared name.
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
    /// The declaration is `main`, which has a meaning in the language.
    #[error("`main` is where a deployment starts, so its name stays")]
    Main,
    /// The new text cannot be a name.
    #[error("`{to}` is not a name: letters, digits and `_`, and no digit first")]
    Invalid {
        /// The new name.
        to: String,
    },
    /// Another declaration in the same scope already has this name.
    #[error("`{to}` is taken: {what} has this name")]
    Acquisition {
        /// The new name.
        to: String,
        /// The present owner of the name, such as "an instance of `main`".
        what: String,
    },
    /// Another name would change its meaning.
    #[error("with `{to}` some name in {file} would mean something else")]
    Meaning {
        /// The new name.
        to: String,
        /// The text with this name.
        file: String,
    },
}

/// An edit in one of several texts.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FileEdit {
    /// The name of the source.
    pub file: String,
    /// The first byte of the replaced text.
    pub start: u32,
    /// The byte after the replaced text.
    pub end: u32,
    /// The new text.
    pub text: String,
}

impl Analysis {
    /// Returns the place of the name at a byte offset of the spec, if it can be renamed.
    ///
    /// # Errors
    /// If that place has no name, or this text may not rename it.
    pub fn prepare_rename(&self, offset: usize) -> Result<Span, RenameError> {
        let (span, symbol) = self.index().place_at(offset).ok_or(RenameError::Nameless)?;
        self.check_own(symbol)?;
        Ok(span)
    }

    /// Checks that no program declares the symbol, and that the symbol is not `main`.
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

    /// Returns the owner of the name `to` among symbols of the same kind and scope, if there is one.
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
            Kind::Field | Kind::Variable | Kind::Result => return None,
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

    /// Returns the edits of this spec and of its files.
    fn rename_edits(&self, symbol: usize, to: &str) -> Vec<(Span, String)> {
        let name = &self.index().symbols[symbol].name;
        let edit = |span: Span| {
            // `robot_0` is an instance of the array `robot`.
            let element = self.text(span).strip_prefix(name.as_str()).filter(|rest| is_element(rest));
            (span, format!("{to}{}", element.unwrap_or_default()))
        };
        self.index().places(symbol).map(edit).collect()
    }

    /// Returns the same spec with the edits applied to all texts.
    fn with(&self, edits: &[(Span, String)]) -> Self {
        let of = |origin: Origin, source: &Source| {
            let own = edits.iter().filter(|(span, _)| span.origin == origin);
            Source { text: edited(&source.text, own), ..source.clone() }
        };
        let others = (0..).map(Origin::Interface).zip(&self.others).map(|(origin, other)| of(origin, other));
        Self::new(of(Origin::Spec, &self.spec), others.collect(), &self.options)
    }
}

/// Returns the edits that rename a declaration in all of the texts. Each edit occurs once. `specs` must contain all
/// specs that may use the name. Other specs among them stay unchanged.
///
/// # Errors
/// The error is a sentence for a person: the name belongs to another text, is not a valid name, is taken, or would
/// change a meaning.
pub fn rename(specs: &[&Analysis], declaration: &Declaration, to: &str) -> Result<Vec<FileEdit>, RenameError> {
    if to.len() > NAME_MAX || !is_name(to) {
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
        // A broken plan shows that names outside the index were left unchanged.
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

fn is_element(rest: &str) -> bool {
    rest.strip_prefix('_').is_some_and(|number| !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit()))
}

/// Returns whether each name has the same meaning as before: after the edits moved them, the same places have the same
/// declarations.
fn same_meaning(before: &Index, after: &Index, edits: &[(Span, String)]) -> bool {
    let moved: BTreeMap<Span, Span> = before.all().map(|(span, _)| (span, moved(span, edits))).collect();
    let old = before.all().map(|(span, symbol)| (moved[&span], moved[&before.symbols[symbol].declaration]));
    let new = after.all().map(|(span, symbol)| (span, after.symbols[symbol].declaration));
    old.eq(new)
}

/// Returns the place of a span after the edits.
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

/// Returns a text with these edits. They must be in the order of the text.
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
