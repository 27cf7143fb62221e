//! The project file `dca.toml` and the environment: both contain values for options that many commands share.
//!
//! The first of these that has a value counts: the command line, the environment, the project file, the default of the
//! option. The project file is in the folder of the spec that the command names, or else in the folder where the
//! command was started. Its values become defaults of options, so the verbs do not know about the project file.

use crate::io::named_file;
use anyhow::{Context as _, anyhow};
use clap::{Arg, ArgMatches, Command};
use node::console::Failure;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// The name of the project file.
pub(crate) const FILE: &str = "dca.toml";

/// The contents of a project file.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Project {
    /// `--controllers`
    controllers: Vec<PathBuf>,
    /// `--run-dir`
    run_dir: Option<PathBuf>,
    /// `--runs`
    runs: Option<PathBuf>,
    /// `--record`
    record: Vec<String>,
    /// `--keys`
    team: Option<PathBuf>,
    /// The hosts that specs of this project may name.
    hosts: Vec<String>,
    /// `--set`, by the names of parameters.
    set: BTreeMap<String, toml::Value>,
}

/// The values of options, by the id of the option.
type Defaults = BTreeMap<&'static str, Vec<OsString>>;

/// Returns a command line whose options have the defaults from the environment and the project file.
pub(crate) fn with_defaults(command: Command) -> Result<Command, Failure> {
    // If the arguments are wrong, the second reading reports this.
    let Ok(matches) = command.clone().try_get_matches() else { return Ok(command) };
    let folder = spec(&matches).and_then(Path::parent).unwrap_or(Path::new(""));
    let mut defaults =
        read(&folder.join(FILE))?.map(|project| project.defaults(folder)).transpose()?.unwrap_or_default();
    defaults.extend(environment(|name| std::env::var_os(name)));
    Ok(if defaults.is_empty() { command } else { set(command, &defaults) })
}

/// Returns the spec that a command names.
fn spec(matches: &ArgMatches) -> Option<&Path> {
    let (_, matches) = matches.subcommand()?;
    let named = |id| matches.try_get_one::<PathBuf>(id).ok().flatten();
    named("file").or_else(|| named("spec")).map(PathBuf::as_path)
}

/// Reads a project file, if there is one.
fn read(file: &Path) -> Result<Option<Project>, Failure> {
    match std::fs::symlink_metadata(file) {
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => return Ok(None),
        Err(_) | Ok(_) => {}
    }
    let text = named_file::text(file, named_file::TEXT_MAX);
    let text = text.with_context(|| format!("cannot read the project file `{}`", file.display()))?;
    let project =
        toml::from_str(&text).with_context(|| format!("cannot read the project file `{}`", file.display()))?;
    Ok(Some(project))
}

/// Returns the values that the environment has.
fn environment(variable: impl Fn(&str) -> Option<OsString>) -> Defaults {
    let mut defaults = Defaults::new();
    for (name, id) in [("DCA_RUN_DIR", "run_dir"), ("DCA_PASSPHRASE_FILE", "key_passphrase")] {
        defaults.extend(variable(name).filter(|value| !value.is_empty()).map(|value| (id, vec![value])));
    }
    let programs = variable("DCA_CONTROLLERS").unwrap_or_default();
    let programs = std::env::split_paths(&programs).map(PathBuf::into_os_string).filter(|path| !path.is_empty());
    let programs = Vec::from_iter(programs);
    defaults.extend((!programs.is_empty()).then_some(("programs", programs)));
    defaults
}

impl Project {
    /// Returns the values of the project file. A relative path is relative to the folder of the file.
    fn defaults(self, folder: &Path) -> anyhow::Result<Defaults> {
        let path = |path: PathBuf| folder.join(path).into_os_string();
        let set =
            self.set.into_iter().map(|(name, value)| Ok(OsString::from(format!("{name}={}", text(&name, value)?))));
        let all = [
            ("programs", self.controllers.into_iter().map(path).collect()),
            ("run_dir", self.run_dir.into_iter().map(path).collect()),
            ("runs", self.runs.into_iter().map(path).collect()),
            ("ports", self.record.into_iter().map(OsString::from).collect()),
            ("key_folder", self.team.into_iter().map(path).collect()),
            ("hosts", self.hosts.into_iter().map(OsString::from).collect()),
            ("defaults", set.collect::<anyhow::Result<Vec<_>>>()?),
        ];
        Ok(all.into_iter().filter(|(_, values): &(_, Vec<OsString>)| !values.is_empty()).collect())
    }
}

/// Returns a value in the form that `--set` accepts.
fn text(name: &str, value: toml::Value) -> anyhow::Result<String> {
    match value {
        toml::Value::String(text) => Ok(text),
        toml::Value::Integer(number) => Ok(number.to_string()),
        toml::Value::Float(number) => Ok(number.to_string()),
        toml::Value::Boolean(truth) => Ok(truth.to_string()),
        toml::Value::Datetime(_) | toml::Value::Array(_) | toml::Value::Table(_) => {
            Err(anyhow!("`set.{name}` in `{FILE}` is not a text, a number or a truth value"))
        }
    }
}

/// Sets the defaults of the options of all verbs.
fn set(command: Command, defaults: &Defaults) -> Command {
    // `dca audit` uses a run folder to find the state of a node. A run folder from the project file may belong to another node.
    if command.get_name() == "audit" {
        return command;
    }
    let argument = |argument: Arg| match defaults.get(argument.get_id().as_str()) {
        Some(values) => argument.default_values(values.iter().map(|value| kept(value))),
        None => argument,
    };
    let command = command.mut_args(argument);
    command.mut_subcommands(|verb| set(verb, defaults))
}

/// Keeps a text until the process ends, as `clap` requires for defaults.
fn kept(text: &OsStr) -> &'static OsStr {
    Box::leak(text.to_owned().into_boxed_os_str())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Controllers, Values};
    use clap::{CommandFactory as _, FromArgMatches as _, Parser};

    #[derive(Debug, Parser)]
    struct Line {
        #[arg(long)]
        run_dir: Option<PathBuf>,
        #[command(flatten)]
        controllers: Controllers,
        #[command(flatten)]
        values: Values,
    }

    fn line(project: &str, variables: &[(&str, &str)], words: &[&str]) -> anyhow::Result<Line> {
        let project: Project = toml::from_str(project)?;
        let mut defaults = project.defaults(Path::new("robots"))?;
        let value = |name: &str| variables.iter().find(|(known, _)| *known == name).map(|(_, value)| value.into());
        defaults.extend(environment(value));
        let matches = set(Line::command(), &defaults).try_get_matches_from([&["dca"], words].concat())?;
        Ok(Line::from_arg_matches(&matches)?)
    }

    const PROJECT: &str = "
        controllers = [\"target/debug/arms\", \"/opt/eyes\"]
        run_dir = \"here\"
        hosts = [\"c1\"]
        [set]
        robot = \"r7\"
        speed = 0.5
    ";

    #[test]
    fn the_command_line_counts_before_the_environment_and_that_before_the_file() {
        let of_file = line(PROJECT, &[], &[]).unwrap();
        let paths = |paths: &[&str]| paths.iter().map(PathBuf::from).collect::<Vec<_>>();
        assert_eq!(of_file.controllers.programs, paths(&["robots/target/debug/arms", "/opt/eyes"]));
        assert_eq!(of_file.run_dir, Some("robots/here".into()));
        let variables = [("DCA_RUN_DIR", "/run/x"), ("DCA_CONTROLLERS", "a:b/c"), ("DCA_PASSPHRASE_FILE", "")];
        let of_environment = line(PROJECT, &variables, &[]).unwrap();
        assert_eq!(of_environment.controllers.programs, paths(&["a", "b/c"]));
        assert_eq!(of_environment.run_dir, Some("/run/x".into()));
        let given = line(PROJECT, &variables, &["--run-dir", "y", "--controllers", "z"]).unwrap();
        assert_eq!((given.run_dir, given.controllers.programs), (Some("y".into()), paths(&["z"])));
        assert_eq!(line("", &[], &[]).unwrap().run_dir, None);
    }

    #[test]
    fn a_value_on_the_command_line_takes_the_place_of_one_of_the_file() {
        let values = line(PROJECT, &[], &["--set", "speed=2", "--set", "gain=1"]).unwrap().values;
        let values: Vec<String> =
            values.assignments().iter().map(|one| format!("{}={}", one.name, one.value)).collect();
        assert_eq!(values, ["robot=r7", "speed=2", "gain=1"]);
    }

    #[test]
    fn what_a_file_may_not_say_is_refused() {
        for (text, why) in [
            ("controler = []", "unknown field `controler`"),
            ("runs = 3", "invalid type"),
            ("[set]\nroute = [1, 2]", "`set.route` in `dca.toml` is not a text, a number or a truth value"),
        ] {
            let error = line(text, &[], &[]).unwrap_err();
            assert!(format!("{error:#}").contains(why), "{error:#}");
        }
    }

    #[test]
    fn the_file_stands_beside_the_spec() {
        let matches = |words: &[&str]| crate::Command::command().try_get_matches_from(words).unwrap();
        assert_eq!(spec(&matches(&["dca", "check", "robots/door.dca"])), Some(Path::new("robots/door.dca")));
        assert_eq!(
            spec(&matches(&["dca", "conform", "runs/a", "robots/door.dca"])),
            Some(Path::new("robots/door.dca"))
        );
        assert_eq!(spec(&matches(&["dca", "status"])), None);
    }
}
