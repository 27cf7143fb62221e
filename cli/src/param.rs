//! `dca param`: lists and changes the parameters of running programs. A change is a key in the database of the program's robot.

pub(crate) mod live;
mod ros;

use super::absent::Absences;
use super::db::databases::{DatabaseArgs, Databases};
use super::db::write::CommitArgs;
use super::logic::process_name::ProcessName;
use super::logic::suggestion;
use crate::client::words;
use crate::complete;
use anyhow::{Context, anyhow};
use clap::Subcommand;
use clap_complete::ArgValueCompleter;
use dbmanager::logic::key::Key;
use dbmanager::logic::txn::Write;
use dbmanager::logic::view::value::Datum;
use language::plan::{Accepts, Constant, Parameter};
use node::console::{self, Failure};
use node::logic::database::settings::{key_of_parameter, parameter_key, spelt, stands_for};
use node::logic::parameters::no_parameter;
use node::logic::printable::printable;
use node::logic::protocol::{Deployment, InstanceParameters, NodeStatus, ParameterStatus, leaves};
use node::logic::table::table;
use std::collections::{BTreeMap, BTreeSet};

/// The columns of a list.
const HEAD: [&str; 5] = ["PROGRAM", "PARAMETER", "VALUE", "SPEC", "TAKES"];

/// The arguments of `dca param`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// List the parameters of the running programs, with their types and present values
    List(List),
    /// Print the present value of a parameter
    Get(Get),
    /// Change a parameter, also while its program runs
    Set(Set),
    /// Take a change back: the value of the spec is used again
    Unset(Unset),
}

/// The arguments of `dca param list`.
#[derive(Debug, clap::Args)]
struct List {
    /// A program: [DEPLOYMENT:]INSTANCE, the last part of its path is enough [default: all]
    #[arg(value_parser = ProcessName::parse, add = ArgValueCompleter::new(complete::processes))]
    instance: Option<ProcessName>,
    #[command(flatten)]
    database: DatabaseArgs,
}

/// The arguments of `dca param get`.
#[derive(Debug, clap::Args)]
struct Get {
    /// A program: [DEPLOYMENT:]INSTANCE; the last part of its path is enough, such as `hit/force`
    #[arg(value_parser = ProcessName::parse, add = ArgValueCompleter::new(complete::processes))]
    instance: ProcessName,
    /// The parameter
    parameter: String,
    #[command(flatten)]
    database: DatabaseArgs,
}

/// The arguments of `dca param set`.
#[derive(Debug, clap::Args)]
struct Set {
    /// A program: [DEPLOYMENT:]INSTANCE; the last part of its path is enough, such as `hit/force`
    #[arg(value_parser = ProcessName::parse, add = ArgValueCompleter::new(complete::processes))]
    instance: ProcessName,
    /// The parameter
    parameter: String,
    /// A quantity such as `20 N`, a number in SI units, `true`, `false`, or a text
    #[arg(allow_hyphen_values = true)]
    value: String,
    #[command(flatten)]
    commit: CommitArgs,
}

/// The arguments of `dca param unset`.
#[derive(Debug, clap::Args)]
struct Unset {
    /// A program: [DEPLOYMENT:]INSTANCE; the last part of its path is enough, such as `hit/force`
    #[arg(value_parser = ProcessName::parse, add = ArgValueCompleter::new(complete::processes))]
    instance: ProcessName,
    /// The parameter
    parameter: String,
    #[command(flatten)]
    commit: CommitArgs,
}

/// A program, its robot, and the values for its parameters in the database of this robot.
struct Program {
    host: String,
    told: InstanceParameters,
    /// For each parameter, the keys that set it, with their values. The key with precedence is the last one.
    set: BTreeMap<String, Vec<(String, Datum)>>,
}

/// The programs of the nodes that answer.
struct Reached {
    programs: Vec<Program>,
    answered: BTreeSet<String>,
    /// The nodes that have not answered, and why.
    silent: BTreeMap<String, String>,
}

/// The programs of the nodes that answer, and the hosts that do not answer.
struct Found {
    programs: Vec<Program>,
    away: Absences,
    active: Active,
}

/// The active programs, by deployment and path.
type Active = BTreeSet<(Deployment, String)>;

/// Runs the verb.
pub(crate) fn run(arguments: Arguments) -> Result<(), Failure> {
    match arguments.verb {
        Verb::List(arguments) => arguments.run(),
        Verb::Get(arguments) => arguments.run(),
        Verb::Set(arguments) => arguments.run(),
        Verb::Unset(arguments) => arguments.run(),
    }
}

impl List {
    fn run(self) -> Result<(), Failure> {
        let found = programs(&self.database)?;
        let is_meant = |program: &&Program| self.instance.as_ref().is_none_or(|name| program.is_called(name));
        let programs: Vec<&Program> = found.programs.iter().filter(is_meant).collect();
        if let (Some(name), true) = (&self.instance, programs.is_empty()) {
            return Err(found.lacks(name));
        }
        found.away.warnings().iter().for_each(|warning| console::note(warning));
        // A node of ROS 2 is asked only if the user has named it alone: each node may delay the list.
        if let (Some(_), [program]) = (&self.instance, programs.as_slice())
            && program.told.ros_node.is_some()
        {
            return self.of_node(program);
        }
        let (of_nodes, programs): (Vec<&Program>, Vec<&Program>) =
            programs.into_iter().partition(|program| program.told.ros_node.is_some());
        if !of_nodes.is_empty() {
            let names: Vec<String> = of_nodes.iter().map(|program| format!("`{}`", program.name())).collect();
            let names = names.join(", ");
            console::note(&format!(
                "note: nodes of ROS 2 are asked one at a time, with `dca param list NAME`: {names}"
            ));
        }
        if self.database.json {
            let all: Vec<serde_json::Value> = programs.iter().flat_map(|program| program.json()).collect();
            console::answer(&all);
            return Ok(());
        }
        let mut rows = vec![HEAD.map(str::to_owned).to_vec()];
        rows.extend(programs.iter().flat_map(|program| program.rows()));
        let silent = programs.iter().filter(|program| program.told.parameters.is_none());
        let silent: Vec<String> = silent.map(|program| format!("`{}`", program.name())).collect();
        if rows.len() > 1 {
            console::say(&table(&rows));
        } else {
            console::note("no program that runs has parameters");
        }
        if !silent.is_empty() {
            console::note(&format!("note: the parameters of these are not known: {}", silent.join(", ")));
        }
        Ok(())
    }

    /// Lists the parameters of a ROS 2 node.
    fn of_node(&self, program: &Program) -> Result<(), Failure> {
        let found = ros::list(self.database.connect(), program)?;
        if self.database.json {
            console::answer(&found.iter().map(|parameter| parameter.json(program)).collect::<Vec<_>>());
            return Ok(());
        }
        let rows = found.iter().map(|parameter| parameter.row(program));
        let rows: Vec<Vec<String>> = std::iter::once(HEAD.map(str::to_owned).to_vec()).chain(rows).collect();
        console::say(&table(&rows));
        Ok(())
    }
}

impl Get {
    fn run(self) -> Result<(), Failure> {
        let found = programs(&self.database)?;
        let program = found.one(&self.instance)?;
        if program.told.ros_node.is_some() {
            let value = ros::get(self.database.connect(), program, &self.parameter)?;
            if self.database.json {
                console::answer(&value);
            } else {
                console::say(&printable(&value.to_string()));
            }
            return Ok(());
        }
        let parameter = program.parameter(&self.parameter)?;
        let value = program.value(&parameter.name).with_context(|| {
            format!("no value of `{}` of `{}` is set; its program uses its own value", parameter.name, program.name())
        })?;
        if self.database.json {
            console::answer(&value);
        } else {
            console::say(&value.to_toml());
        }
        Ok(())
    }
}

impl Set {
    fn run(self) -> Result<(), Failure> {
        let found = programs(&self.commit.database)?;
        let program = found.one(&self.instance)?;
        if program.told.ros_node.is_some() {
            let value = ros::set(self.commit.database.connect(), program, &self.parameter, &self.value)?;
            console::note(&printable(&format!("{} = {value}", self.parameter)));
            console::note("note: the node has taken the value, and keeps it until its program ends");
            return Ok(());
        }
        let parameter = program.parameter(&self.parameter)?;
        if parameter.accepts == Accepts::Secret {
            let (name, of) = (&parameter.name, program.name());
            return Err(anyhow!(
                "`{name}` of `{of}` is a secret, which is not a parameter of the database: `dca db put --secret KEY --for ROBOT` changes it"
            )
            .into());
        }
        let value = parameter.accepts.read(&self.value);
        let value = value
            .map_err(|expected| anyhow!("`{}` cannot be `{}`: expected {expected}", parameter.name, self.value))?;
        let datum = datum(&parameter.accepts, &value)?;
        let key = program.key(&parameter.name);
        console::note(&format!("{key} = {}", datum.to_toml()));
        self.commit.commit(vec![], vec![Write { key: Key::new(key)?, value: Some(datum.encode()?) }])?;
        console::note(&format!("note: {}", program.counts_from(&found.active)));
        Ok(())
    }
}

impl Unset {
    fn run(self) -> Result<(), Failure> {
        let found = programs(&self.commit.database)?;
        let program = match found.one(&self.instance) {
            Ok(program) => program,
            // A change stays when its program has ended. So it can be undone then as well.
            Err(none) => return self.delete(&stored(&self.commit.database, &self.instance, &self.parameter)?, none),
        };
        let parameter = program.parameter(&self.parameter)?;
        let set = program.set.get(&parameter.name).map(Vec::as_slice).unwrap_or_default();
        let Some((key, _)) = set.last() else {
            return Err(anyhow!("`{}` of `{}` was not changed", parameter.name, program.name()).into());
        };
        self.delete(std::slice::from_ref(key), anyhow!("the parameter has no value that can be deleted").into())
    }

    /// Deletes the matching key, if there is only one. If no key matches, returns the failure `none`.
    fn delete(&self, keys: &[String], none: Failure) -> Result<(), Failure> {
        match keys {
            [key] => {
                console::note(&format!("{key} is deleted"));
                self.commit.commit(vec![], vec![Write { key: Key::new(key.clone())?, value: None }])
            }
            [] => Err(none),
            several => {
                let (name, keys) = (&self.instance, several.join("`, `"));
                Err(anyhow!("several keys can mean `{name}`: `{keys}`; `dca db delete KEY` deletes one of them").into())
            }
        }
    }
}

impl Program {
    /// Returns the deployment and the path, in the form that other verbs print.
    fn name(&self) -> String {
        format!("{}:{}", self.told.deployment.name, self.told.path)
    }

    fn is_called(&self, name: &ProcessName) -> bool {
        name.is_process(&self.told.deployment, &self.told.path)
    }

    fn parameter(&self, name: &str) -> Result<&Parameter, Failure> {
        let Some(all) = &self.told.parameters else {
            return Err(anyhow!(
                "the parameters of `{}` are not known: its program has not shown its interface",
                self.name()
            )
            .into());
        };
        let found = all.iter().find(|status| status.parameter.name == name);
        let found = found.with_context(|| no_parameter(&self.told, all, name))?;
        Ok(&found.parameter)
    }

    /// Returns the key for a change of a parameter: the key with precedence, or else a key with the whole path.
    fn key(&self, parameter: &str) -> String {
        let set = self.set.get(parameter).and_then(|set| set.last());
        let own = || key_of_parameter(&self.host, &self.told.deployment.name, &self.told.path, parameter);
        set.map_or_else(own, |(key, _)| key.clone())
    }

    /// Returns the present value of a parameter. This is the value in the database, if the program accepts it, else the
    /// value in the spec.
    fn value(&self, parameter: &str) -> Option<Datum> {
        let status = self.told.parameters.iter().flatten().find(|status| status.parameter.name == parameter)?;
        let set = self.set.get(parameter).and_then(|set| set.last()).map(|(_, datum)| datum);
        let accepts = &status.parameter.accepts;
        let set = set.and_then(|datum| match accepts.read(&spelt(datum)) {
            // The database may contain a quantity with its unit.
            Ok(number) if accepts.unit().is_some() => number.parse().ok().map(Datum::float),
            read => read.ok().map(|_| datum.clone()),
        });
        set.or_else(|| status.given.as_ref().map(datum_of))
    }

    /// Says when the program begins to use a value that it was just given.
    fn counts_from(&self, active: &Active) -> String {
        let (name, module) = (self.name(), &self.told.module);
        if active.contains(&(self.told.deployment.clone(), self.told.path.clone())) {
            format!(
                "`{name}` runs: it uses the value at once if `{module}` accepts changes while it runs, otherwise at its next activation"
            )
        } else {
            format!("`{name}` is not active: it uses the value from its next activation on")
        }
    }

    fn rows(&self) -> Vec<Vec<String>> {
        let statuses = self.told.parameters.iter().flatten();
        let row = |status: &ParameterStatus| {
            let name = &status.parameter.name;
            let unit = status.parameter.accepts.unit().map(|unit| format!(" {unit}")).unwrap_or_default();
            let shown = |datum: Option<Datum>| {
                datum.map_or_else(|| "-".to_owned(), |datum| format!("{}{unit}", datum.to_toml()))
            };
            let given = status.given.as_ref().map(datum_of);
            vec![self.name(), name.clone(), shown(self.value(name)), shown(given), status.parameter.accepts.to_string()]
        };
        statuses.map(row).collect()
    }

    fn json(&self) -> Vec<serde_json::Value> {
        let value = |datum: Option<Datum>| {
            datum.map_or(serde_json::Value::Null, |datum| serde_json::from_str(&datum.to_json()).unwrap_or_default())
        };
        let statuses = self.told.parameters.iter().flatten();
        let one = |status: &ParameterStatus| {
            let name = &status.parameter.name;
            serde_json::json!({
                "deployment": self.told.deployment.name,
                "host": self.host,
                "instance": self.told.path,
                "module": self.told.module,
                "parameter": name,
                "value": value(self.value(name)),
                "spec": value(status.given.as_ref().map(datum_of)),
                "takes": status.parameter.accepts.to_string(),
                "unit": status.parameter.accepts.unit(),
                "key": self.key(name),
            })
        };
        statuses.map(one).collect()
    }
}

impl Found {
    /// Returns the only matching program.
    fn one(&self, name: &ProcessName) -> Result<&Program, Failure> {
        let mut found = self.programs.iter().filter(|program| program.is_called(name));
        match (found.next(), found.next()) {
            (Some(program), None) => Ok(program),
            (None, _) => Err(self.lacks(name)),
            (Some(one), Some(other)) => {
                let (one, other) = (one.name(), other.name());
                Err(anyhow!("`{name}` can mean `{one}` or `{other}`; give more of the path").into())
            }
        }
    }

    /// Says that no program has this name. If hosts do not answer, says that they may have it.
    fn lacks(&self, name: &ProcessName) -> Failure {
        let known = || self.programs.iter().map(|program| (&program.told.deployment, program.told.path.as_str()));
        self.away.may_have(&format!("program `{name}`")).unwrap_or_else(|| {
            let hint = match suggestion::process(name, known()) {
                Some(near) => format!("did you mean `{near}`?"),
                None if self.programs.is_empty() => "nothing runs".to_owned(),
                None => "`dca param list` lists all".to_owned(),
            };
            anyhow!("no program `{name}` runs; {hint}").into()
        })
    }
}

/// Finds the keys for a parameter of a program that does not run, in the databases of all robots that can be reached.
fn stored(database: &DatabaseArgs, instance: &ProcessName, parameter: &str) -> Result<Vec<String>, Failure> {
    database.with(async |databases| {
        let mut found = Vec::new();
        for host in databases.robots().await? {
            let keys = databases.parameters_of(&host, "").await?;
            found.extend(keys.into_iter().map(|(key, _)| key).filter(|key| is_set_by(key, instance, parameter)));
        }
        Ok(found)
    })
}

/// Returns whether a key sets a parameter of a program with this name. The name may be the path with or without its
/// deployment, or the end of the path.
fn is_set_by(key: &str, name: &ProcessName, parameter: &str) -> bool {
    let Some((_, deployment, instance, of)) = parameter_key(key) else { return false };
    if name.deployment().is_some_and(|named| !named.is_called(deployment)) {
        return false;
    }
    let whole = format!("{deployment}/{instance}");
    let name = name.process().unwrap_or_default();
    let name = name.strip_prefix("main/").unwrap_or(name);
    let is_end =
        |short: &str, long: &str| long.strip_suffix(short).is_some_and(|rest| rest.is_empty() || rest.ends_with('/'));
    // The key may contain less of the path than the user has written, or more.
    let path = name.strip_prefix(deployment).and_then(|rest| rest.strip_prefix('/'));
    of == parameter && (is_end(name, &whole) || path.is_some_and(|path| is_end(instance, path)))
}

/// Asks every node that can be reached for its programs. Asks its database for the values that replace their arguments.
fn programs(database: &DatabaseArgs) -> Result<Found, Failure> {
    database.with(async |databases| {
        // The warnings of the statuses name the hosts that do not answer.
        let Reached { programs, .. } = programs_of(databases).await?;
        let (nodes, away) = databases.statuses().await?;
        Ok(Found { programs, away, active: active(&nodes) })
    })
}

fn active(nodes: &[NodeStatus]) -> Active {
    let active = leaves(nodes).into_iter().filter(|leaf| leaf.process.state == "running");
    active.map(|leaf| (leaf.deployment.clone(), leaf.process.path.clone())).collect()
}

/// Returns the programs of the nodes that answer, with the values of their databases.
async fn programs_of(databases: &Databases<'_>) -> Result<Reached, Failure> {
    let (mut programs, mut answered, mut silent) = (Vec::new(), BTreeSet::new(), BTreeMap::new());
    for host in databases.robots().await? {
        // If one robot does not answer, the other robots are listed nevertheless.
        let told = match databases.parameters(&host).await {
            Ok(told) => told,
            Err(failure @ Failure::Unreachable(_)) => {
                silent.insert(host, words(&failure));
                continue;
            }
            Err(failure) => return Err(failure),
        };
        answered.insert(host.clone());
        if told.is_empty() {
            continue;
        }
        let keys = databases.parameters_of(&host, "").await?;
        let program = |told: InstanceParameters| Program { set: set(&keys, &told), host: host.clone(), told };
        programs.extend(told.into_iter().map(program));
    }
    programs.sort_by_key(Program::name);
    Ok(Reached { programs, answered, silent })
}

/// Returns the keys that set the parameters of a program, by parameter. The key with the longest part of the path comes last.
fn set(keys: &[(String, Datum)], told: &InstanceParameters) -> BTreeMap<String, Vec<(String, Datum)>> {
    let mut set: BTreeMap<String, Vec<(String, Datum)>> = BTreeMap::new();
    for (key, datum) in keys {
        let Some((_, deployment, instance, name)) = parameter_key(key) else { continue };
        if deployment == told.deployment.name && stands_for(instance, &told.path) {
            set.entry(name.to_owned()).or_default().push((key.clone(), datum.clone()));
        }
    }
    set.values_mut().for_each(|keys| keys.sort_by_key(|(key, _)| key.len()));
    set
}

/// Converts a value that the user has typed to the type of the parameter.
fn datum(accepts: &Accepts, text: &str) -> Result<Datum, Failure> {
    let is_text = match accepts {
        Accepts::Number | Accepts::Between { .. } | Accepts::Quantity { .. } => {
            return Ok(Datum::float(text.parse().context("reading the number")?));
        }
        Accepts::Text => true,
        Accepts::OneOf(all) => all.iter().all(|one| matches!(one, Constant::Text(_))),
        // A text that is not a TOML value is taken as a string.
        Accepts::Any => Datum::from_toml(text).is_err(),
        Accepts::Truth => false,
        Accepts::Secret => {
            return Err(anyhow!(
                "a secret is not a parameter of the database: the spec names it with `secret(\"KEY\")`"
            )
            .into());
        }
    };
    if is_text { Ok(Datum::Text(text.to_owned())) } else { Ok(Datum::from_toml(text).context("reading the value")?) }
}

fn datum_of(constant: &Constant) -> Datum {
    match constant {
        Constant::Text(text) => Datum::Text(text.clone()),
        Constant::Number(number) => Datum::float(*number),
        Constant::Truth(truth) => Datum::Bool(*truth),
        Constant::Secret(_) => Datum::Text(constant.bare()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_is_found_when_its_program_does_not_run() {
        let key = "robot/c3/params/door/hit/force/threshold";
        for (name, is_it) in [
            ("force", true),
            ("hit/force", true),
            ("door/hit/force", true),
            ("main/hit/force", true),
            ("door:main/hit/force", true),
            ("door@2:hit/force", true),
            ("gate:hit/force", false),
            ("door/task/hit/force", true),
            ("task/hit/force", false),
            ("orce", false),
            ("gate/hit/force", false),
        ] {
            assert_eq!(is_set_by(key, &ProcessName::new(name), "threshold"), is_it, "{name}");
        }
        let force = ProcessName::new("force");
        assert!(!is_set_by(key, &force, "zero") && !is_set_by("team/a", &force, "threshold"));
    }
}
