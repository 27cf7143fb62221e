//! Resolves the name of a type to its process or module.

use crate::check::diagnostics::Diagnostics;
use crate::check::spec::{Spec, Target};
use crate::diagnostic::{Code, Diagnostic};
use crate::syntax::ast::Name;
use std::collections::BTreeMap;

/// Sets the target of every instance. Groups in the text have precedence over modules.
pub(super) fn resolve(spec: &mut Spec, diagnostics: &mut Diagnostics) {
    let mut unknown: BTreeMap<&str, Vec<(usize, &Name)>> = BTreeMap::new();
    let mut types = Types::new(spec);
    let mut targets = Vec::new();
    for (index, process) in spec.processes.iter().enumerate() {
        for (slot, instance) in process.instances.iter().enumerate() {
            let reading = spec.specializations.get(&(index, slot)).map(|&process| Target::Process(process));
            let find = |kind| types.find(index, kind, diagnostics);
            let target = reading.or_else(|| instance.kind.as_ref().map(find));
            if let (Some(Target::Unknown), Some(kind)) = (target, &instance.kind) {
                let places = unknown.entry(&kind.text).or_default();
                // All instances of an array are declared in one place.
                if places.last().is_none_or(|(_, last)| last.span != kind.span) {
                    places.push((index, kind));
                }
            }
            targets.push(target.unwrap_or(Target::Unknown));
        }
    }
    for names in unknown.values() {
        let found = no_interface(spec, names, diagnostics);
        diagnostics.extend(found);
    }
    let instances = spec.processes.iter_mut().flat_map(|process| &mut process.instances);
    for (instance, target) in instances.zip(targets) {
        instance.target = target;
    }
}

/// The name of a type, with its target.
type Candidate<'a> = (&'a Name, Target);

struct Types<'a> {
    spec: &'a Spec,
    /// All types by their names in small letters.
    lowered: BTreeMap<String, Vec<Candidate<'a>>>,
    /// All types, by the first letters of their words, because an abbreviation has the same first letters. Each comes
    /// with its words.
    initials: BTreeMap<String, Vec<(Vec<String>, Candidate<'a>)>>,
    /// The candidates of each lenient step, for names that were already looked up.
    known: BTreeMap<&'a str, [Vec<Candidate<'a>>; 2]>,
}

impl<'a> Types<'a> {
    fn new(spec: &'a Spec) -> Self {
        let processes = spec.processes.iter().enumerate();
        let processes = processes.map(|(index, process)| (&process.name, Target::Process(index)));
        let modules = spec.modules.iter().enumerate().map(|(index, module)| (&module.name, Target::Module(index)));
        let (mut lowered, mut first) = (BTreeMap::<_, Vec<_>>::new(), BTreeMap::<_, Vec<_>>::new());
        for (name, target) in processes.chain(modules) {
            let words = words(&name.text);
            lowered.entry(name.text.to_lowercase()).or_default().push((name, target));
            first.entry(initials(&words)).or_default().push((words, (name, target)));
        }
        Self { spec, lowered, initials: first, known: BTreeMap::new() }
    }

    /// Returns two lists: types whose name differs from `kind` only in case, and types whose name or `kind` abbreviates
    /// the other.
    fn candidates(&self, kind: &str, diagnostics: &mut Diagnostics) -> [Vec<Candidate<'a>>; 2] {
        let same_but_case = self.lowered.get(&kind.to_lowercase()).cloned().unwrap_or_default();
        let own = words(kind);
        let similar = self.initials.get(&initials(&own)).map_or(&[][..], Vec::as_slice);
        let similar = if diagnostics.may_compare(similar.len()) { similar } else { &[] };
        let abbreviated = similar.iter().filter(|(words, _)| is_abbreviation(&own, words));
        [same_but_case, abbreviated.map(|(_, candidate)| *candidate).collect()]
    }

    fn find(&mut self, enclosing: usize, kind: &'a Name, diagnostics: &mut Diagnostics) -> Target {
        let spec = self.spec;
        if let Some(&process) = spec.process_names.get(&kind.text) {
            return Target::Process(process);
        }
        if let Some(&module) = spec.module_names.get(&kind.text) {
            return Target::Module(module);
        }
        if !self.known.contains_key(kind.text.as_str()) {
            let candidates = self.candidates(&kind.text, diagnostics);
            self.known.insert(&kind.text, candidates);
        }
        for step in &self.known[kind.text.as_str()] {
            // A lenient name never refers to the group in which it is used, because this would be an unintended
            // recursion.
            let mut found = step.iter().filter(|(_, target)| *target != Target::Process(enclosing));
            if let (Some((name, target)), None) = (found.next(), found.next()) {
                let message = format!("no type is called exactly `{}`", kind.text);
                let diagnostic = Diagnostic::new(Code::W0204, kind.span, message);
                let diagnostic =
                    diagnostic.label(format!("read as `{}`", name.text)).reason(name.span, "declared here");
                // A long form is only offered: `Armc2)` is not a long form of `Arm`, but lacks a bracket.
                diagnostics.push(match kind.text.len() > name.text.len() {
                    true => diagnostic.choose(kind.span, &name.text),
                    false => diagnostic.replace(kind.span, &name.text),
                });
                return *target;
            }
        }
        Target::Unknown
    }
}

/// Makes one diagnostic for all instances of a type.
fn no_interface(spec: &Spec, names: &[(usize, &Name)], diagnostics: &mut Diagnostics) -> Option<Diagnostic> {
    let ((enclosing, first), others) = names.split_first()?;
    let message = format!("no interface of `{}` is known: its ports and arguments are not checked", first.text);
    let mut diagnostic = Diagnostic::new(Code::W0205, first.span, message);
    for (_, other) in others {
        diagnostic = diagnostic.reason(other.span, "nor here");
    }
    let enclosing = &spec.processes[*enclosing].name.text;
    let known = spec.process_names.keys().filter(|name| *name != enclosing).chain(spec.module_names.keys());
    if let Some(near) = diagnostics.near(&first.text, known.map(String::as_str)) {
        diagnostic = diagnostic.help(format!("did you mean `{}`?", near.name));
    } else {
        diagnostic = diagnostic
            .help("name the program that offers it with `--controllers PROGRAM`, or declare it as a `module`");
    }
    Some(diagnostic)
}

/// Returns whether both names have the same number of words, and each word of one is the start of the other's word:
/// `DistDetector` and `DistanceDetector`.
fn is_abbreviation(one: &[String], other: &[String]) -> bool {
    let is_short = |(a, b): (&String, &String)| a.starts_with(b.as_str()) || b.starts_with(a.as_str());
    one.len() == other.len() && std::iter::zip(one, other).all(is_short)
}

/// Returns the first letters of words.
fn initials(words: &[String]) -> String {
    words.iter().filter_map(|word| word.chars().next()).collect()
}

/// Returns the words of a name in camel case or with `_`, in small letters.
fn words(name: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut is_start = true;
    for c in name.chars() {
        if c == '_' {
            is_start = true;
            continue;
        }
        if is_start || c.is_uppercase() {
            words.push(String::new());
        }
        is_start = false;
        if let Some(word) = words.last_mut() {
            word.extend(c.to_lowercase());
        }
    }
    words
}

#[cfg(test)]
mod tests {
    use super::{is_abbreviation, words};

    #[test]
    fn words_abbreviate_words() {
        let is_abbreviation = |one: &str, other: &str| is_abbreviation(&words(one), &words(other));
        assert!(is_abbreviation("DistDetector", "DistanceDetector"));
        assert!(!is_abbreviation("Detector", "DistanceDetector"));
        assert!(!is_abbreviation("HitDetector", "DistanceDetector"));
    }
}
