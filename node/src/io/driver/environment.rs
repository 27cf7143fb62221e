//! The environment of a program: the variables of its node, of its module, and those that the node sets.

use super::{Driver, start};
use crate::io::programs::VERSION_VARIABLE;
use crate::io::run_dir::{CONTROL_VARIABLE, DATA_SOCKET, DATA_VARIABLE, TEAM_VARIABLE};
use crate::logic::effect::SpawnOrder;
use comms::io::session::Reach;
use language::plan::{Environment, is_matched};
use std::collections::BTreeMap;
use std::path::Path;

/// Variables that a program has of its node in any case, where they are set.
const USUAL: [&str; 7] = ["PATH", "HOME", "USER", "LANG", "TZ", "RUST_LOG", "DCA_DIRECT"];
/// The prefixes of variables that describe one process, and not its children.
const OF_ONE_PROCESS: [&str; 4] = ["DCA_", "NOTIFY_SOCKET", "WATCHDOG_", "LISTEN_"];

/// The variables that every program takes over from its node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Inherited {
    /// All: the node belongs to one command.
    All,
    /// The usual variables, and these: names, or beginnings of names.
    Listed(Vec<String>),
}

impl Inherited {
    /// Returns whether a program inherits a variable of its node, because the node or the module of the program says so.
    fn has(&self, name: &str, environment: &Environment) -> bool {
        if USUAL.contains(&name) {
            return true;
        }
        let is_wanted = match self {
            Self::All => true,
            Self::Listed(listed) => {
                listed.iter().any(|pattern| is_matched(name, pattern)) || environment.inherits(name)
            }
        };
        is_wanted && !OF_ONE_PROCESS.iter().any(|begin| name.starts_with(begin))
    }

    /// Returns the variables of a program before those that its node sets.
    fn variables(
        &self,
        own: impl Iterator<Item = (String, String)>,
        environment: &Environment,
    ) -> BTreeMap<String, String> {
        let inherited = own.filter(|(name, _)| self.has(name, environment));
        let set = environment.variables.iter().map(|(name, value)| (name.clone(), value.clone()));
        inherited.chain(set).collect()
    }
}

impl Driver {
    /// Returns the whole environment of a program with this folder, which talks to its node at `control`.
    pub(super) fn environment(&self, order: &SpawnOrder, dir: &Path, control: Option<&Path>) -> Vec<(String, String)> {
        let own =
            std::env::vars_os().filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)));
        let mut environment = self.config.programs.inherited.variables(own, &order.environment);
        let path = |path: &Path| path.display().to_string();
        let mut set = |name: &str, value: String| drop(environment.insert(name.to_owned(), value));
        set(VERSION_VARIABLE, env!("CARGO_PKG_VERSION").to_owned());
        set("DCA_INSTANCE", order.word());
        set("DCA_DEPLOYMENT", order.process.deployment.name.clone());
        set("DCA_DIR", path(dir));
        if let Some(control) = control {
            set(CONTROL_VARIABLE, path(control));
            set(DATA_VARIABLE, path(&dir.join(DATA_SOCKET)));
            match self.config.network.reach {
                Reach::Host => {}
                Reach::Lan => set("DCA_REMOTE", "1".to_owned()),
                Reach::Team(_) => set(TEAM_VARIABLE, path(&start::programs_identity(&self.dir))),
            }
        }
        environment.into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_has_what_its_node_and_its_module_say() {
        let own = || {
            let all = ["PATH", "PYTHONPATH", "ROS_DOMAIN_ID", "SECRET", "DCA_TEAM", "NOTIFY_SOCKET", "DISPLAY"];
            all.into_iter().map(|name| (name.to_owned(), format!("own {name}")))
        };
        let module = Environment {
            variables: [("DISPLAY", ":1"), ("NEW", "1")]
                .map(|(name, value)| (name.to_owned(), value.to_owned()))
                .into(),
            inherited: ["ROS_*", "DCA_*", "NOTIFY_SOCKET"].map(str::to_owned).into(),
            directory: None,
        };
        let check = |inherited: &Inherited, module: &Environment, expected: &[&str]| {
            let found = inherited.variables(own(), module);
            let found: Vec<&str> = found.keys().map(String::as_str).collect();
            assert_eq!(found, expected, "{inherited:?}");
        };
        let listed = |names: &[&str]| Inherited::Listed(names.iter().map(|name| (*name).to_owned()).collect());
        let none = Environment::default();
        check(&listed(&[]), &none, &["PATH"]);
        check(&listed(&["PYTHON*"]), &none, &["PATH", "PYTHONPATH"]);
        check(&listed(&[]), &module, &["DISPLAY", "NEW", "PATH", "ROS_DOMAIN_ID"]);
        check(&Inherited::All, &none, &["DISPLAY", "PATH", "PYTHONPATH", "ROS_DOMAIN_ID", "SECRET"]);
        assert_eq!(Inherited::All.variables(own(), &module)["DISPLAY"], ":1", "what the module sets counts");
    }
}
