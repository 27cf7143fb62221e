//! The parameters of the nodes that answer, and the nodes that do not answer.

use super::protocol::ParameterValue;
use std::collections::{BTreeMap, BTreeSet};

/// The parameters that could be read.
#[derive(Debug, Default)]
pub(crate) struct Parameters {
    pub(crate) values: Vec<ParameterValue>,
    /// The nodes that have told theirs.
    pub(crate) answered: BTreeSet<String>,
    /// The nodes that were asked and have not answered, and why.
    pub(crate) silent: BTreeMap<String, String>,
    /// Why a connection could not be asked at all.
    pub(crate) problems: Vec<String>,
}

impl Parameters {
    /// Returns a sentence for each node whose parameters are not known. `homes` has the host of each program that should run.
    pub(crate) fn unread(&self, homes: &BTreeMap<String, String>) -> Vec<String> {
        let silent = self.silent.iter().filter(|(host, _)| !self.answered.contains(*host));
        let silent = silent.map(|(host, why)| format!("the parameters of host `{host}` cannot be read: {why}"));
        let hosts: BTreeSet<&String> = homes.values().collect();
        let away = hosts.into_iter().filter(|host| !self.answered.contains(*host) && !self.silent.contains_key(*host));
        let away = away.map(|host| format!("the parameters of host `{host}` cannot be read: it does not answer"));
        self.problems.iter().cloned().chain(silent).chain(away).collect()
    }

    /// Returns why a parameter could not be set of which no program was found. A node that does not answer may have it.
    pub(crate) fn not_set(&self, name: &str, homes: &BTreeMap<String, String>) -> String {
        let home = name.rsplit_once('.').and_then(|(program, _)| homes.get(program));
        if let Some(home) = home.filter(|home| !self.answered.contains(*home)) {
            return format!("`{name}` was not set: host `{home}` does not answer; set it again once it does");
        }
        let is_whole = home.is_some() || self.silent.is_empty() && self.problems.is_empty();
        let silent = || self.silent.keys().map(|host| format!("`{host}`")).collect::<Vec<_>>().join(", ");
        match (is_whole, self.silent.is_empty()) {
            (true, _) => format!("`{name}` was not set: there is no such parameter"),
            (false, true) => format!("`{name}` was not set: no node that answers has it"),
            (false, false) => {
                format!("`{name}` was not set: no node that answers has it, and {} does not answer", silent())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A timeout is not a no.
    #[test]
    fn a_parameter_of_a_silent_node_may_exist() {
        let homes = BTreeMap::from([("d:main/a", "c1"), ("d:main/b", "c2")].map(|(a, b)| (a.to_owned(), b.to_owned())));
        let check = |answered: &[&str], silent: &[&str], name: &str, not_set: &str, unread: usize| {
            let parameters = Parameters {
                answered: answered.iter().map(|host| (*host).to_owned()).collect(),
                silent: silent.iter().map(|host| ((*host).to_owned(), "no answer within 2 s".to_owned())).collect(),
                ..Parameters::default()
            };
            let told = parameters.not_set(name, &homes);
            assert!(told.ends_with(not_set), "{told}");
            assert_eq!(parameters.unread(&homes).len(), unread, "{:?}", parameters.unread(&homes));
        };
        check(&["c1", "c2"], &[], "d:main/b.gain", "there is no such parameter", 0);
        check(&["c1"], &["c2"], "d:main/b.gain", "host `c2` does not answer; set it again once it does", 1);
        check(&["c1"], &[], "d:main/b.gain", "host `c2` does not answer; set it again once it does", 1);
        check(&["c1"], &["c2"], "d:main/a.gain", "there is no such parameter", 1);
        check(&["c1"], &["c3"], "d:main/z.gain", "no node that answers has it, and `c3` does not answer", 2);
    }
}
