//! From the name of a type to its process or module.

use crate::check::spec::{Spec, Target};
use crate::diagnostic::{Code, Diagnostic};
use crate::similar::nearest;
use crate::syntax::ast::Name;
use std::collections::BTreeMap;

/// Sets the target of every instance. Groups that the file defines win over modules.
pub(super) fn resolve(spec: &mut Spec, diagnostics: &mut Vec<Diagnostic>) {
    let mut unknown: BTreeMap<String, Vec<Name>> = BTreeMap::new();
    let mut targets = Vec::new();
    for (index, process) in spec.processes.iter().enumerate() {
        for instance in &process.instances {
            let target = instance.kind.as_ref().map(|kind| find(spec, index, kind, diagnostics));
            if let (Some(Target::Unknown), Some(kind)) = (target, &instance.kind) {
                unknown.entry(kind.text.clone()).or_default().push(kind.clone());
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

fn find(spec: &Spec, enclosing: usize, kind: &Name, diagnostics: &mut Vec<Diagnostic>) -> Target {
    if let Some(&process) = spec.process_names.get(&kind.text) {
        return Target::Process(process);
    }
    if let Some(&module) = spec.module_names.get(&kind.text) {
        return Target::Module(module);
    }
    // A group is never meant by a lenient name inside itself: that would be a recursion nobody wrote.
    let processes = spec.processes.iter().enumerate().filter(|(index, _)| *index != enclosing);
    let processes = processes.map(|(index, process)| (&process.name, Target::Process(index)));
    let modules = spec.modules.iter().enumerate().map(|(index, module)| (&module.name, Target::Module(index)));
    let candidates: Vec<(&Name, Target)> = processes.chain(modules).collect();
    let same_but_case = |name: &str| name.to_lowercase() == kind.text.to_lowercase();
    let steps: [&dyn Fn(&str) -> bool; 2] = [&same_but_case, &|name| is_abbreviation(&kind.text, name)];
    for step in steps {
        let mut found = candidates.iter().filter(|(name, _)| step(&name.text));
        if let (Some((name, target)), None) = (found.next(), found.next()) {
            let message = format!("no type is called exactly `{}`", kind.text);
            let diagnostic = Diagnostic::new(Code::W0204, kind.span, message).label(format!("read as `{}`", name.text));
            diagnostics.push(diagnostic.reason(name.span, "declared here").replace(kind.span, &name.text));
            return *target;
        }
    }
    Target::Unknown
}

/// One report for all instances of a type.
fn no_interface(spec: &Spec, names: &[Name]) -> Option<Diagnostic> {
    let (first, others) = names.split_first()?;
    let message = format!("no interface of `{}` is known: its ports and arguments are not checked", first.text);
    let mut diagnostic = Diagnostic::new(Code::W0205, first.span, message);
    for other in others {
        diagnostic = diagnostic.reason(other.span, "nor here");
    }
    let known = spec.process_names.keys().chain(spec.module_names.keys()).map(String::as_str);
    if let Some(near) = nearest(&first.text, known) {
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
