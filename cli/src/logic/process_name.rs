//! How a person names processes: `[DEPLOYMENT:]INSTANCE`.

use crate::logic::tap::is_path;
use std::fmt::{self, Display, Formatter};

/// The processes that a person means: `hand`, `hit/force`, `door:main/hand`, all of a deployment by `door:`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ProcessName {
    /// In this deployment; in any if absent.
    deployment: Option<String>,
    /// The end of a path; empty means every process.
    process: String,
}

impl ProcessName {
    /// Returns what is meant by a text.
    pub(crate) fn new(text: &str) -> Self {
        match text.split_once(':') {
            Some((deployment, process)) => {
                Self { deployment: Some(deployment.to_owned()), process: process.to_owned() }
            }
            None => Self { deployment: None, process: text.to_owned() },
        }
    }

    /// Reads a name as an argument; says what is wrong with it.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let name = Self::new(text);
        let wrong = || format!("`{text}` names no process: expected [DEPLOYMENT:]INSTANCE, such as `door:hand`");
        if name.is_any() { Ok(name) } else { Err(wrong()) }
    }

    /// Returns `[DEPLOYMENT:]INSTANCE` and `NAME` of `[DEPLOYMENT:]INSTANCE.NAME`; no path has a dot.
    pub(crate) fn with_name(text: &str) -> (Self, Option<&str>) {
        match text.rsplit_once('.').filter(|(_, name)| !name.contains(':')) {
            Some((process, name)) => (Self::new(process), Some(name)),
            None => (Self::new(text), None),
        }
    }

    /// Returns the end of a path; none if every process of a deployment is meant.
    pub(crate) fn process(&self) -> Option<&str> {
        Some(&*self.process).filter(|process| !process.is_empty())
    }

    /// Returns whether it names anything: a process, or a deployment.
    pub(crate) fn is_any(&self) -> bool {
        self.process().is_some() || self.deployment.as_ref().is_some_and(|deployment| !deployment.is_empty())
    }

    /// Returns whether the process with this path, of this deployment, is meant.
    pub(crate) fn is_process(&self, deployment: &str, path: &str) -> bool {
        let is_meant = self.process().is_none_or(|process| is_path(path, process));
        is_meant && self.deployment.as_ref().is_none_or(|named| named == deployment)
    }
}

impl Display for ProcessName {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        if let Some(deployment) = &self.deployment {
            write!(f, "{deployment}:")?;
        }
        f.write_str(&self.process)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_means_the_end_of_a_path() {
        let cases =
            [("a", true), ("main/a", true), ("d:a", true), ("d:", true), ("e:a", false), ("b", false), ("e:", false)];
        for (text, is_meant) in cases {
            let name = ProcessName::new(text);
            assert_eq!((name.is_process("d", "main/a"), name.to_string()), (is_meant, text.to_owned()));
        }
        assert!(!ProcessName::new("a").is_process("d", "main/ba"));
    }

    #[test]
    fn what_stands_behind_the_last_dot_is_its_own() {
        let name = |text: &'static str| {
            let (process, name) = ProcessName::with_name(text);
            (process.to_string(), name)
        };
        assert_eq!(name("d:main/a.x"), ("d:main/a".to_owned(), Some("x")));
        assert_eq!(name("d:main/a"), ("d:main/a".to_owned(), None));
        assert_eq!(name("a."), ("a".to_owned(), Some("")));
        // A deployment may have a dot.
        assert_eq!(name("door.2:a"), ("door.2:a".to_owned(), None));
        assert!(
            ProcessName::parse("").is_err() && ProcessName::parse(":").is_err() && ProcessName::parse("d:").is_ok()
        );
    }
}
