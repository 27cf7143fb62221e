//! The words that complete the name of a process or of a port.

use crate::logic::mission::short;
use node::logic::protocol::Deployment;
use std::collections::{BTreeMap, BTreeSet};

/// A running process, or one of its ports.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Process {
    deployment: String,
    /// The path of the process. For a port, its name follows: `main/hit/force.Out`.
    name: String,
}

impl Process {
    pub(crate) fn new(deployment: &Deployment, path: &str) -> Self {
        Self { deployment: deployment.name.clone(), name: path.to_owned() }
    }

    pub(crate) fn with_port(deployment: &Deployment, path: &str, port: &str) -> Self {
        Self { deployment: deployment.name.clone(), name: format!("{path}.{port}") }
    }

    /// Returns the name without `main`.
    fn short(&self) -> &str {
        short(&self.name)
    }
}

/// Returns a word for each process that matches the written text. The word is the shortest unique name.
pub(crate) fn processes(all: &BTreeSet<Process>, written: &str) -> BTreeSet<String> {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for one in all {
        *counts.entry(one.short()).or_default() += 1;
    }
    let word = |one: &Process| {
        let (of, short, whole) = (&one.deployment, one.short(), &one.name);
        let plain = (counts.get(short) == Some(&1)).then(|| [short.to_owned(), whole.clone()]);
        let words = plain.into_iter().flatten().chain([format!("{of}:{short}"), format!("{of}:{whole}")]);
        words.into_iter().find(|word| word.starts_with(written))
    };
    all.iter().filter_map(word).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_of_several_deployments_is_completed_with_each() {
        let all = [("door", "main/hit/force"), ("door", "main/arm"), ("gate", "main/arm")];
        let all = all.map(|(deployment, path)| Process { deployment: deployment.into(), name: path.into() }).into();
        let check = |written: &str, expected: &[&str]| {
            let words = processes(&all, written);
            assert_eq!(words.iter().map(String::as_str).collect::<Vec<_>>(), expected, "{written}");
        };
        check("", &["door:arm", "gate:arm", "hit/force"]);
        check("hi", &["hit/force"]);
        check("main/", &["main/hit/force"]);
        check("door:", &["door:arm", "door:hit/force"]);
        check("door:main/a", &["door:main/arm"]);
        check("x", &[]);
    }
}
