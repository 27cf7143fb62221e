//! Which program runs a controller type on this host.

use language::plan::{Argument, Constant, Leaf};
use std::collections::BTreeMap;

/// Controller types and the executables that offer them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Programs {
    types: BTreeMap<String, String>,
}

impl Programs {
    /// Notes that `executable` offers these types; the first executable to offer a type keeps it.
    pub fn offer(&mut self, executable: &str, types: impl IntoIterator<Item = String>) {
        for name in types {
            self.types.entry(name).or_insert_with(|| executable.to_owned());
        }
    }

    /// Returns the executable and its arguments for a leaf: `EXECUTABLE TYPE [NAME=]VALUE...`, or the leaf's own `exec`
    /// followed by its arguments.
    ///
    /// # Errors
    /// A sentence for a person: the type is not offered here.
    pub fn command(&self, leaf: &Leaf) -> Result<Vec<String>, String> {
        let mut command: Vec<String> = match &leaf.exec {
            Some(exec) => exec.split_whitespace().map(str::to_owned).collect(),
            None => match self.types.get(&leaf.module) {
                Some(executable) => vec![executable.clone(), leaf.module.clone()],
                None => return Err(self.unknown(&leaf.module)),
            },
        };
        if command.is_empty() {
            return Err(format!("the `exec` of `{}` is empty", leaf.module));
        }
        command.extend(leaf.arguments.iter().map(argument));
        Ok(command)
    }

    fn unknown(&self, module: &str) -> String {
        let lower = module.to_lowercase();
        let near = self.types.keys().find(|name| {
            let name = name.to_lowercase();
            name.starts_with(&lower) || lower.starts_with(&name)
        });
        let hint = near.map_or_else(
            || "name its executable with `--controllers`, or with `exec` in a `module` block".to_owned(),
            |near| format!("did you mean `{near}`?"),
        );
        format!("no program here offers the controller type `{module}`; {hint}")
    }
}

fn argument(argument: &Argument) -> String {
    let value = match &argument.value {
        Constant::Text(text) => text.clone(),
        Constant::Number(number) => number.to_string(),
        Constant::Truth(truth) => truth.to_string(),
    };
    argument.name.as_ref().map_or_else(|| value.clone(), |name| format!("{name}={value}"))
}
