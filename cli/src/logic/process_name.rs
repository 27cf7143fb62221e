//! The names that users write for deployments and processes. Each verb understands every form that a verb prints.

use node::logic::protocol::Deployment;
use std::fmt::{self, Display, Formatter};

/// The name of a deployment as a user writes it: `door`, or `door@3` for one run of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct DeploymentName(String);

impl DeploymentName {
    /// Reads a name that is given as an argument. If it is not valid, returns the mistake.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let wrong = || "an empty text names no deployment: expected NAME or NAME@NUMBER, such as `door`".to_owned();
        if text.is_empty() { Err(wrong()) } else { Ok(Self(text.to_owned())) }
    }

    /// Returns whether the name matches this run of a deployment.
    pub(crate) fn is(&self, deployment: &Deployment) -> bool {
        self.0 == deployment.name || self.epoch_of(&deployment.name) == Some(deployment.epoch)
    }

    /// Returns whether the name matches some run of the deployment `name`.
    pub(crate) fn is_called(&self, name: &str) -> bool {
        self.0 == name || self.epoch_of(name).is_some()
    }

    /// Returns the text that the user has written.
    pub(crate) fn text(&self) -> &str {
        &self.0
    }

    /// Returns the name without the number of a run.
    pub(crate) fn plain(&self) -> &str {
        let numbered = self.0.rsplit_once('@').filter(|(_, epoch)| epoch.parse::<u64>().is_ok());
        numbered.map_or(&self.0, |(name, _)| name)
    }

    /// If this is `NAME@NUMBER` for the given name, returns the number.
    fn epoch_of(&self, name: &str) -> Option<u64> {
        self.0.strip_prefix(name)?.strip_prefix('@')?.parse().ok()
    }
}

impl Display for DeploymentName {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// The processes that a user names: `hand`, `hit/force`, `door:main/hand`, `door@3:hand`, or `door:` for all of a deployment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ProcessName {
    /// The deployment of the processes; nothing for any deployment.
    deployment: Option<DeploymentName>,
    /// The end of a path; empty means every process.
    process: String,
}

impl ProcessName {
    /// Splits a text into the deployment and the process.
    pub(crate) fn new(text: &str) -> Self {
        // The name of a deployment comes from a file name, so it may contain a colon. A path never contains one.
        match text.rsplit_once(':') {
            Some((deployment, process)) => {
                Self { deployment: Some(DeploymentName(deployment.to_owned())), process: process.to_owned() }
            }
            None => Self { deployment: None, process: text.to_owned() },
        }
    }

    /// Reads a name that is given as an argument; returns the mistake if it is not valid. A port after the process, as
    /// `dca names` prints it, is ignored.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let (name, _) = Self::with_name(text);
        let wrong = || format!("`{text}` names no process: expected [DEPLOYMENT:]INSTANCE, such as `door:hand`");
        if name.is_any() { Ok(name) } else { Err(wrong()) }
    }

    /// Reads the name of one process that is to be changed. A port after it is an error.
    pub(crate) fn parse_one(text: &str) -> Result<Self, String> {
        let (name, port) = Self::with_name(text);
        match (name.process(), port) {
            (Some(_), None) => Ok(name),
            (Some(_), Some(_)) => Err(format!("`{text}` is a port; its process is `{name}`")),
            (None, _) => Err(format!("`{text}` names no process: expected [DEPLOYMENT:]INSTANCE, such as `hit/force`")),
        }
    }

    /// Splits `[DEPLOYMENT:]INSTANCE.NAME` at the first dot. A path has no dot, but the name of an output inside a
    /// group has one: `filter.smooth.Out`.
    pub(crate) fn with_name(text: &str) -> (Self, Option<&str>) {
        let path = text.rfind(':').map_or(0, |colon| colon + 1);
        match text[path..].find('.') {
            Some(dot) => (Self::new(&text[..path + dot]), Some(&text[path + dot + 1..])),
            None => (Self::new(text), None),
        }
    }

    /// Returns the deployment, if the user has named one.
    pub(crate) fn deployment(&self) -> Option<&DeploymentName> {
        self.deployment.as_ref()
    }

    /// Returns the end of a path; nothing if every process of a deployment matches.
    pub(crate) fn process(&self) -> Option<&str> {
        Some(&*self.process).filter(|process| !process.is_empty())
    }

    /// Returns the name without the number of a run.
    pub(crate) fn of_any_run(&self) -> Self {
        let deployment = self.deployment.as_ref().map(|named| DeploymentName(named.plain().to_owned()));
        Self { deployment, process: self.process.clone() }
    }

    /// Returns whether a process or a deployment is named at all.
    pub(crate) fn is_any(&self) -> bool {
        self.process().is_some() || self.deployment.as_ref().is_some_and(|deployment| !deployment.0.is_empty())
    }

    /// Returns whether the name matches the process with this path in this deployment. The path may also begin with the
    /// deployment, as in the keys of parameters: `door/hit/force`.
    pub(crate) fn is_process(&self, deployment: &Deployment, path: &str) -> bool {
        if self.deployment.as_ref().is_some_and(|named| !named.is(deployment)) {
            return false;
        }
        let Some(process) = self.process() else { return true };
        let below = || process.strip_prefix(deployment.name.as_str())?.strip_prefix('/');
        let is_whole = |below: &str| path == below || path.strip_prefix("main/") == Some(below);
        is_path(path, process) || below().is_some_and(is_whole)
    }
}

/// Returns whether a user's text is the whole path or its end.
fn is_path(path: &str, meant: &str) -> bool {
    path.strip_suffix(meant).is_some_and(|before| before.is_empty() || before.ends_with('/'))
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

    fn deployment() -> Deployment {
        Deployment { name: "d".into(), epoch: 3 }
    }

    #[test]
    fn a_name_means_the_end_of_a_path() {
        let cases = [
            ("a", true),
            ("main/a", true),
            ("d:a", true),
            ("d:", true),
            ("d@3:main/a", true),
            ("d/a", true),
            ("d:d/a", true),
            ("d/main/a", true),
            ("e:a", false),
            ("b", false),
            ("e:", false),
            ("d@2:a", false),
            ("e/a", false),
            ("d/main/b", false),
        ];
        for (text, is_meant) in cases {
            let name = ProcessName::new(text);
            assert_eq!((name.is_process(&deployment(), "main/a"), name.to_string()), (is_meant, text.to_owned()));
        }
        assert!(!ProcessName::new("a").is_process(&deployment(), "main/ba"));
    }

    #[test]
    fn a_deployment_is_named_as_it_is_printed() {
        for (text, is_meant, is_called) in
            [("d", true, true), ("d@3", true, true), ("d@2", false, true), ("d@", false, false), ("e@3", false, false)]
        {
            let name = DeploymentName::parse(text).unwrap();
            assert_eq!((name.is(&deployment()), name.is_called("d")), (is_meant, is_called), "{text}");
        }
        let at = Deployment { name: "d@3".into(), epoch: 1 };
        assert!(DeploymentName::parse("d@3").unwrap().is(&at) && DeploymentName::parse("").is_err());
    }

    #[test]
    fn what_stands_behind_the_first_dot_of_a_path_is_its_own() {
        let name = |text: &'static str| {
            let (process, name) = ProcessName::with_name(text);
            (process.to_string(), name)
        };
        assert_eq!(name("d:main/a.x"), ("d:main/a".to_owned(), Some("x")));
        assert_eq!(name("d:main/a"), ("d:main/a".to_owned(), None));
        assert_eq!(name("a."), ("a".to_owned(), Some("")));
        assert_eq!(name("filter.smooth.Out"), ("filter".to_owned(), Some("smooth.Out")));
        // The name of a deployment may contain a dot.
        assert_eq!(name("door.2:a"), ("door.2:a".to_owned(), None));
        assert!(
            ProcessName::parse("").is_err() && ProcessName::parse(":").is_err() && ProcessName::parse("d:").is_ok()
        );
        assert_eq!(ProcessName::parse("main/base.Pose").unwrap().to_string(), "main/base");
        assert_eq!(ProcessName::parse_one("a.x").unwrap_err(), "`a.x` is a port; its process is `a`");
        assert!(ProcessName::parse_one("d:").is_err() && ProcessName::parse_one("d:a").is_ok());
    }
}
