//! From the name of a type to its process or module.

use crate::check::spec::{Spec, Target};
use crate::diagnostic::{Code, Diagnostic};
use crate::similar::nearest;
use crate::syntax::ast::Name;
use std::collections::BTreeMap;

/// Sets the target of every instance. Groups that the file defines win over modules.
pub(super) fn resolve(spec: &mut Spec, diagnostics: &mut Vec<Diagnostic>) {
    let mut unknown: BTreeMap<&str, Vec<(usize, &Name)>> = BTreeMap::new();
    let mut types = Types { spec, known: BTreeMap::new() };
    let mut targets = Vec::new();
    for (index, process) in spec.processes.iter().enumerate() {
        for (slot, instance) in process.instances.iter().enumerate() {
            let reading = spec.readings.get(&(index, slot)).map(|&process| Target::Process(process));
            let find = |kind| types.find(index, kind, diagnostics);
            let target = reading.or_else(|| instance.kind.as_ref().map(find));
            if let (Some(Target::Unknown), Some(kind)) = (target, &instance.kind) {
                let places = unknown.entry(&kind.text).or_default();
                // The instances of an array are declared in one place.
                if places.last().is_none_or(|(_, last)| last.span != kind.span) {
                    places.push((index, kind));
                }
            }
            targets.push(target.unwrap_or(Target::Unknown));
        }
    }
    for names in unknown.values() {
        diagnostics.extend(no_interface(spec, names));
    }
    let instances = spec.processes.iter_mut().flat_map(|process| &mut process.instances);
    for (instance, target) in instances.zip(targets) {
        instance.target = target;
    }
}

struct Types<'a> {
    spec: &'a Spec,
    /// The candidates of each lenient step for names that were looked up before.
    known: BTreeMap<&'a str, [Vec<(&'a Name, Target)>; 2]>,
}

impl<'a> Types<'a> {
    fn find(&mut self, enclosing: usize, kind: &'a Name, diagnostics: &mut Vec<Diagnostic>) -> Target {
        let spec = self.spec;
        if let Some(&process) = spec.process_names.get(&kind.text) {
            return Target::Process(process);
        }
        if let Some(&module) = spec.module_names.get(&kind.text) {
            return Target::Module(module);
        }
        for step in self.known.entry(&kind.text).or_insert_with(|| candidates(spec, &kind.text)) {
            // A group is never meant by a lenient name inside itself: that would be a recursion nobody wrote.
            let mut found = step.iter().filter(|(_, target)| *target != Target::Process(enclosing));
            if let (Some((name, target)), None) = (found.next(), found.next()) {
                let message = format!("no type is called exactly `{}`", kind.text);
                let diagnostic = Diagnostic::new(Code::W0204, kind.span, message);
                let diagnostic =
                    diagnostic.label(format!("read as `{}`", name.text)).reason(name.span, "declared here");
                diagnostics.push(diagnostic.replace(kind.span, &name.text));
                return *target;
            }
        }
        Target::Unknown
    }
}

/// The types that equal `kind` but for case, and those that abbreviate it or that it abbreviates.
fn candidates<'a>(spec: &'a Spec, kind: &str) -> [Vec<(&'a Name, Target)>; 2] {
    let processes = spec.processes.iter().enumerate();
    let processes = processes.map(|(index, process)| (&process.name, Target::Process(index)));
    let modules = spec.modules.iter().enumerate().map(|(index, module)| (&module.name, Target::Module(index)));
    let all: Vec<(&Name, Target)> = processes.chain(modules).collect();
    let folded = kind.to_lowercase();
    let same_but_case = all.iter().copied().filter(|(name, _)| name.text.to_lowercase() == folded).collect();
    let abbreviated = all.iter().copied().filter(|(name, _)| is_abbreviation(kind, &name.text)).collect();
    [same_but_case, abbreviated]
}

/// One report for all instances of a type.
fn no_interface(spec: &Spec, names: &[(usize, &Name)]) -> Option<Diagnostic> {
    let ((enclosing, first), others) = names.split_first()?;
    let message = format!("no interface of `{}` is known: its ports and arguments are not checked", first.text);
    let mut diagnostic = Diagnostic::new(Code::W0205, first.span, message);
    for (_, other) in others {
        diagnostic = diagnostic.reason(other.span, "nor here");
    }
    let enclosing = &spec.processes[*enclosing].name.text;
    let known = spec.process_names.keys().filter(|name| *name != enclosing).chain(spec.module_names.keys());
    if let Some(near) = nearest(&first.text, known.map(String::as_str)) {
        diagnostic = diagnostic.help(format!("did you mean `{near}`?"));
    }
    Some(diagnostic)
}

/// Whether both names have the same number of words and each word of one starts the word of the other:
/// `DistDetector` and `DistanceDetector`.
fn is_abbreviation(one: &str, other: &str) -> bool {
    let (one, other) = (words(one), words(other));
    let is_short = |(a, b): (&String, &String)| a.starts_with(b.as_str()) || b.starts_with(a.as_str());
    one.len() == other.len() && std::iter::zip(&one, &other).all(is_short)
}

/// The words of a name in camel case or with `_`, in small letters.
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
    use super::is_abbreviation;

    #[test]
    fn words_abbreviate_words() {
        assert!(is_abbreviation("DistDetector", "DistanceDetector"));
        assert!(!is_abbreviation("Detector", "DistanceDetector"));
        assert!(!is_abbreviation("HitDetector", "DistanceDetector"));
    }
}
