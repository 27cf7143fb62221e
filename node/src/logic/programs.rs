//! The programs of this host: which executable runs a controller type.

use crate::logic::effect::{ProcessId, SecretArgument, SpawnOrder};
use language::Source;
use language::plan::{Argument, BRIDGE, BRIDGE_PROGRAM, Constant, Leaf, PORTS, PORTS_PROGRAM, Parameter, Plan, words};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Controller types and the executables that offer them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Programs {
    types: BTreeMap<String, String>,
    /// The parameters of each type, if its program declares them.
    parameters: BTreeMap<String, Vec<Parameter>>,
    /// The types of the ports of each controller type, by port.
    ports: BTreeMap<String, BTreeMap<String, String>>,
    /// The exports of each type: procedures and states, with their signatures.
    exports: BTreeMap<String, BTreeMap<String, String>>,
}

impl Programs {
    /// Notes that `executable` offers these types. If several executables offer one type, the first executable keeps it.
    pub fn offer(&mut self, executable: &str, types: impl IntoIterator<Item = String>) {
        for name in types {
            self.types.entry(name).or_insert_with(|| executable.to_owned());
        }
    }

    /// Notes that `executable` offers the types of this interface.
    pub fn declare(&mut self, executable: &str, interface: String) {
        let interface = [Source::new(executable, interface)];
        for (name, exports) in language::exports(&interface) {
            if !self.types.contains_key(&name) {
                self.exports.insert(name, exports);
            }
        }
        for (name, ports) in language::port_types(&interface) {
            if !self.types.contains_key(&name) {
                self.ports.insert(name, ports);
            }
        }
        for (name, parameters) in language::parameters(&interface) {
            if let (Some(parameters), false) = (parameters, self.types.contains_key(&name)) {
                self.parameters.insert(name.clone(), parameters);
            }
            self.offer(executable, [name]);
        }
    }

    /// Returns the parameters of a leaf; none if no program here declares them.
    pub fn parameters(&self, leaf: &Leaf) -> Option<&[Parameter]> {
        self.parameters.get(offered(leaf)?).map(Vec::as_slice)
    }

    /// Returns the type of a port of a leaf, if a program here declares it.
    pub fn port_type(&self, leaf: &Leaf, port: &str) -> Option<&str> {
        self.ports.get(offered(leaf)?)?.get(port).map(String::as_str)
    }

    /// Returns the procedures and states of a leaf; none if no program here declares them.
    pub fn exports(&self, leaf: &Leaf) -> Option<&BTreeMap<String, String>> {
        self.exports.get(offered(leaf)?)
    }

    /// Returns the command of a leaf: its executable and arguments. The command is `EXECUTABLE TYPE [NAME=]VALUE...`,
    /// or the leaf's own `exec` followed by its arguments.
    ///
    /// # Errors
    /// A sentence for a person, which says that this host does not offer the type.
    pub fn command(&self, leaf: &Leaf) -> Result<Vec<String>, String> {
        let mut command: Vec<String> = match &leaf.exec {
            Some(exec) => {
                let mut words =
                    words(exec).map_err(|why| format!("the `exec` of `{}` starts nothing: {why}", leaf.module))?;
                if let Some(first) = words.first_mut().filter(|first| first.as_str() == BRIDGE_PROGRAM) {
                    *first = self.types.get(BRIDGE).cloned().ok_or_else(|| self.unknown(BRIDGE))?;
                }
                words
            }
            None => match self.types.get(&leaf.module) {
                Some(executable) => vec![executable.clone(), leaf.module.clone()],
                None => return Err(self.unknown(&leaf.module)),
            },
        };
        command.extend(leaf.arguments.iter().map(argument));
        Ok(command)
    }

    fn unknown(&self, module: &str) -> String {
        if module == BRIDGE {
            return format!("ROS 2 needs `{BRIDGE_PROGRAM}` of the same build in the folder of `dca-node`");
        }
        if module == PORTS {
            return format!(
                "the ports of an activity need `{PORTS_PROGRAM}` of the same build in the folder of `dca-node`"
            );
        }
        let lower = module.to_lowercase();
        let near = self.types.keys().find(|name| {
            let name = name.to_lowercase();
            name.starts_with(&lower) || lower.starts_with(&name)
        });
        let hint = near.map_or_else(
            || "start its node (`dca-node` or `dca run`) with `--controllers PROGRAM`, or name the program with `exec` in a `module` block".to_owned(),
            |near| format!("did you mean `{near}`?"),
        );
        format!("no program here offers the controller type `{module}`; {hint}")
    }
}

/// Returns the type of a leaf, if a program of a host offers it. A leaf with a command of its own may have a type of the same name.
fn offered(leaf: &Leaf) -> Option<&str> {
    leaf.exec.is_none().then_some(leaf.module.as_str())
}

/// Returns how the program of a leaf of this plan is started.
pub fn order(process: ProcessId, command: Vec<String>, plan: &Plan, leaf: &Leaf) -> SpawnOrder {
    let claimed = plan.claims.iter().filter(|claim| claim.leaf == process.leaf).map(|claim| claim.device.clone());
    let (path, secrets, devices) = (leaf.path.clone(), secrets(leaf, &command), claimed.collect());
    let before = plan.leaves.iter().take(process.leaf as usize);
    let is_next = before.map(|leaf| &leaf.path).any(|other| *other == path);
    let is_service = plan.is_service(process.leaf);
    SpawnOrder {
        process,
        path,
        is_next,
        command,
        secrets,
        devices,
        kind: leaf.kind,
        is_service,
        policy: leaf.policy.clone(),
        keys: leaf.keys.clone(),
        environment: leaf.environment.clone(),
    }
}

/// Returns the secrets among the arguments of a leaf. The arguments are the last words of the leaf's command.
fn secrets(leaf: &Leaf, command: &[String]) -> Vec<SecretArgument> {
    let first = command.len().saturating_sub(leaf.arguments.len());
    let secrets = leaf.arguments.iter().enumerate().filter_map(|(place, argument)| match &argument.value {
        Constant::Secret(key) => Some(SecretArgument { word: u32::try_from(first + place).ok()?, key: key.clone() }),
        Constant::Text(_) | Constant::Number(_) | Constant::Truth(_) => None,
    });
    secrets.collect()
}

fn argument(argument: &Argument) -> String {
    let value = match &argument.value {
        Constant::Text(text) => text.clone(),
        Constant::Number(number) => number.to_string(),
        Constant::Truth(truth) => truth.to_string(),
        // The shim appends the path of the file with the secret.
        Constant::Secret(_) => String::new(),
    };
    argument.name.as_ref().map_or_else(|| value.clone(), |name| format!("{name}={value}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use language::{Options, compile};

    #[test]
    fn what_a_spec_says_is_what_is_executed() {
        let check = |module: &str, expected: Result<&[&str], &str>| {
            let text = format!(
                "process main(){{ host{{c1}} instantiated_processes{{ a instof Say(c1, \"good morning\", speed = 2); }}
                 internal_event_actions{{ a }} }}
                 module Say(host, text, speed) {{ {module} done; }}"
            );
            let plan = compile(&Source::new("a.dca", text), &[], &Options::named("a")).plan.unwrap();
            let mut programs = Programs::default();
            programs.offer("/opt/dca-controller", ["Sayer".to_owned()]);
            programs.offer("/opt/dca-ros", [BRIDGE.to_owned()]);
            let command = programs.command(&plan.leaves[0]);
            let expected = expected.map(|words| words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>());
            assert_eq!(command, expected.map_err(str::to_owned));
        };
        check("exec \"say -v\";", Ok(&["say", "-v", "text=good morning", "speed=2"]));
        check("exec \"'/opt/my robot/say' ''\";", Ok(&["/opt/my robot/say", "", "text=good morning", "speed=2"]));
        check("exec \"dca-ros RosAction\";", Ok(&["/opt/dca-ros", "RosAction", "text=good morning", "speed=2"]));
        check("", Err("no program here offers the controller type `Say`; did you mean `Sayer`?"));
    }

    /// A host offers a type with the name of a module that has a command of its own.
    #[test]
    fn a_program_of_its_own_is_not_the_offered_one() {
        let mut programs = Programs::default();
        let interface = "module Say(speed: Number) { out Out: Number; proc Ask() -> Number; done; }";
        programs.declare("/opt/dca-controller", interface.to_owned());
        for (module, is_offered) in [("", true), ("exec \"say\";", false)] {
            let text = format!(
                "process main(){{ host{{c1}} instantiated_processes{{ a instof Say(c1, speed = 2); }}
                 internal_event_actions{{ a }} }}
                 module Say(host, speed) {{ {module} done; }}"
            );
            let plan = compile(&Source::new("a.dca", text), &[], &Options::named("a")).plan.unwrap();
            let leaf = &plan.leaves[0];
            let found = [
                programs.parameters(leaf).is_some(),
                programs.port_type(leaf, "Out").is_some(),
                programs.exports(leaf).is_some(),
            ];
            assert_eq!(found, [is_offered; 3], "{module}");
        }
    }

    #[test]
    fn a_secret_is_no_word_of_the_command_but_has_a_place_in_it() {
        let text = r#"process main(){ host{c1} instantiated_processes {
                      a instof Show(c1, secret("team/wifi/psk"), 2, password = secret("team/camera/password")); }
                      internal_event_actions{ a } }
                      module Show(host, key, count, password: Secret) { exec "show -v"; plain; done; }"#;
        let plan = compile(&Source::new("a.dca", text), &[], &Options::named("a")).plan.unwrap();
        let command = Programs::default().command(&plan.leaves[0]).unwrap();
        assert_eq!(command, ["show", "-v", "key=", "count=2", "password="]);
        let secret = |word, key: &str| SecretArgument { word, key: key.to_owned() };
        let expected = [secret(2, "team/wifi/psk"), secret(4, "team/camera/password")];
        assert_eq!(secrets(&plan.leaves[0], &command), expected);
    }
}
