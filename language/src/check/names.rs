//! Resolves the names of instances inside one group.

use super::diagnostics::Diagnostics;
use super::index;
use super::spec::Instance;
use crate::diagnostic::{Code, Diagnostic};
use crate::similar::{Near, fold};
use crate::source::Span;
use crate::syntax::ast::Name;
use std::collections::{BTreeMap, BTreeSet};

/// The least number of common letters that makes an abbreviation.
const ABBREVIATION_MIN: usize = 4;
/// The largest number of names in one sentence.
const LISTED_MAX: usize = 20;

/// The instances of one group by name, by type, and by name without case.
pub(super) struct Names<'a> {
    instances: &'a [Instance],
    pub(super) diagnostics: &'a mut Diagnostics,
    exact: BTreeMap<&'a str, usize>,
    by_type: BTreeMap<&'a str, Vec<usize>>,
    folded: BTreeMap<String, Vec<usize>>,
    lowered: BTreeMap<String, Vec<usize>>,
    /// Unknown names that were already reported. Each is reported once.
    reported: BTreeSet<String>,
    /// How many instances each array has.
    pub(super) arrays: BTreeMap<String, usize>,
    /// Whether some instances could not be read. Then an unknown name is not an error.
    is_damaged: bool,
    /// Whether the surrounding text is damaged. Then a word may be something else than a name, unless it looks like
    /// one.
    pub(super) is_doubtful: bool,
}

impl<'a> Names<'a> {
    pub(super) fn new(instances: &'a [Instance], is_damaged: bool, diagnostics: &'a mut Diagnostics) -> Self {
        let mut by_type: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        let mut folded: BTreeMap<String, Vec<usize>> = BTreeMap::new();
        let mut lowered: BTreeMap<String, Vec<usize>> = BTreeMap::new();
        let mut exact = BTreeMap::new();
        for (slot, instance) in instances.iter().enumerate() {
            exact.entry(instance.name.text.as_str()).or_insert(slot);
            folded.entry(fold(&instance.name.text)).or_default().push(slot);
            lowered.entry(instance.name.text.to_lowercase()).or_default().push(slot);
            if let Some(kind) = &instance.kind {
                by_type.entry(kind.text.as_str()).or_default().push(slot);
            }
        }
        Self {
            instances,
            diagnostics,
            exact,
            by_type,
            folded,
            lowered,
            reported: BTreeSet::new(),
            arrays: BTreeMap::new(),
            is_damaged,
            is_doubtful: false,
        }
    }

    /// Returns the instance with exactly this name. Reports any other name.
    pub(super) fn exact(&mut self, name: &Name) -> Option<usize> {
        let found = self.find(&name.text);
        if found.is_none() {
            self.report_unknown(name);
        }
        found
    }

    /// Returns the instance with exactly this name, without any report.
    pub(super) fn find(&self, name: &str) -> Option<usize> {
        self.exact.get(name).copied()
    }

    /// Returns where an instance or an array of this name is declared.
    pub(super) fn declared(&self, name: &str) -> Option<Span> {
        let is_array = self.arrays.contains_key(name);
        let slot = if is_array { self.find(&index::element(name, 0)) } else { self.find(name) };
        slot.map(|slot| self.instances[slot].name.span)
    }

    /// Returns the instance that a name in an event action means, by the lenient rules.
    pub(super) fn lenient(&mut self, name: &Name) -> Option<usize> {
        if let Some(slot) = self.find(&name.text) {
            return Some(slot);
        }
        // The intended instance may be in text that cannot be read.
        if self.is_damaged {
            return None;
        }
        for (code, candidates) in self.candidates(&name.text) {
            match candidates.as_slice() {
                [] => {}
                [slot] => {
                    let diagnostic = self.read_as(code, name, *slot);
                    self.diagnostics.push(diagnostic);
                    return Some(*slot);
                }
                [..] => {
                    self.report_ambiguous(name, &candidates);
                    return None;
                }
            }
        }
        self.report_unknown(name);
        None
    }

    /// Returns whether a name that is not exact means one instance by the lenient rules.
    pub(super) fn means_one(&self, name: &str) -> bool {
        let first = self.candidates(name).into_iter().map(|(_, slots)| slots).find(|slots| !slots.is_empty());
        !self.is_damaged && first.is_some_and(|slots| slots.len() == 1)
    }

    /// Returns the candidates of each lenient step, in the order of the steps.
    fn candidates(&self, name: &str) -> [(Code, Vec<usize>); 3] {
        let by_type = self.by_type.get(name).cloned().unwrap_or_default();
        let folded = self.folded.get(&fold(name)).cloned().unwrap_or_default();
        [(Code::W0201, by_type), (Code::W0202, folded), (Code::W0203, self.abbreviated(name))]
    }

    /// Returns the instances whose name begins with this name, or whose name is a beginning of this name.
    fn abbreviated(&self, name: &str) -> Vec<usize> {
        let name = name.to_lowercase();
        let ends = name.char_indices().map(|(at, _)| at).skip(ABBREVIATION_MIN);
        let shorter = ends.filter_map(|end| self.lowered.get(&name[..end]));
        let is_long = name.chars().count() >= ABBREVIATION_MIN;
        let longer = self.lowered.range(name.clone()..).take_while(|(other, _)| is_long && other.starts_with(&name));
        let mut found: Vec<usize> = shorter.chain(longer.map(|(_, slots)| slots)).flatten().copied().collect();
        found.sort_unstable();
        found
    }

    fn read_as(&self, code: Code, name: &Name, slot: usize) -> Diagnostic {
        let instance = &self.instances[slot];
        let exact = &instance.name.text;
        let written = &name.text;
        let (message, label) = match code == Code::W0201 {
            true => (
                format!("process type `{written}` used where an instance is expected"),
                format!("read as `{exact}`, the only instance of {written}"),
            ),
            false => (format!("no instance is called exactly `{written}`"), format!("read as `{exact}`")),
        };
        let diagnostic = Diagnostic::new(code, name.span, message).label(label);
        let diagnostic = diagnostic.reason(instance.name.span, "declared here");
        // There is no other instance that it could mean, so the plan stays the same.
        diagnostic.replace(name.span, exact)
    }

    fn report_ambiguous(&mut self, name: &Name, candidates: &[usize]) {
        if !self.reported.insert(name.text.clone()) {
            return;
        }
        let message = format!("`{}` could mean more than one instance", name.text);
        let mut diagnostic = Diagnostic::new(Code::E0202, name.span, message);
        for &slot in candidates {
            let instance = &self.instances[slot];
            diagnostic = diagnostic.reason(instance.name.span, format!("could be `{}`", instance.name.text));
        }
        self.diagnostics.push(diagnostic.help("write the name of the instance"));
    }

    fn report_unknown(&mut self, name: &Name) {
        let suggestion = self.suggestion(&name.text);
        let is_noise = self.is_damaged || self.is_doubtful && suggestion.is_none();
        if is_noise || !self.reported.insert(name.text.clone()) {
            return;
        }
        let message = format!("unknown process `{}`", name.text);
        let diagnostic = Diagnostic::new(Code::E0201, name.span, message).label("not an instance of this group");
        let diagnostic = match suggestion {
            Some((slot, near)) => {
                let instance = &self.instances[slot].name;
                let diagnostic = diagnostic.reason(instance.span, "an instance with a similar name");
                let diagnostic = diagnostic.help(format!("did you mean `{}`?", instance.text));
                match near {
                    Some(near) => diagnostic.rename(name.span, &near),
                    None => diagnostic.choose(name.span, &instance.text),
                }
            }
            None if name.text == "fail" => diagnostic.help("write `fail(\"why\")`"),
            None if name.text == "wait" => diagnostic.help("write `wait(5 s)`"),
            None if self.instances.is_empty() => diagnostic.help("the group has no instances"),
            None => {
                let names = listed(self.instances.iter().take(8).map(|other| other.name.text.as_str()));
                let more = if self.instances.len() > 8 { ", ..." } else { "" };
                diagnostic.help(format!("the instances are {names}{more}"))
            }
        };
        self.diagnostics.push(diagnostic);
    }

    /// Returns the instance that is probably intended: by similar names of instances, otherwise by similar names of
    /// types. Names of instances are reported together with the other similar names.
    fn suggestion(&mut self, name: &str) -> Option<(usize, Option<Near<'a>>)> {
        let names = self.instances.iter().map(|instance| instance.name.text.as_str());
        if let Some(near) = self.diagnostics.near(name, names) {
            return self.find(near.name).map(|slot| (slot, Some(near)));
        }
        let only = self.by_type.iter().filter(|(_, slots)| slots.len() == 1);
        if let Some(near) = self.diagnostics.near(name, only.map(|(kind, _)| *kind)) {
            return self.by_type[near.name].first().map(|slot| (*slot, None));
        }
        self.candidates(name).into_iter().find_map(|(_, found)| found.first().map(|slot| (*slot, None)))
    }
}

/// Lists names in a sentence, at most as many as a person reads.
pub(super) fn listed<'a>(mut names: impl Iterator<Item = &'a str>) -> String {
    let shown: Vec<String> = names.by_ref().take(LISTED_MAX).map(|name| format!("`{name}`")).collect();
    match names.count() {
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}

/// Makes the diagnostic for the second of two declarations with the same name.
pub(super) fn twice(what: &str, name: &str, second: Span, first: Span) -> Diagnostic {
    let message = format!("{what} `{name}` is defined twice");
    Diagnostic::new(Code::E0110, second, message).reason(first, "first defined here")
}
